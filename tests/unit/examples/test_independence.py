"""The example does not depend on the simulator."""

from __future__ import annotations

import ast
from pathlib import Path

from gibson_examples import __version__

WITH_ROS = {"conversions.py", "node.py", "navigate.py", "named_goals.py", "trial.py"}


def _imported(file: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(str(node.module).partition(".")[0])
    return names


def _imports(root: Path) -> dict[str, set[str]]:
    return {f.name: _imported(f) for f in (root / "ros_ws/src/gibson_examples/gibson_examples").glob("*.py")}


def test_example_imports_nothing_of_the_simulator(root: Path) -> None:
    assert [name for name, imported in _imports(root).items() if imported & {"gibson_sim", "gibson_msgs"}] == []


def test_ros_is_in_the_node_and_the_programs_alone(root: Path) -> None:
    ros = {
        n for n, imported in _imports(root).items() if any(i == "rclpy" or i.endswith(("_msgs", "_interfaces")) for i in imported)
    }
    assert ros == WITH_ROS


def test_package_says_its_version_three_times_alike(root: Path) -> None:
    package = root / "ros_ws/src/gibson_examples"
    assert f'version="{__version__}"' in (package / "setup.py").read_text()
    assert f"<version>{__version__}</version>" in (package / "package.xml").read_text()
