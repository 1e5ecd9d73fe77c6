"""The borders between the parts of the package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from gibson_sim.cli.command_line import MODULE_OF
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


def test_yaml_and_xml_of_strangers_are_parsed_in_one_place(root: Path) -> None:
    package = root / "src" / "gibson_sim" / "gibson_sim"
    parses = re.compile(r"yaml\.(safe_)?load|yaml\.compose|(ElementTree|ET)\.(fromstring|parse|iterparse|XML)\(")
    found = {
        f"{path.relative_to(package)}: {line.strip()}"
        for path in package.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if parses.search(line)
    }
    # ruamel.yaml keeps the comments of a robot.yaml that was read before; the text of the plate is our own.
    assert found == {
        "reading.py: top = ElementTree.fromstring(text)",
        'bags/comparison/robot_file.py: robot = yaml.load(source.read_text(encoding="utf-8"))',
        "tasks/doors.py: top = copy.deepcopy(ElementTree.parse(urdf).getroot())",
        "tasks/doors.py: link.append(ElementTree.fromstring(_PLATE))",
    }


_WRITES = re.compile(r"\.write_(?:text|bytes)\(|\bimwrite\(|\bnp\.savez?\(|\.savefig\(|\bopen\([^)\n]*[\"'][wx]")
_MAY_WRITE = {
    "writing.py", "picture_files.py",
    # Drafts and caches that take their name last, files that are of use before they are complete, and what only this process reads.
    "bags/metadata.py", "bags/sink.py", "bags/sqlite_file.py", "bags/writer.py", "importing/archives.py", "importing/download.py",
    "making/baking.py", "making/blender/__main__.py", "physics/convex_parts.py", "physics/engine_files.py", "render/cache.py",
    "robots/xacro.py", "scenes/collision/cache.py", "scenes/collision/parts.py",
}  # fmt: skip


def test_files_are_written_in_one_place(root: Path) -> None:
    package = root / "src" / "gibson_sim" / "gibson_sim"
    found = []
    for file in sorted(package.rglob("*.py")):
        if file.relative_to(package).as_posix() in _MAY_WRITE:
            continue
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
            if _WRITES.search(line) and not re.search(r"draft|self\._file, |savefig\(file, ", line):
                found.append(f"{file.relative_to(package)}:{number}: {line.strip()}")
    assert found == [], "use gibson_sim.writing or gibson_sim.picture_files"
