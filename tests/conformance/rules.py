"""Conformance tests state the rule of a format's specification that they check; ``docs/formats.md`` is the table of these rules.

``PYTHONPATH=tests python -m conformance.rules`` writes the page; ``test_table.py`` compares it with the tests.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

Status = Literal["done", "approximated", "left out", "refused"]
"""done: as specified; approximated, left out: with a warning that says what changes; refused: an error in one line."""
FORMATS = ("glTF", "OBJ/MTL", "PLY", "STL", "COLLADA", "Images", "URDF", "SDF", "MJCF")
PAGE = Path(__file__).parents[2] / "docs" / "formats.md"
Test = TypeVar("Test", bound=Callable[..., Any])


@dataclass(frozen=True, slots=True)
class Rule:
    """One row of the table."""

    format: str
    """One of ``FORMATS``."""
    element: str
    """The element as the specification names it: ``materials[].alphaMode``, ``<inertial auto="true">``, ``f a/b/c``."""
    status: Status
    note: str
    """What is approximated or left out, or the value that the specification gives; empty = nothing to add."""
    test: str
    """The test that checks it."""


_RULES: list[Rule] = []


def rule(format: str, element: str, status: Status, note: str = "") -> Callable[[Test], Test]:
    """Marks a test as the check of one rule; a test may check several.

    Raises:
        ValueError: the format or status is unknown, or a note is missing where something is not done.
    """
    if format not in FORMATS:
        raise ValueError(f"format {format!r} is unknown; known: {', '.join(FORMATS)}")
    if status not in ("done", "approximated", "left out", "refused"):
        raise ValueError(f"status {status!r} is unknown")
    if status in ("approximated", "left out") and not note:
        raise ValueError(f"{format} {element}: say what is {status}")

    def mark(test: Test) -> Test:
        _RULES.append(Rule(format, element, status, note, test.__name__))
        return test

    return mark


def rules() -> list[Rule]:
    """Returns the rules of all test modules of this folder, by format and element."""
    for path in sorted(Path(__file__).parent.glob("test_*.py")):
        if path.stem != "test_table":
            importlib.import_module(f"conformance.{path.stem}")
    unique = dict.fromkeys(_RULES)
    return sorted(unique, key=lambda r: (FORMATS.index(r.format), r.element.lower(), r.status, r.test))


def page() -> str:
    """Returns the text of ``docs/formats.md``."""
    found = rules()
    lines = [
        "# File formats",
        "",
        "What is read of each format. Each row is a test in `tests/conformance`; `PYTHONPATH=tests python -m conformance.rules` writes this page.",
        "",
        "*done*: as the specification says. *approximated*, *left out*: with a warning that says what changes. *refused*: an error in one line.",
    ]
    for format in FORMATS:
        rows = [r for r in found if r.format == format]
        if not rows:
            continue
        lines += ["", f"## {format}", "", "| element | status | note |", "|---|---|---|"]
        seen = dict.fromkeys((r.element, r.status, r.note) for r in rows)
        lines += [
            f"| {_cell(f'`{element}`' if _is_code(element) else element)} | {status} | {_cell(note)} |"
            for element, status, note in seen
        ]
    return "\n".join(lines) + "\n"


def _is_code(element: str) -> bool:
    """Returns whether an element is written as code: not a sentence."""
    return "`" not in element and (" " not in element or any(c in element for c in "<>[]=_/"))


def _cell(text: str) -> str:
    """Returns text for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    from conformance import rules as module  # not __main__: the tests register their rules there

    PAGE.write_text(module.page())
    print(f"wrote {PAGE}: {len(module.rules())} rules")
