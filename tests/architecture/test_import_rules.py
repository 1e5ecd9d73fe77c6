"""The borders between the parts of the package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from gibson_sim.cli.main import MODULE_OF
from support.simulation import require

HEAVY = ("rclpy", "pybullet", "moderngl", "torch")


def _modules(root: Path) -> set[str]:
    package = root / "src" / "gibson_sim" / "gibson_sim"
    names = {path.stem for path in package.glob("*.py")} | {path.parent.name for path in package.glob("*/__init__.py")}
    return {f"gibson_sim.{name}" for name in names - {"__init__"}}


def _contract(root: Path, name: str, key: str) -> set[str]:
    """Returns the modules that stand under ``key`` of a contract in pyproject.toml."""
    text = (root / "pyproject.toml").read_text().split(f'name = "{name}"', 1)[1]
    block = re.search(rf"^{key} = \[(.*?)\]", text, re.DOTALL | re.MULTILINE)
    assert block is not None
    return set(re.findall(r"gibson_sim\.\w+", block.group(1)))


def test_import_rules_are_kept(root: Path) -> None:
    require("importlinter")
    command = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", command], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_module_has_a_layer(root: Path) -> None:
    assert _modules(root) - _contract(root, "layers", "layers") == set()


def test_every_module_below_the_nodes_is_kept_free_of_ros(root: Path) -> None:
    free = _contract(root, "ROS only in gibson_sim.ros", "source_modules")
    assert _modules(root) - free == {"gibson_sim.ros", "gibson_sim.cli"}


def test_importing_the_package_loads_nothing_heavy() -> None:
    command = f"import gibson_sim, sys; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_launcher_loads_neither_physics_nor_pictures() -> None:
    told = "main(['run', '--scene', '/none', '--domain-id', 'x'])"
    command = f"""import sys
from gibson_sim.cli.main import main
try: {told}
except SystemExit: print([name for name in {(*HEAVY, "cv2", "scipy", "trimesh")} if name in sys.modules])"""
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert "argument --domain-id: invalid int value" in done.stderr


def test_help_names_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "gibson_sim.cli.main", "--help"], capture_output=True, text=True, check=True)
    assert {line.split()[0] for line in done.stdout.splitlines() if line.startswith("    ") and line.strip()} >= set(MODULE_OF)
