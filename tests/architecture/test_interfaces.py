"""The message packages that replace those of a ROS installation: complete, and with the same type hashes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "tf2_msgs")

PACKAGES = ("control_msgs", "rosbag2_interfaces", "simulation_interfaces", "tf2_msgs")
CPP = """
#include <cstdio>
#include <tf2_msgs/action/lookup_transform.hpp>
#include <tf2_msgs/msg/tf_message.hpp>
#include <tf2_msgs/srv/frame_graph.hpp>
#include <rosidl_typesupport_cpp/message_type_support.hpp>
int main()
{
  auto handle = rosidl_typesupport_cpp::get_message_type_support_handle<tf2_msgs::msg::TFMessage>();
  for (auto byte : handle->get_type_hash_func(handle)->value) {std::printf("%02x", byte);}
  return get_message_typesupport_handle(handle, "rosidl_typesupport_fastrtps_cpp") == nullptr;
}
"""
"""Prints the hash of a message and makes sure that Fast DDS can send it."""


def published(root: Path) -> dict[str, str]:
    """The hashes of the originals, by the name of the type."""
    lines = (root / "tests/architecture/interface_hashes.txt").read_text().splitlines()
    return dict(line.split(" ") for line in lines if not line.startswith("#"))


def prefix_of(package: str) -> Path:
    """The folder into which a Python package of messages was installed."""
    return Path(str(import_module(package).__file__)).parents[4]


@pytest.mark.parametrize("package", PACKAGES)
def test_each_type_has_the_published_type_hash(root: Path, package: str) -> None:
    wanted = {name: value for name, value in published(root).items() if name.startswith(f"{package}/")}
    found = {}
    for file in (prefix_of(package) / "share" / package).glob("*/*.json"):
        hashes = json.loads(file.read_text())["type_hashes"]
        found |= {item["type_name"]: item["hash_string"] for item in hashes if item["type_name"] in wanted}
    assert found == wanted
    classes = {name: getattr(import_module(f"{package}.{name.split('/')[1]}"), name.split("/")[2], None) for name in wanted}
    assert [name for name, kind in classes.items() if kind is None] == []


def test_tf_messages_are_there_in_cpp(root: Path, tmp_path: Path) -> None:
    prefix = prefix_of("tf2_msgs")
    (tmp_path / "main.cpp").write_text(CPP)
    command = ["c++", "-std=c++17", "main.cpp", "-o", "main", *(f"-I{folder}" for folder in (prefix / "include").iterdir())]
    command += [f"-L{prefix}/lib", "-Wl,--allow-shlib-undefined"]
    command += ["-ltf2_msgs__rosidl_typesupport_cpp", "-lrosidl_typesupport_cpp", "-lrosidl_runtime_c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    libraries = f"{prefix}/lib{os.pathsep}{os.environ.get('LD_LIBRARY_PATH', '')}"
    env = {**os.environ, "LD_LIBRARY_PATH": libraries}
    done = subprocess.run([tmp_path / "main"], env=env, capture_output=True, text=True, check=True)
    assert f"RIHS01_{done.stdout}" == published(root)["tf2_msgs/msg/TFMessage"]


@pytest.mark.parametrize(
    ("package", "launched", "program"),
    [
        ("gibson_sim", "sim.launch.py", "physics_node"),
        ("gibson_examples", "nav2.launch.py", "navigate"),
        ("gibson_path_following", "path_following.launch.py", "path_policy"),
    ],
)
def test_launch_finds_our_packages_with_the_environment_alone(
    root: Path, monkeypatch: pytest.MonkeyPatch, package: str, launched: str, program: str
) -> None:
    if not (Path(sys.prefix) / "gibson_setup").is_dir():
        pytest.skip("SKIPPED: this Python is not of an environment that `make setup` made")
    from ament_index_python.packages import get_package_prefix, get_package_share_directory

    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    # As `ros2 launch` looks for a file: it does not enter folders that are links.
    files = [Path(place) / name for place, _, names in os.walk(get_package_share_directory(package)) for name in names]
    (file,) = [file for file in files if file.name == launched]
    assert file.resolve().is_relative_to(root)
    assert os.access(Path(get_package_prefix(package)) / "lib" / package / program, os.X_OK)
    assert (Path(get_package_share_directory(package)) / "config").is_dir()
