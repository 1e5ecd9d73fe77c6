"""Terms of CONVENTIONS.md and the way of a command in ARCHITECTURE.md: what they name is where they say."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

NEXT = {
    "_on_command": "receive",
    "receive": "_received_commands",
    "_make_steps": "latch_commands",
    "_step": "apply_commands",
    "apply_commands": "_apply",
    "_apply": "command",
    "command": "command",
    "step": "actuate",
    "actuate": "actuate",
    "_draw": "_frame_history",
}
"""Method of the way -> what it calls or fills, where the next one is reached directly."""


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


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("where is a cmd_vel received?", ("received", "command")),
        ("where is it limited?", ("velocity limits",)),
        ("where is it applied?", ("applied command",)),
        ("where does a scene become a message?", ("drawn scene",)),
        ("where is a camera's pose computed?", ("camera pose",)),
        ("where is a cluster's level of detail chosen?", ("level of detail",)),
        ("where is what is hidden culled?", ("occlusion culling",)),
        ("where does a texture get its mip levels?", ("mip levels",)),
        ("where is a bag's chunk written?", ("chunk",)),
        ("where is it decided who can reach a simulation?", ("reach",)),
    ],
)
def test_one_grep_answers(root: Path, question: str, words: tuple[str, ...]) -> None:
    terms = [term for term, _, _ in _glossary(root)]
    assert [word for word in words if not any(word in term for term in terms)] == [], question


def test_the_way_of_a_command_is_as_drawn(root: Path) -> None:
    text = (root / "ARCHITECTURE.md").read_text().split("## From a command to its picture", 1)[1].split("## ", 1)[0]
    way = re.findall(r"^\d+\. `([\w/.]+\.py)` `(\w+)\.(\w+)`", text, re.MULTILINE)
    assert len(way) == 15
    for file, owner, method in way:
        source = ast.unparse(_defined(_package(root) / file)[f"{owner}.{method}"])
        if method in NEXT:
            assert NEXT[method] in source, f"{owner}.{method} does not lead to {NEXT[method]}"
