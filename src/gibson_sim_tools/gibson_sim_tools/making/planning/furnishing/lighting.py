"""Places ceiling lamps, and adds the light sources of all lamps."""

from __future__ import annotations

import math

from gibson_sim_tools.making.building import Lamp
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_COOL_ROOMS = ("office", "open_office", "meeting", "shop", "storage", "kitchenette", "corridor")
_MIN_DISTANCE = 1.3
"""Minimum distance from a pendant to the next lamp, m."""
_TABLE_KINDS = ("dining_table", "meeting_table")


def add_lamps(room: FurnishedRoom) -> None:
    """Adds lamps and their light sources: pendants above dining and meeting tables, panels in offices and shops, round lamps elsewhere."""
    _above_tables(room)
    panels = room.kind in ("office", "open_office", "meeting", "shop", "kitchenette")
    spacing = 3.0 if panels else 4.2
    temperature = 4000.0 if room.kind in _COOL_ROOMS and panels else 3000.0
    kind = "panel_lamp" if panels else "ceiling_lamp"
    for cell in room.view.cells:
        if min(cell.width, cell.depth) < 0.8 or cell.area < 1.5:
            continue
        for middle in _grid(cell, spacing):
            if any(math.dist(p.middle, middle) < _MIN_DISTANCE for p in room.items if p.kind == "pendant_lamp"):
                continue
            size = room.size(kind)
            item = FurnishingItem(kind, middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([item]):
                lit_area = cell.area / len(_grid(cell, spacing))
                _add_light_source(room, item, "panel" if panels else "ceiling", 12.0 + 5.0 * lit_area, temperature)
    _light_standing_lamps(room)


def _grid(cell: Rect, spacing: float) -> list[tuple[float, float]]:
    """Returns evenly spaced points in a rectangle."""
    columns, rows = max(1, round(cell.width / spacing)), max(1, round(cell.depth / spacing))
    return [
        (round(cell.x0 + cell.width * (c + 0.5) / columns, 3), round(cell.y0 + cell.depth * (r + 0.5) / rows, 3))
        for c in range(columns)
        for r in range(rows)
    ]


def _above_tables(room: FurnishedRoom) -> None:
    """Hangs pendants above tables, where no headroom is needed."""
    for table in [p for p in room.items if p.kind in _TABLE_KINDS]:
        count = 2 if table.size[1] > 2.2 else 1
        for n in range(count):
            size = room.size("pendant_lamp", height=min(0.9, room.height - 1.6))
            middle = table.point_ahead(0.0, table.size[1] * ((n + 0.5) / count - 0.5))
            item = FurnishingItem("pendant_lamp", middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([item]):
                _add_light_source(room, item, "pendant", 35.0, 2700.0)


def _light_standing_lamps(room: FurnishedRoom) -> None:
    """Adds the light sources of floor lamps and desk lamps."""
    for item in room.items:
        if item.kind == "floor_lamp":
            _add_light_source(room, item, "floor", 25.0, 2700.0)
        elif item.kind == "desk_lamp":
            _add_light_source(room, item, "desk", 8.0, 3000.0)


def _add_light_source(room: FurnishedRoom, item: FurnishingItem, kind: str, power: float, temperature: float) -> None:
    """Adds the light source of a lamp: below a hanging lamp, in the shade of a standing one."""
    hangs = kind in ("ceiling", "pendant", "panel")
    # Slightly below a hanging lamp, so that its body does not block the light.
    z = item.lift - 0.03 if hangs else item.lift + item.size[2] - (0.15 if kind == "floor" else 0.1)
    size = math.floor(min(item.size[0], item.size[1]) * 80.0) / 100.0
    position = (round(item.middle[0], 4), round(item.middle[1], 4), round(room.floor_z + z, 4))
    room.furnishings.lamps.append(Lamp(kind, position, round(power, 1), temperature, size))  # type: ignore[arg-type]
