"""Terms of CONVENTIONS.md and the paths in ARCHITECTURE.md, such as that of a command, name existing code."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

NEXT = {
    "_on_command": "receive_command",
    "receive_command": "_received_commands",
    "_execute_steps": "latch_commands",
    "_step": "apply_commands",
    "apply_commands": "_apply",
    "_apply": "command",
    "command": "command",
    "step": "actuate",
    "actuate": "actuate",
    "_draw": "_frame_history",
}
"""Method of the way -> what it calls or fills, where the next one is reached directly."""

MOST_PLACES = 12
"""Files in which a grep for a name may find it."""


def _package(root: Path) -> Path:
    return root / "src" / "gibson_sim" / "gibson_sim"


def _defined(path: Path) -> dict[str, ast.AST]:
    """Returns classes, functions and ``Class.method`` of a file by name."""
    found: dict[str, ast.AST] = {}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            found[node.name] = node
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{each.name}": each for each in node.body if isinstance(each, ast.FunctionDef)}
    return found


def _glossary(root: Path) -> list[tuple[str, str, str]]:
    text = (root / "CONVENTIONS.md").read_text().split("## Glossary", 1)[1]
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \| ([^|]+) \|$", text, re.MULTILINE)
    return [(term, file, name) for term, where in rows for file, name in re.findall(r"`([\w/.]+\.py)` `([\w.]+)`", where)]


def test_every_term_is_where_the_glossary_says(root: Path) -> None:
    entries = _glossary(root)
    assert len(entries) > 30
    missing = [f"{term}: {file} {name}" for term, file, name in entries if name not in _defined(_package(root) / file)]
    assert missing == []


@functools.cache
def _names(package: Path) -> list[tuple[str, str]]:
    """Returns (file, name) of each module, class and function of a package."""
    found = []
    for path in sorted(package.rglob("*.py")):
        file = path.relative_to(package).as_posix()
        found.append((file, path.stem))
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                found.append((file, node.name))
    return found


@pytest.mark.parametrize(
    ("question", "words", "file"),
    [
        ("where is a cmd_vel received?", "receive_command", "ros/topics/robot_interface.py"),
        ("where is it latched for the next step?", "latch_commands", "ros/topics/robot_interface.py"),
        ("where is it limited?", "limit_velocity", "robots/drives/base.py"),
        ("where is it applied?", "apply_commands", "ros/topics/robot_interface.py"),
        ("where does a scene become a message?", "scene_to_msg", "ros/conversions/scene.py"),
        ("where does a pose become a message?", "pose_to_msg", "ros/conversions/basics.py"),
        ("where is a camera's pose computed?", "camera_matrix", "render/renderer.py"),
        ("where is a cluster's level of detail selected?", "lod_selection", "render/lod/lod_selection.py"),
        ("where is occlusion culled?", "occlusion_culling", "render/culling/occlusion_culling.py"),
        ("where does a texture get its mip levels?", "mip_levels", "render/draw/scene_memory.py"),
        ("where is a bag's chunk written?", "write_chunk", "bags/mcap_file.py"),
        ("where are sleeping bodies found?", "sleepingbodies", "physics/active_bodies.py"),
        ("where is a response deferred?", "deferredresponse", "ros/services/deferred.py"),
        ("where is it decided who can reach a simulation?", "reach", "reach.py"),
    ],
)
def test_one_grep_finds_the_file_of_each_concept(root: Path, question: str, words: str, file: str) -> None:
    found = {where for where, name in _names(_package(root)) if words in name.lower()}
    assert file in found and len(found) <= MOST_PLACES, f"{question} grep {words}: {sorted(found)}"


def test_path_of_a_command_matches_the_diagram(root: Path) -> None:
    text = (root / "ARCHITECTURE.md").read_text().split("## From a command to its picture", 1)[1].split("## ", 1)[0]
    way = re.findall(r"^\d+\. `([\w/.]+\.py)` `(\w+)\.(\w+)`", text, re.MULTILINE)
    assert len(way) == 15
    for file, owner, method in way:
        source = ast.unparse(_defined(_package(root) / file)[f"{owner}.{method}"])
        if method in NEXT:
            assert NEXT[method] in source, f"{owner}.{method} does not lead to {NEXT[method]}"


WAYS: dict[str, tuple[str, int, dict[str, tuple[str, ...]]]] = {
    "From SpawnEntity to its picture": ("src/gibson_sim/gibson_sim", 10, {
        "SimulationServices._on_request": ("SimulationServices._spawn_entity",),
        "SimulationServices._spawn_entity": ("Population.spawn",),
        "Population.spawn": ("PhysicsWorld.add",),
        "PhysicsWorld.add": ("PhysicsNode._publish_changes",),
        "PhysicsNode._publish_changes": ("WorldInterface.publish_scene",),
        "WorldInterface.publish_scene": ("RenderNode._on_scene",),
        "RenderNode._on_scene": ("Renderer.update", "RenderNode._draw"),
        "Renderer.update": ("Composition.change",),
    }),
    "From a scenario to its verdict": ("src/gibson_sim/gibson_sim", 9, {
        "run": ("load_scenario", "plan_runs", "execute_runs", "_write_report"),
        "execute_runs": ("execute_run",),
        "execute_run": ("execute", "judge"),
        "execute": ("RunMonitor.tick",),
    }),
    "From a photograph to a scene": ("src/gibson_sim_tools/gibson_sim_tools", 10, {
        "import_photographs": ("find_inputs", "PhotographImport.run"),
        "find_inputs": ("open_photographs",),
        "PhotographImport.run": (
            "fuse_scan", "snap_to_planes", "level_transform_from_up", "texture_surface", "write_scene", "check_path",
        ),
    }),
}  # fmt: skip
"""Heading of a way -> package, number of steps, and for a step the later steps that it, or a private function of its module, leads to."""

HANDOVERS = {
    "SimulationServices._spawn_entity": r"\(srv\.SpawnEntity, 'spawn_entity', self\._spawn_entity\)",  # by the table of services
    "Population.spawn": r"\.population\.spawn\(",
    "PhysicsWorld.add": r"self\._world\.add\(",
    "PhysicsNode._publish_changes": r"revision=self\.scene\.revision \+ 1",  # which the node compares
    "RenderNode._on_scene": r"self\._scene_pub\.publish\(",  # by a topic
    "Renderer.update": r"self\._renderer\.update\(",
    "Composition.change": r"self\._composition\.change\(",
    "PhotographImport.run": r"\bjob\.run\(",
    "execute_run": r"\b_FUNCTION\b",  # by name, in a worker process
    "RunMonitor.tick": r"self\._start_node\(TRIAL\b",  # in a process of its own
}
"""Step -> pattern of what leads to it, where a call of its bare name would say too little."""


@pytest.mark.parametrize("heading", WAYS)
def test_each_path_matches_its_diagram(root: Path, heading: str) -> None:
    package, count, calls = WAYS[heading]
    text = (root / "ARCHITECTURE.md").read_text().split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0]
    steps = re.findall(r"^\d+\. `([\w/.]+\.py)` `([\w.]+)`: ", text, re.MULTILINE)
    assert len(steps) == count
    way = {name: _defined(root / package / file) for file, name in steps}
    assert {name for name, found in way.items() if name not in found} == set()
    order = list(way)
    assert sorted(later for all_later in calls.values() for later in all_later) == sorted(order[1:]), (
        "each step is reached from one before it"
    )
    for name, all_later in calls.items():
        private = [node for other, node in way[name].items() if other.startswith("_")]
        source = "\n".join(map(ast.unparse, (way[name][name], *private)))
        for later in all_later:
            assert order.index(name) < order.index(later)
            pattern = HANDOVERS.get(later, rf"(?<!def )\b{later.rpartition('.')[2]}\(")
            assert re.search(pattern, source), f"{name} does not lead to {later}"
