"""Import rules between the layers of the package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gibson_sim.cli import registry as commands
from gibson_sim.cli.registry import command_modules
from support.simulation import require

PACKAGES = ("gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench")
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
    assert _modules(root) - free == {
        "gibson_sim.ros",
        "gibson_sim.cli",
        "gibson_sim.testing",
        "gibson_sim.pytest",
        "gibson_sim.agents",
    }


def test_importing_the_package_loads_nothing_heavy() -> None:
    command = f"import gibson_sim, sys; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_launcher_loads_neither_physics_nor_renderer() -> None:
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
    assert {line.split()[0] for line in done.stdout.splitlines() if line.startswith("    ") and line.strip()} >= set(
        command_modules()
    )


def test_command_of_a_missing_package_names_that_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "entry_points", lambda group: ())
    assert commands.not_installed(["scene", "import", "mesh.glb"]) == (
        "`gibson-sim scene import` comes with the package gibson_sim_tools, which is not installed; "
        "pip install gibson_sim_tools, or src/gibson_sim_tools of Gibson Sim's sources"
    )
    assert "gibson_sim_bench" in commands.not_installed(["bench", "table1"])
    assert commands.not_installed(["scene", "map", "flat"]) == commands.not_installed(["run"]) == ""


def test_every_command_added_by_another_package_is_listed_with_that_package() -> None:
    of_others = {("scene", name) for name in commands.scene_command_modules()} | {(name,) for name in commands.command_modules()}
    ours = {("scene", name) for name in commands.SCENE_COMMANDS} | {(name,) for name in commands.COMMANDS}
    assert of_others - ours == set(commands.BROUGHT_BY)


def _sources(root: Path) -> list[tuple[str, Path]]:
    """Returns all modules of our packages, each with its path below its package's source folder."""
    return [
        (file.relative_to(root / "src" / package).as_posix(), file)
        for package in PACKAGES
        for file in sorted((root / "src" / package / package).rglob("*.py"))
    ]


def test_untrusted_yaml_and_xml_are_parsed_in_one_place(root: Path) -> None:
    parses = re.compile(r"yaml\.(safe_)?load|yaml\.compose|(ElementTree|ET)\.(fromstring|parse|iterparse|XML)\(")
    found = {
        f"{name}: {line.strip()}"
        for name, path in _sources(root)
        for line in path.read_text(encoding="utf-8").splitlines()
        if parses.search(line)
    }
    # What is composed for its positions was parsed before; ruamel.yaml keeps the comments of a robot.yaml that was read before; the text of
    # the plate is our own.
    assert found == {
        "gibson_sim/reading.py: top = ElementTree.fromstring(text[begin.end() :] if begin is not None else text)",
        "gibson_sim_tools/importing/checks/splats.py: document = yaml.compose(text, yaml.SafeLoader)",
        'gibson_sim/bags/comparison/robot_file.py: robot = yaml.load(source.read_text(encoding="utf-8"))',
        "gibson_sim/tasks/scripts/doors.py: top = copy.deepcopy(ElementTree.parse(urdf).getroot())",
        "gibson_sim/tasks/scripts/doors.py: link.append(ElementTree.fromstring(_PLATE))",
    }


_WRITES = re.compile(r"\.write_(?:text|bytes)\(|\bimwrite\(|\bnp\.savez?\(|\.savefig\(|\bopen\([^)\n]*[\"'][wx]")
_MAY_WRITE = {
    "gibson_sim/writing.py", "gibson_sim/picture_files.py",
    # Drafts and caches that take their name last, files that are of use before they are complete, and what only this process reads.
    "gibson_sim/bags/metadata.py", "gibson_sim/bags/mcap_file.py", "gibson_sim/bags/sqlite_file.py", "gibson_sim/bags/writer.py",
    "gibson_sim/trials/execution/stack_log.py",
    "gibson_sim/description/xacro.py", "gibson_sim/physics/convex_parts.py", "gibson_sim/physics/engine_files.py", "gibson_sim/render/cache.py",
    "gibson_sim/scenes/collision/cache.py", "gibson_sim/scenes/collision/scan.py", "gibson_sim_learn/arrays.py",
    "gibson_sim_tools/importing/fetching/archives.py",
    "gibson_sim_tools/importing/fetching/fetch.py", "gibson_sim_tools/making/baking.py", "gibson_sim_tools/making/blender/__main__.py",
}  # fmt: skip


def test_files_are_written_in_one_place(root: Path) -> None:
    found = []
    for name, file in _sources(root):
        if name in _MAY_WRITE:
            continue
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
            if _WRITES.search(line) and not re.search(r"draft|self\._file, |savefig\(file, |savez\(archive, ", line):
                found.append(f"{name}:{number}: {line.strip()}")
    assert found == [], "use gibson_sim.writing or gibson_sim.picture_files"


def test_the_core_imports_none_of_the_tools() -> None:
    command = """import pkgutil, sys, importlib, gibson_sim
for module in pkgutil.walk_packages(gibson_sim.__path__, "gibson_sim."):
    if not module.name.endswith("__main__"): importlib.import_module(module.name)
loaded = {name.partition(".")[0] for name in sys.modules}
print(sorted(loaded & {"gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench", "gibson_path_following"}))"""
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=False)
    assert (done.stdout.strip().splitlines() or [done.stderr])[-1] == "[]"
