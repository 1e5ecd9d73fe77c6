"""What colcon, pip and the set-up make of the source tree."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from support.simulation import require

PACKAGE_XML = ("src/gibson_sim/package.xml", "src/gibson_msgs/package.xml")
PACKAGE_OF = {
    "bmesh": "bpy", "cuda": "cuda-bindings", "cv2": "opencv-python-headless", "mathutils": "bpy", "pxr": "usd-core",
    "ruamel": "ruamel-yaml", "yaml": "PyYAML",
}  # fmt: skip
ROS_MODULES = {"rclpy", "ament_index_python", "launch", "launch_ros", "rpyutils"}
EXACT = re.compile(r"[a-z0-9-]+==[0-9][0-9.]*(a[0-9]+)?( ; python_version (<|>=) \"3\.\d+\")?")


def _setup_py(root: Path) -> str:
    return (root / "src" / "gibson_sim" / "setup.py").read_text()


def _found(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    assert match is not None, pattern
    return match.group(1)


@pytest.mark.parametrize("file", PACKAGE_XML)
def test_package_xml_has_the_version_of_the_python_package(root: Path, file: str) -> None:
    version = _found(r'__version__ = "(.*)"', (root / "src/gibson_sim/gibson_sim/__init__.py").read_text())
    assert ElementTree.parse(root / file).findtext("version") == version


def test_setup_py_has_the_version_of_the_python_package(root: Path) -> None:
    version = _found(r'__version__ = "(.*)"', (root / "src/gibson_sim/gibson_sim/__init__.py").read_text())
    assert _found(r'version="(.*)"', _setup_py(root)) == version


def test_colcon_sees_each_package_as_what_it_is(root: Path, tmp_path: Path) -> None:
    require("colcon_core", "colcon_ros")
    command = [sys.executable, "-m", "colcon", "--log-base", os.devnull, "list"]
    env = {**os.environ, "COLCON_HOME": str(tmp_path)}
    done = subprocess.run(command, cwd=root / "ros_ws", env=env, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "control_msgs\tsrc/compat/control_msgs\t(ros.ament_cmake)",
        "gibson_examples\tsrc/gibson_examples\t(ros.ament_python)",
        "gibson_msgs\tsrc/gibson_msgs\t(ros.ament_cmake)",
        "gibson_sim\tsrc/gibson_sim\t(ros.ament_python)",
        "gibson_sim_bench\tsrc/gibson_sim_bench\t(ros.ament_python)",
        "gibson_sim_tools\tsrc/gibson_sim_tools\t(ros.ament_python)",
        "rosbag2_interfaces\tsrc/compat/rosbag2_interfaces\t(ros.ament_cmake)",
        "simulation_interfaces\tsrc/compat/simulation_interfaces\t(ros.ament_cmake)",
        "tf2_msgs\tsrc/compat/tf2_msgs\t(ros.ament_cmake)",
    ]


def test_links_are_relative_and_lead_somewhere(root: Path) -> None:
    links = ["ros_ws/src/gibson_msgs", "ros_ws/src/gibson_sim", "src/gibson_sim/config", "src/gibson_sim/scenes"]
    wrong = [link for link in links if os.path.isabs(os.readlink(root / link)) or not (root / link).is_dir()]
    assert wrong == []


def test_every_constraint_is_exact(root: Path) -> None:
    lines = (root / "constraints.txt").read_text().splitlines()
    assert [line for line in lines if line and not line.startswith("#") and not EXACT.fullmatch(line)] == []


def test_everything_that_setup_py_needs_has_a_version(root: Path) -> None:
    block = _found(r"(?s)install_requires=\[(.*?)\]", _setup_py(root))
    needed = {name.lower() for name in re.findall(r'"(.*?)"', block)}
    pinned = set(re.findall(r"(?m)^([a-z0-9-]+)==", (root / "constraints.txt").read_text()))
    assert needed - pinned == set()


def test_everything_that_the_code_imports_stands_in_setup_py(root: Path) -> None:
    imported: set[str] = set()
    peers = (
        root / "src/gibson_sim_bench/gibson_sim_bench/peers.py"
    )  # measures what users have installed themselves, each optional
    for file in set((root / "src/gibson_sim/gibson_sim").rglob("*.py")) - {peers}:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                imported.add(str(node.module).partition(".")[0])
    ros = {name for name in imported if name.endswith(("_msgs", "_interfaces", "_srvs")) or name in ROS_MODULES}
    foreign = imported - ros - set(sys.stdlib_module_names) - {"gibson_sim"}
    needed = _found(r"(?s)install_requires=\[(.*?)\]", _setup_py(root))
    optional = _found(r"(?s)extras_require=\{(.*?)\}", _setup_py(root))
    assert {PACKAGE_OF.get(name, name) for name in foreign} - set(re.findall(r'"([A-Za-z0-9-]+)', needed + optional)) == set()


def test_our_tf_message_is_the_one_that_other_programs_know(root: Path) -> None:
    require("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = "tf2_msgs/msg/TFMessage"
    ours = get_types_from_msg((root / "ros_ws/src/compat/tf2_msgs/msg/TFMessage.msg").read_text(), name)
    assert ours == {name: get_typestore(Stores.ROS2_JAZZY).fielddefs[name]}
