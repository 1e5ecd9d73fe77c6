"""The README is short and its links lead somewhere; the table of parameters is what the program prints."""

from __future__ import annotations

import re
from pathlib import Path

from gibson_sim.cli.commands.params import markdown


def test_parameter_tables_are_those_of_the_program(root: Path) -> None:
    text = (root / "docs" / "parameters.md").read_text()
    found = re.search(r"<!-- parameters: [^\n]*-->\n(.*?)<!-- end of parameters -->", text, re.DOTALL)
    assert found
    assert found.group(1).strip() == markdown().strip(), "paste what `gibson-sim params --markdown` prints"


def test_readme_fits_a_few_screens_and_its_first_shows_a_picture_and_two_commands(root: Path) -> None:
    lines = (root / "README.md").read_text().splitlines()
    assert len(lines) <= 120
    first = lines[:16]
    assert sum(line.startswith("![") for line in first) == 1
    assert [line[:10] for line in first if line.startswith("$ ")] == ["$ make run"] * 2


def test_index_leads_to_every_page(root: Path) -> None:
    index = (root / "docs" / "index.md").read_text()
    missing = [page.name for page in (root / "docs").glob("*.md") if f"({page.name})" not in index and page.name != "index.md"]
    assert missing == []


def test_local_links_lead_somewhere(root: Path) -> None:
    for page in [root / "README.md", *root.glob("*.md"), *(root / "docs").glob("*.md")]:
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
