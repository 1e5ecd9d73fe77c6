"""``gibson-sim scene``: creates, imports, checks and draws scenes. Each sub-command has a separate module, in this or another package."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from gibson_sim.cli.registry import scene_command_modules


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("scene", help="make, import, check, map and render scenes")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    for module in dict.fromkeys(scene_command_modules().values()):
        import_module(module).add_parser(kinds)
