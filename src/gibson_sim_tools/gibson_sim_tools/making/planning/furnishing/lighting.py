"""Lamps under the ceiling, and what shines in all lamps."""

from __future__ import annotations

import math

from gibson_sim_tools.making.building import Lamp
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.space import FurnishedRoom, Part

_COOL = ("office", "open_office", "meeting", "shop", "storage", "kitchenette", "corridor")
_APART = 1.3
"""From a pendant to the next lamp, metres."""
_TABLES = ("dining_table", "meeting_table")


def light(room: FurnishedRoom) -> None:
    """Hangs lamps: a pendant above each table to eat at, panels in offices and shops, round lamps elsewhere; each shines."""
    _above_tables(room)
    panels = room.kind in ("office", "open_office", "meeting", "shop", "kitchenette")
    spacing = 3.0 if panels else 4.2
    warm = 4000.0 if room.kind in _COOL and panels else 3000.0
    kind = "panel_lamp" if panels else "ceiling_lamp"
    for cell in room.view.cells:
        if min(cell.width, cell.depth) < 0.8 or cell.area < 1.5:
            continue
        for middle in _grid(cell, spacing):
            if any(math.dist(p.middle, middle) < _APART for p in room.parts if p.kind == "pendant_lamp"):
                continue
            size = room.size(kind)
            part = Part(kind, middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([part]):
                share = cell.area / len(_grid(cell, spacing))
                _shine(room, part, "panel" if panels else "ceiling", 12.0 + 5.0 * share, warm)
    _standing(room)


def _grid(cell: Rect, spacing: float) -> list[tuple[float, float]]:
    """Returns evenly spread points of a rectangle."""
    columns, rows = max(1, round(cell.width / spacing)), max(1, round(cell.depth / spacing))
    return [
        (round(cell.x0 + cell.width * (c + 0.5) / columns, 3), round(cell.y0 + cell.depth * (r + 0.5) / rows, 3))
        for c in range(columns)
        for r in range(rows)
    ]


def _above_tables(room: FurnishedRoom) -> None:
    """Hangs pendants above tables, which need no way below them."""
    for table in [p for p in room.parts if p.kind in _TABLES]:
        count = 2 if table.size[1] > 2.2 else 1
        for n in range(count):
            size = room.size("pendant_lamp", height=min(0.9, room.height - 1.6))
            middle = table.ahead(0.0, table.size[1] * ((n + 0.5) / count - 0.5))
            part = Part("pendant_lamp", middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([part]):
                _shine(room, part, "pendant", 35.0, 2700.0)


def _standing(room: FurnishedRoom) -> None:
    """Lights lamps that stand on the floor or on desks."""
    for part in room.parts:
        if part.kind == "floor_lamp":
            _shine(room, part, "floor", 25.0, 2700.0)
        elif part.kind == "desk_lamp":
            _shine(room, part, "desk", 8.0, 3000.0)


def _shine(room: FurnishedRoom, part: Part, kind: str, power: float, temperature: float) -> None:
    """Adds the light of a lamp: below one that hangs, in the shade of one that stands."""
    hangs = kind in ("ceiling", "pendant", "panel")
    # A hand's breadth below what hangs, so that its own body does not keep the light in.
    z = part.lift - 0.03 if hangs else part.lift + part.size[2] - (0.15 if kind == "floor" else 0.1)
    size = math.floor(min(part.size[0], part.size[1]) * 80.0) / 100.0
    position = (round(part.middle[0], 4), round(part.middle[1], 4), round(room.floor_z + z, 4))
    room.things.lamps.append(Lamp(kind, position, round(power, 1), temperature, size))  # type: ignore[arg-type]
