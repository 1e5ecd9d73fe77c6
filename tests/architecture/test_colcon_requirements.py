"""What users of colcon install: package.xml and ros_ws/requirements.txt name all that the packages import, and nothing is missing."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from support.simulation import require

SOURCES = {
    "gibson_sim": "src/gibson_sim", "gibson_sim_tools": "src/gibson_sim_tools", "gibson_sim_bench": "src/gibson_sim_bench",
    "gibson_sim_learn": "src/gibson_sim_learn", "gibson_examples": "ros_ws/src/gibson_examples",
    "gibson_path_following": "ros_ws/src/gibson_path_following",
}  # fmt: skip
OF_ROSDEP = {
    "python3-aiohttp": "aiohttp", "python3-numpy": "numpy", "python3-opencv": "opencv-python-headless", "python3-pil": "pillow",
    "python3-scipy": "scipy", "python3-yaml": "pyyaml", "xacro": "xacro",
}  # fmt: skip
"""Key of rosdep -> package of PyPI that has the same module."""
BOUNDS = {"numpy"}
"""Packages that the file names only to keep pip from replacing them."""
WORTH_HAVING = {"numba", "meshoptimizer"}
"""Optional packages that the file installs."""
WITHOUT = {
    "gibson_sim.agents.server": "mcp",
    "gibson_sim.tasks.environments": "gymnasium", "gibson_sim.pytest": "pytest", "gibson_sim_tools.making.blender": "bpy",
    "gibson_sim_learn.path_following.network": "torch", "gibson_sim_learn.path_following.training": "torch",
    "gibson_sim_learn.path_following.distances.network": "torch", "gibson_sim_learn.path_following.distances.training": "torch",
    "gibson_sim_learn.path_following.export": "onnx", "gibson_sim_learn.path_following.pipeline": "torch",
    "gibson_sim_learn.filler.network": "torch", "gibson_sim_learn.filler.training": "torch", "gibson_sim_learn.filler.export": "onnx",
    "gibson_sim_learn.goggles.network": "torch", "gibson_sim_learn.goggles.training": "torch", "gibson_sim_learn.goggles.export": "onnx",
    "gibson_sim_learn.goggles.pipeline": "onnx", "gibson_sim_learn.training": "torch",
}  # fmt: skip
"""Modules, or folders of them, that need an optional package -> that package."""
ROS_MODULES = {"rclpy", "ament_index_python", "launch", "launch_ros", "rpyutils"}
IMPORT_ALL = r"""
import importlib, importlib.machinery, json, pkgutil, sys
packages, allowed = json.loads(sys.argv[1])
refused = set()


