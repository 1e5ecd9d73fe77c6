"""How colcon, pip and the set-up read the source tree."""

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

PYTHON_PACKAGES = ("gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench", "gibson_path_following")
NOT_IMPORTED = {"gibson_sim": {"pybullet-arm64", "xacro"}}
"""What the code needs without an import statement of that name: programs that it starts, and a package whose module is `pybullet`."""
PACKAGE_OF = {
    "PIL": "Pillow", "bmesh": "bpy", "cuda": "cuda-bindings", "cv2": "opencv-python-headless", "foxglove": "foxglove-sdk",
    "mapbox_earcut": "mapbox-earcut", "mathutils": "bpy", "pxr": "usd-core", "ruamel": "ruamel-yaml", "yaml": "PyYAML",
}  # fmt: skip
ROS_MODULES = {"rclpy", "ament_index_python", "launch", "launch_ros", "rpyutils"}
EXACT = re.compile(r"[a-z0-9-]+==[0-9][0-9.]*(a[0-9]+)?( ; python_version (<|>=) \"3\.\d+\")?")


def _folder(root: Path, package: str) -> Path:
    """Returns the folder of a package, through the links of the workspace."""
    return root / "ros_ws" / "src" / package


def _setup_py(root: Path, package: str) -> str:
    return (_folder(root, package) / "setup.py").read_text()


def _version(root: Path, package: str) -> str:
    return _found(r'__version__ = "(.*)"', (_folder(root, package) / package / "__init__.py").read_text())


def _found(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    assert match is not None, pattern
    return match.group(1)


@pytest.mark.parametrize("package", ["gibson_msgs", *PYTHON_PACKAGES])
def test_all_packages_have_the_same_version(root: Path, package: str) -> None:
    version = _version(root, "gibson_sim")
    assert ElementTree.parse(_folder(root, package) / "package.xml").findtext("version") == version
    if package in PYTHON_PACKAGES:
        assert (_version(root, package), _found(r'version="(.*)"', _setup_py(root, package))) == (version, version)
        assert set(re.findall(r'"gibson_\w+==(.*?)"', _setup_py(root, package))) <= {version}


def test_colcon_detects_the_build_type_of_each_package(root: Path, tmp_path: Path) -> None:
    require("colcon_core", "colcon_ros")
    command = [sys.executable, "-m", "colcon", "--log-base", os.devnull, "list"]
    env = {**os.environ, "COLCON_HOME": str(tmp_path)}
    done = subprocess.run(command, cwd=root / "ros_ws", env=env, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "control_msgs\tsrc/compat/control_msgs\t(ros.ament_cmake)",
        "gibson_examples\tsrc/gibson_examples\t(ros.ament_python)",
        "gibson_msgs\tsrc/gibson_msgs\t(ros.ament_cmake)",
        "gibson_path_following\tsrc/gibson_path_following\t(ros.ament_python)",
        "gibson_sim\tsrc/gibson_sim\t(ros.ament_python)",
        "gibson_sim_bench\tsrc/gibson_sim_bench\t(ros.ament_python)",
        "gibson_sim_learn\tsrc/gibson_sim_learn\t(ros.ament_python)",
        "gibson_sim_tools\tsrc/gibson_sim_tools\t(ros.ament_python)",
        "rosbag2_interfaces\tsrc/compat/rosbag2_interfaces\t(ros.ament_cmake)",
        "simulation_interfaces\tsrc/compat/simulation_interfaces\t(ros.ament_cmake)",
        "tf2_msgs\tsrc/compat/tf2_msgs\t(ros.ament_cmake)",
    ]


def test_symbolic_links_are_relative_and_resolve(root: Path) -> None:
    links = [
        "ros_ws/src/gibson_msgs",
        "ros_ws/src/gibson_sim",
        "ros_ws/src/gibson_sim_tools",
        "ros_ws/src/gibson_sim_bench",
        "ros_ws/src/gibson_sim_learn",
        "src/gibson_sim/config",
        "src/gibson_sim/scenes",
    ]
    wrong = [link for link in links if os.path.isabs(os.readlink(root / link)) or not (root / link).is_dir()]
    assert wrong == []


def test_every_constraint_is_exact(root: Path) -> None:
    lines = (root / "constraints.txt").read_text().splitlines()
    assert [line for line in lines if line and not line.startswith("#") and not EXACT.fullmatch(line)] == []


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_everything_that_setup_py_needs_has_a_version(root: Path, package: str) -> None:
    block = _found(r"(?s)install_requires=\[(.*?)\]", _setup_py(root, package))
    needed = {name.lower() for name in re.findall(r'"([\w-]+)', block)} - set(PYTHON_PACKAGES)
    pinned = set(re.findall(r"(?m)^([a-z0-9-]+)==", (root / "constraints.txt").read_text()))
    assert needed - pinned == set()


def _imported(root: Path, package: str) -> set[str]:
    """Returns the packages that the code of one of ours imports: none of Python's and of ROS, nor itself."""
    found: set[str] = set()
    # Measures what users have installed themselves, each optional.
    peers = _folder(root, "gibson_sim_bench") / "gibson_sim_bench" / "peers.py"
    for file in set((_folder(root, package) / package).rglob("*.py")) - {peers}:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).partition(".")[0])
    ros = {name for name in found if name.endswith(("_msgs", "_interfaces", "_srvs")) or name in ROS_MODULES}
    return {PACKAGE_OF.get(name, name) for name in found - ros - set(sys.stdlib_module_names) - {package}}


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_setup_py_needs_what_the_code_imports_and_nothing_else(root: Path, package: str) -> None:
    imported = _imported(root, package)
    needed = set(re.findall(r'"([A-Za-z0-9_-]+)', _found(r"(?s)install_requires=\[(.*?)\]", _setup_py(root, package))))
    optional = set(re.findall(r'"([A-Za-z0-9_-]+)', _found(r"(?s)extras_require=\{(.*?)\}", _setup_py(root, package))))
    assert imported - needed - optional == set()
    assert needed - imported == NOT_IMPORTED.get(package, set())


def test_our_tf_message_equals_the_jazzy_definition(root: Path) -> None:
    require("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    name = "tf2_msgs/msg/TFMessage"
    ours = get_types_from_msg((root / "ros_ws/src/compat/tf2_msgs/msg/TFMessage.msg").read_text(), name)
    assert ours == {name: get_typestore(Stores.ROS2_JAZZY).fielddefs[name]}
