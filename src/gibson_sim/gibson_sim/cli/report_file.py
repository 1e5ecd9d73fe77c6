"""The JSON file of a measurement."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError


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


def parse_size(text: str) -> tuple[int, int]:
    """Returns width and height, pixels, of ``640x480``.

    Raises:
        ConfigError: it is no size.
    """
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise ConfigError(f"--sizes: {text!r} is no size of an image; write 640x480")
    return int(width), int(height)
