"""docker/Dockerfile knows the packages and the dependencies of the source tree."""

from __future__ import annotations

import importlib.metadata
import json
import re
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from gibson_sim.cli.launching import arguments
from gibson_sim.client_config import FoxgloveConfig, WebConfig

PYTHON_PACKAGES = ("gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench", "gibson_path_following")
IN_WORKSPACE = ("gibson_path_following",)
"""Packages that are copied with the workspace."""
FROM_UBUNTU = {"numpy", "opencv-python-headless", "pillow", "pyyaml", "scipy", "xacro"}
"""Dependencies that the image takes from Ubuntu or ROS."""


def _dockerfile(root: Path) -> str:
    return (root / "docker" / "Dockerfile").read_text()


def _dependencies(root: Path) -> set[str]:
    """Returns the packages that ours need, directly or through others, on the image's Python 3.12."""
    found: set[str] = set()
    todo = []
    for package in PYTHON_PACKAGES:
        block = re.search(r"(?s)install_requires=\[(.*?)\]", (root / "ros_ws" / "src" / package / "setup.py").read_text())
        assert block is not None
        todo += [name for name in re.findall(r'"([\w-]+)', block[1]) if name not in PYTHON_PACKAGES]
    while todo:
        name = canonicalize_name(todo.pop())
        if name in found:
            continue
        found.add(name)
        try:
            lines = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:  # not needed on this Python
            continue
        image = {"extra": "", "python_version": "3.12", "python_full_version": "3.12.3"}
        needed = [Requirement(line) for line in lines]
        todo += [one.name for one in needed if one.marker is None or one.marker.evaluate(image)]
    return found


def test_the_ros_image_has_every_dependency(root: Path) -> None:
    listed = re.search(r"grep -E '\^\(([^)]*)\)==' \\", _dockerfile(root))
    assert listed is not None
    names = listed[1].split("|")
    assert names == sorted(set(names))
    assert _dependencies(root) - FROM_UBUNTU - set(names) == set()
    assert all(re.search(rf"(?m)^{name}==", (root / "constraints.txt").read_text()) for name in names)


def test_the_pip_image_copies_what_the_set_up_reads(root: Path) -> None:
    first = _dockerfile(root).split("RUN make setup")[0]
    packages = [package for package in PYTHON_PACKAGES if package not in IN_WORKSPACE]
    files = [f"{package}/{name}" for package in packages for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml")]
    files += [f"{package}/resource" for package in packages]
    files += [f"{package}/{package}/__init__.py" for package in packages]
    assert [file for file in files if f"src/{file} " not in first] == []
    assert "COPY ros_ws ros_ws\n" in first and all((root / "ros_ws" / "src" / package).is_dir() for package in IN_WORKSPACE)


def test_copied_files_exist(root: Path) -> None:
    copied = [line.split()[1:-1] for line in _dockerfile(root).splitlines() if line.startswith("COPY ") and "--from" not in line]
    assert [name for names in copied for name in names if not (root / name).exists()] == []


def test_compose_has_every_image_with_and_without_a_gpu(root: Path) -> None:
    services = yaml.safe_load((root / "docker" / "compose.yaml").read_text())["services"]
    stages = set(re.findall(r"(?m)^FROM \S+ AS (\w+)$", _dockerfile(root)))
    assert set(services) == {"pip", "ros", "pip-gpu", "ros-gpu"}
    for name, service in services.items():
        target = service["build"]["target"]
        assert target == name.removesuffix("-gpu") and target in stages
        assert service["image"] == f"gibson-sim:{target}"
        assert (service["network_mode"], service["ipc"], service["init"]) == ("host", "host", True)
        assert "ROS_DOMAIN_ID" in service["environment"]
        if name.endswith("-gpu"):
            (device,) = service["deploy"]["resources"]["reservations"]["devices"]
            assert (device["driver"], device["capabilities"]) == ("nvidia", ["gpu"])
            assert service["environment"]["NVIDIA_DRIVER_CAPABILITIES"] == "all", "compute alone has no EGL"
            assert service["profiles"] == ["gpu"]
        else:
            assert "deploy" not in service and "profiles" not in service, "a machine without a GPU would refuse it"


def test_images_serve_the_page_on_the_port_that_they_name(root: Path) -> None:
    ports = f"EXPOSE {WebConfig().port} {FoxgloveConfig().port}"
    stages = re.split(r"(?m)^FROM ", _dockerfile(root))[-2:]
    assert all(ports in stage.splitlines() for stage in stages)
    pip, ros = (json.loads(re.findall(r"(?m)^CMD (.*)$", stage)[0]) for stage in stages)
    assert pip == ["run", "--web"]
    assert ros[:4] == ["ros2", "launch", "gibson_sim", "sim.launch.py"]
    assert {text.partition(":=")[0] for text in ros[4:]} <= {argument.name for argument in arguments()}
    assert "web:=true" in ros


def test_the_ros_image_has_what_the_requirements_name(root: Path) -> None:
    listed = re.search(r"grep -E '\^\(([^)]*)\)==' \\", _dockerfile(root))
    assert listed is not None
    lines = (root / "ros_ws" / "requirements.txt").read_text().splitlines()
    wanted = {canonicalize_name(Requirement(line).name) for line in lines if line and not line.startswith("#")}
    assert wanted - FROM_UBUNTU <= set(listed[1].split("|"))
