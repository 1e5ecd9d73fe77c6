"""The README is short, cells of tables are short, links lead somewhere; the table of parameters is what the program prints."""

from __future__ import annotations

import re
from pathlib import Path

from gibson_sim.cli.commands.params import markdown

SHORT_CELLS = (
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "features.md",
    "first_session.md",
    "index.md",
    "commands.md",
    "web.md",
)
"""Pages whose tables have cells of at most 200 characters; elsewhere the limit is 300. A longer text is a section or a list."""


def test_parameter_tables_are_those_of_the_program(root: Path) -> None:
    text = (root / "docs" / "parameters.md").read_text()
    found = re.search(r"<!-- parameters: [^\n]*-->\n(.*?)<!-- end of parameters -->", text, re.DOTALL)
    assert found
    assert found.group(1).strip() == markdown().strip(), "paste what `gibson-sim params --markdown` prints"


def test_readme_fits_a_screen_or_two_and_begins_with_a_picture_and_two_commands(root: Path) -> None:
    lines = (root / "README.md").read_text().splitlines()
    assert len(lines) < 60
    assert [line for line in lines if len(line) > 120] == []
    first = lines[:17]
    assert sum(line.startswith("![") for line in first) == 1
    assert [line[:10] for line in first if line.startswith("$ ")] == ["$ make run"] * 2


def test_bullets_of_the_readme_have_at_most_two_lines(root: Path) -> None:
    assert _long_bullets((root / "README.md").read_text()) == []


def test_a_bullet_of_three_lines_is_found() -> None:
    assert _long_bullets("- one\n  two\n\ntext\n\n1. one\n   two\n   three\n- next\n") == ["1. one"]


def test_table_cells_are_short(root: Path) -> None:
    long = []
    for page in (*root.glob("*.md"), *(root / "docs").glob("*.md")):
        limit = 200 if page.name in SHORT_CELLS else 300
        long += [f"{page.name}: {len(cell)} characters: {cell[:60]}" for cell in _cells(page.read_text()) if len(cell) > limit]
    assert long == []


def test_an_escaped_bar_does_not_end_a_cell() -> None:
    assert _cells("text | text\n| `a\\|b` | c |\n") == ["`a\\|b`", "c"]


def _long_bullets(text: str) -> list[str]:
    """Returns the first line of each list item that has more than two lines."""
    items = re.findall(r"^ *(?:[-*]|\d+\.) .*(?:\n(?! *(?:[-*]|\d+\.) ) *\S.*)*", text, re.MULTILINE)
    return [item.splitlines()[0] for item in items if item.count("\n") > 1]


def _cells(text: str) -> list[str]:
    """Returns the cells of all tables."""
    rows = [line for line in text.splitlines() if line.startswith("|")]
    return [cell.strip() for row in rows for cell in re.split(r"(?<!\\)\|", row)[1:-1]]


def test_index_leads_to_every_page(root: Path) -> None:
    index = (root / "docs" / "index.md").read_text()
    missing = [page.name for page in (root / "docs").glob("*.md") if f"({page.name})" not in index and page.name != "index.md"]
    assert missing == []


def test_local_links_lead_somewhere(root: Path) -> None:
    for page in [root / "README.md", *root.glob("*.md"), *(root / "docs").glob("*.md")]:
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
