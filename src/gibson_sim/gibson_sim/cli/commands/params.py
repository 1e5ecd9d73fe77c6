"""``gibson-sim params``: lists all settings of all nodes, as text or as the tables of docs/parameters.md."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping
from dataclasses import Field
from typing import Any

from gibson_sim.client_config import NODE_CONFIGS
from gibson_sim.settings import limits_of, parts_of, setting_fields


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("params", help="list every parameter of every node with type, default, limits and meaning")
    parser.add_argument(
        "node", nargs="?", choices=tuple(NODE_CONFIGS), metavar="NODE", help=f"{', '.join(NODE_CONFIGS)} (default: all)"
    )
    parser.add_argument("--markdown", action="store_true", help="print Markdown tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the settings; returns 0."""
    configs = {args.node: NODE_CONFIGS[args.node]} if args.node else NODE_CONFIGS
    print(markdown(configs) if args.markdown else text(configs), end="")
    return 0


def markdown(configs: Mapping[str, type[Any]] = NODE_CONFIGS) -> str:
    """Returns a Markdown table per node, or per part of its settings."""
    parts = []
    for node, cls in configs.items():
        parts.append(f"### `{node}`\n")
        for part in parts_of(cls).values():
            title = [] if part is cls else [f"**{inspect.getdoc(part)}**", ""]
            rows = ["| parameter | type | default | allowed | meaning |", "|---|---|---|---|---|"]
            rows += [
                f"| `{f.name}` | {type(f.default).__name__} | `{f.default!r}` | {allowed(f)} | {f.metadata['doc']} |"
                for f in setting_fields(part)
            ]
            parts.append("\n".join([*title, *rows]) + "\n")
    return "\n".join(parts)


def text(configs: Mapping[str, type[Any]] = NODE_CONFIGS) -> str:
    """Returns the settings as indented text."""
    lines = []
    for node, cls in configs.items():
        lines.append(node)
        for f in setting_fields(cls):
            limits = allowed(f)
            lines.append(f"  {f.name} = {f.default!r}{f'  ({limits})' if limits else ''}\n      {f.metadata['doc']}")
    return "\n".join(lines) + "\n"


def allowed(f: Field[Any]) -> str:
    """Returns the allowed values of a setting with their unit, as text."""
    return ", ".join(f.metadata["choices"]) or limits_of(f)
