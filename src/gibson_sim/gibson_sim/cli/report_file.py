"""Common parts of measuring commands: JSON report, progress on stderr, options."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.settings import nearest
from gibson_sim.writing import write_file


def add_report_options(parser: argparse.ArgumentParser, *, markdown: bool = True) -> None:
    """Adds ``--json`` and, if the table can be Markdown, ``--markdown``."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write")
    if markdown:
        parser.add_argument("--markdown", action="store_true", help="print Markdown")


def write_json(path: Path | None, values: Any) -> None:
    """Writes values to a JSON file and creates its folder if needed; ``path`` None = no file is requested.

    Raises:
        WriteError: the file cannot be written.
    """
    if path is not None:
        write_file(path, json.dumps(values, indent=1) + "\n")


def parse_size(text: str) -> tuple[int, int]:
    """Parses width and height, pixels, such as ``640x480``.

    Raises:
        ConfigError: the text is not a size.
    """
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise ConfigError(f"--sizes: {text!r} is not an image size; must be WIDTHxHEIGHT, such as 640x480")
    return int(width), int(height)


def parse_device(text: str | None) -> int | str | None:
    """Parses ``--device``: the index of an EGL device, or a part of its UUID; None = a GPU if available."""
    return int(text) if text is not None and text.isdigit() else text


def require_device(device: int | str | None) -> None:
    """Opens and closes a selected device, to fail before the scene is loaded.

    Raises:
        GraphicsUnavailableError: the device does not exist or cannot render.
    """
    if device is not None:
        from gibson_sim.render.context import open_context

        open_context(device).close()


def chosen(text: str, known: Collection[str]) -> tuple[str, ...]:
    """Parses ``--only``, names separated by commas; empty = all of ``known``.

    Raises:
        ConfigError: a name is unknown.
    """
    names = tuple(name for name in text.split(",") if name) or tuple(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        hint = nearest(unknown[0], tuple(known))
        raise ConfigError(f"--only: {', '.join(unknown)} must be of {', '.join(known)}{f'; {hint}' if hint else ''}")
    return names


def print_progress(line: str) -> None:
    """Prints progress on stderr; tables go to stdout."""
    print(line, file=sys.stderr, flush=True)
