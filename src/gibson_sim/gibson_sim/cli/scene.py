"""``gibson-sim scene``: make, import, check and look at scenes. Each sub-command has a module of its own."""

from __future__ import annotations

from types import ModuleType
from typing import Any

from gibson_sim.cli import (
    scene_collision,
    scene_fetch,
    scene_generate,
    scene_import,
    scene_inspect,
    scene_map,
    scene_objects,
    scene_robot,
    scene_scan,
    scene_view,
)

_COMMANDS: tuple[ModuleType, ...] = (
    scene_collision,
    scene_fetch,
    scene_generate,
    scene_import,
    scene_inspect,
    scene_map,
    scene_objects,
    scene_robot,
    scene_scan,
    scene_view,
)


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("scene", help="make, import, check and look at scenes")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    for command in _COMMANDS:
        command.add_parser(kinds)