class Only(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        top = name.partition(".")[0]
        if path is None and top not in allowed and top not in sys.stdlib_module_names and not top.startswith("_sysconfigdata"):
            refused.add(top)
            return None
        return super().find_spec(name, path, target)


sys.meta_path[:] = [Only if f is importlib.machinery.PathFinder else f for f in sys.meta_path]
failed = {}
for package in packages:
    root = importlib.import_module(package)
    for found in pkgutil.walk_packages(root.__path__, package + "."):
        try:
            importlib.import_module(found.name)
        except ImportError as error:
            failed[found.name] = str(error.name or error)
print(json.dumps({"failed": failed, "refused": sorted(refused), "imported": len([m for m in sys.modules if m.startswith("gibson_sim")])}))
"""
"""Imports every module of the packages, and finds no third-party module but those that are allowed."""


def _setup_needs(root: Path, package: str) -> set[str]:
    text = (root / SOURCES[package] / "setup.py").read_text()
    block = re.search(r"(?s)install_requires=\[(.*?)\]", text)
    assert block is not None
    return {canonicalize_name(name) for name in re.findall(r'"([\w-]+)', block[1])} - {canonicalize_name(p) for p in SOURCES}


def _depends(root: Path, package: str) -> set[str]:
    tree = ElementTree.parse(root / SOURCES[package] / "package.xml").getroot()
    return {str(part.text) for part in tree if part.tag in ("depend", "exec_depend")}


def _requirements(root: Path, *, of_this_python: bool = False) -> set[str]:
    lines = (root / "ros_ws" / "requirements.txt").read_text().splitlines()
    found = [Requirement(line) for line in lines if line and not line.startswith("#")]
    if of_this_python:
        found = [one for one in found if one.marker is None or one.marker.evaluate()]
    return {canonicalize_name(one.name) for one in found}


def test_requirements_and_package_xml_name_what_setup_py_needs(root: Path) -> None:
    needed = set().union(*(_setup_needs(root, package) for package in SOURCES))
    by_pip = _requirements(root)
    for package in SOURCES:
        by_rosdep = {OF_ROSDEP[key] for key in _depends(root, package) if key in OF_ROSDEP}
        assert _setup_needs(root, package) - by_pip <= by_rosdep, package
    everywhere = {OF_ROSDEP[key] for package in SOURCES for key in _depends(root, package) if key in OF_ROSDEP}
    assert needed == (by_pip - BOUNDS - WORTH_HAVING) | everywhere
    assert by_pip & everywhere == BOUNDS, "two installations of one package"


def test_optional_packages_of_the_file_are_extras(root: Path) -> None:
    text = (root / "ros_ws" / "requirements.txt").read_text()
    extras = "".join(
        block
        for package in SOURCES
        for block in re.findall(r"(?s)extras_require=\{(.*?)\},?\n", (root / SOURCES[package] / "setup.py").read_text())
    )
    named = set(re.findall(r"(?m)^# ([a-z][a-z-]+)$", text)) | WORTH_HAVING
    assert named >= {"matplotlib", "foxglove-sdk"}
    assert named <= set(re.findall(r'"([\w-]+?)[>"]', extras))


@pytest.mark.parametrize("package", SOURCES)
def test_package_xml_names_every_ros_package_that_the_code_imports(root: Path, package: str) -> None:
    found: set[str] = set()
    folder = root / SOURCES[package]
    for file in (*(folder / package).rglob("*.py"), *folder.glob("launch/*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).partition(".")[0])
            elif (
                isinstance(node, ast.Call)
                and ast.unparse(node.func) == "import_module"
                and isinstance(node.args[0], ast.Constant)
            ):
                found.add(str(node.args[0].value).partition(".")[0])
    ros = {name for name in found if name.endswith(("_msgs", "_interfaces", "_srvs")) or name in ROS_MODULES}
    assert ros - _depends(root, package) == set()


def test_every_module_is_imported_with_what_the_files_name_and_nothing_else(root: Path) -> None:
    require("rclpy", "gibson_msgs")
    import importlib.metadata

    wanted = _requirements(root, of_this_python=True) | set(OF_ROSDEP.values())
    todo, names = list(wanted - {"numba", "meshoptimizer"}), set()
    while todo:
        name = canonicalize_name(todo.pop())
        if name in names:
            continue
        names.add(name)
        for line in importlib.metadata.requires(name) or []:
            needed = Requirement(line)
            if needed.marker is None or needed.marker.evaluate({"extra": ""}):
                todo.append(needed.name)
    tops = importlib.metadata.packages_distributions()
    allowed = {top for top, dists in tops.items() if any(canonicalize_name(d) in names or d.startswith("ros-") for d in dists)}
    compat = [path.parent.name for path in (root / "ros_ws" / "src" / "compat").glob("*/package.xml")]
    allowed |= {*SOURCES, "gibson_msgs", *compat}
    words = [json.dumps([list(SOURCES), sorted(allowed)])]
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL, *words], capture_output=True, text=True, check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    unexpected = {
        module: name
        for module, name in result["failed"].items()
        if not any(name == package and module.startswith(where) for where, package in WITHOUT.items())
    }
    assert unexpected == {}
    assert set(WITHOUT.values()) <= set(result["failed"].values())
    assert result["imported"] > 300
    assert {"numba", "foxglove"} & allowed == set()
