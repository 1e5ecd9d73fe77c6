"""The JSON file of a measurement."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any


def add_report_options(parser: argparse.ArgumentParser, *, markdown: bool = True) -> None:
    """Adds ``--json`` and, where the table can be Markdown, ``--markdown``."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write")
    if markdown:
        parser.add_argument("--markdown", action="store_true", help="print Markdown")


def write_json(path: Path | None, values: Any) -> None:
    """Writes values into a file; its folder is made where it is missing. ``None`` = no file was asked for."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
