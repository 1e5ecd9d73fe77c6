"""Path following runs on a robot: it knows nothing of the simulator, and ROS stays in its nodes."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from gibson_path_following import __version__

OF_THE_SIMULATOR = {
    "gibson_sim",
    "gibson_sim_tools",
    "gibson_sim_learn",
    "gibson_sim_bench",
    "gibson_msgs",
    "simulation_interfaces",
}
CORE_NEEDS = {"numpy", "cv2", "yaml", "onnxruntime"}


def _imported(file: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(str(node.module).partition(".")[0])
    return names - set(sys.stdlib_module_names) - {"gibson_path_following"}


def _imports(root: Path) -> dict[str, set[str]]:
    package = root / "ros_ws/src/gibson_path_following/gibson_path_following"
    return {file.relative_to(package).as_posix(): _imported(file) for file in package.rglob("*.py")}


def test_nothing_of_the_simulator_is_imported(root: Path) -> None:
    assert [name for name, imported in _imports(root).items() if imported & OF_THE_SIMULATOR] == []


def test_the_core_needs_no_ros_and_few_packages(root: Path) -> None:
    core = {name: imported for name, imported in _imports(root).items() if not name.startswith("nodes/")}
    assert len(core) > 3
    assert {name: imported - CORE_NEEDS for name, imported in core.items() if imported - CORE_NEEDS} == {}


def test_package_says_its_version_three_times_alike(root: Path) -> None:
    package = root / "ros_ws/src/gibson_path_following"
    assert f'version="{__version__}"' in (package / "setup.py").read_text()
    assert f"<version>{__version__}</version>" in (package / "package.xml").read_text()
