"""``gibson-sim params``: every setting of every node, as text or as the README's table."""

from __future__ import annotations

import argparse
import math
from dataclasses import Field, fields
from typing import Any

from gibson_sim.client_config import NODE_CONFIGS


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("params", help="list every parameter of every node with type, default, limits and meaning")
    parser.add_argument("--markdown", action="store_true", help="as Markdown tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the settings; returns 0."""
    print(markdown() if args.markdown else text(), end="")
    return 0


def markdown() -> str:
    """Returns one Markdown table a node."""
    parts = []
    for node, cls in NODE_CONFIGS.items():
        rows = ["| parameter | type | default | allowed | meaning |", "|---|---|---|---|---|"]
        rows += [
            f"| `{f.name}` | {type(f.default).__name__} | `{f.default!r}` | {allowed(f)} | {f.metadata['doc']} |"
            for f in fields(cls)
        ]
        parts.append(f"### `{node}`\n\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def text() -> str:
    """Returns the settings as indented text."""
    lines = []
    for node, cls in NODE_CONFIGS.items():
        lines.append(node)
        for f in fields(cls):
            limits = allowed(f)
            lines.append(f"  {f.name} = {f.default!r}{f'  ({limits})' if limits else ''}\n      {f.metadata['doc']}")
    return "\n".join(lines) + "\n"


def allowed(f: Field[Any]) -> str:
    """Returns what values a setting may have, with their unit, in words."""
    low, high, unit = f.metadata["minimum"], f.metadata["maximum"], f.metadata["unit"]
    if f.metadata["choices"]:
        return ", ".join(f.metadata["choices"])
    if math.isinf(low) and math.isinf(high):
        return str(unit)
    limits = f"{low:g} to {high:g}" if not math.isinf(high) else f"{low:g} or more"
    return f"{limits} {unit}".strip()
