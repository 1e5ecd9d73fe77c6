"""The README's tables are what the program prints."""

from __future__ import annotations

import re
from pathlib import Path

from gibson_sim.cli.params import markdown


def test_parameter_tables_are_those_of_the_program(root: Path) -> None:
    text = (root / "README.md").read_text()
    found = re.search(r"<!-- parameters: [^\n]*-->\n(.*?)<!-- end of parameters -->", text, re.DOTALL)
    assert found
    assert found.group(1).strip() == markdown().strip(), "paste what `gibson-sim params --markdown` prints"


def test_local_links_lead_somewhere(root: Path) -> None:
    for page in [root / "README.md", *root.glob("*.md"), *(root / "docs").glob("*.md")]:
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"
