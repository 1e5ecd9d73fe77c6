"""Furniture of the sales room of a shop."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gibson_sim_tools.making.planning.furnishing.dressing import fill_corners
from gibson_sim_tools.making.planning.furnishing.groups import Group, by_wall, near_corner
from gibson_sim_tools.making.planning.rectangles import Rect, around
from gibson_sim_tools.making.planning.rooms import GateView
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_SPARE = 0.4
"""Free depth behind the front, in addition to shelf and aisle, metres."""


def furnish_shop(room: FurnishedRoom) -> bool:
    """Furnishes a sales room: till by the entrance, fridge and shelves along the walls, gondolas in rows between."""
    entrance = next(gate for gate in room.view.gates if not gate.other_room)
    if not _put_till(room, entrance) or not by_wall(room, "display_fridge", near_corner(room, 1.8)):
        return False
    aisle = round(float(room.rng.uniform(1.15, 1.35)), 2)
    if not _put_gondolas(room, entrance, aisle):
        return False
    _line_walls(room)
    fill_corners(room, "plant", 2)
    return True


def _line_walls(room: FurnishedRoom) -> None:
    """Lines the walls with shelves of equal width per free interval."""
    depth, _, height = room.size("wall_shelf")
    for face in room.view.sides:
        for low, high in room.stretches(face, depth + 0.02, height):
            count = max(1, math.ceil((high - low) / 3.0))
            width = math.floor((high - low) / count * 100.0) / 100.0 - 0.01
            if width < 1.5:
                continue
            for n in range(count):
                shelf = room.on_wall("wall_shelf", face, low + (high - low) * (n + 0.5) / count, (depth, width, height))
                room.place([shelf], [shelf.front(0.9)])


def _put_till(room: FurnishedRoom, entrance: GateView) -> bool:
    """Places the till beside the entrance, facing it, with free floor for the cashier."""
    size = room.size("till")
    face, middle = entrance.face, entrance.opening.middle
    signs = (1, -1) if room.rng.random() < 0.5 else (-1, 1)

    def groups() -> Iterator[Group]:
        for aside in (1.5, 1.3, 1.8, 2.2, 2.6):
            for off in (0.5, 0.9, 1.3, 0.3):
                for sign in signs:
                    # Its front looks along the wall, towards the entrance.
                    yaw = math.atan2(-sign * face.along[1], -sign * face.along[0])
                    point = face.point(middle + sign * (aside + size[0] / 2), off + size[1] / 2)
                    till = FurnishingItem("till", point, round(yaw, 6) + 0.0, size)
                    behind = around(till.ahead(-size[0] / 2 - 0.4), yaw, 0.8, size[1])
                    yield [till], [till.front(0.9), behind]

    return bool(room.place_first(groups()))


def _put_gondolas(room: FurnishedRoom, entrance: GateView, aisle: float) -> int:
    """Fills the centre of the largest part of the room with rows of gondolas; returns their number."""
    # Shelves stand along the walls, with an aisle before them.
    inner = _behind_front(_largest(room), entrance).grown(-0.47 - aisle)
    depth, _, height = room.size("gondola")
    upright, rows, each, length = max(
        (_rows(inner, upright, depth, aisle) for upright in (True, False)), key=lambda found: found[1] * found[2] * found[3]
    )
    across, along = (inner.width, inner.depth) if upright else (inner.depth, inner.width)
    gap = aisle if each * (length + aisle) - aisle <= along + 1e-6 else 0.0
    pitch = (across - depth) / (rows - 1) if rows > 1 else 0.0
    count = 0
    for row in range(rows):
        off = depth / 2 + row * pitch if rows > 1 else across / 2
        for n in range(each):
            at = along / 2 + (n - (each - 1) / 2) * (length + gap)
            count += _put_gondola(room, inner, upright, off, at, (depth, length, height), aisle)
    return count


def _rows(inner: Rect, upright: bool, depth: float, aisle: float) -> tuple[bool, int, int, float]:
    """Returns how gondolas fill a rectangle: ``upright``, rows, gondolas per row, length of each."""
    across, along = (inner.width, inner.depth) if upright else (inner.depth, inner.width)
    rows = max(0, int((across + aisle) / (depth + aisle) + 1e-6))
    each = 1 if along <= 4.0 else 2
    gap = aisle if along > 5.0 else 0.0
    length = round(min(4.0, (along - (each - 1) * gap) / each) - 0.005, 2)
    return upright, rows if length >= 2.0 else 0, each, length


def _largest(room: FurnishedRoom) -> Rect:
    """Returns the largest rectangle within the walls."""
    cells = room.view.cells
    xs, ys = sorted({x for c in cells for x in (c.x0, c.x1)}), sorted({y for c in cells for y in (c.y0, c.y1)})
    rects = (Rect(x0, y0, x1, y1) for x0 in xs for x1 in xs for y0 in ys for y1 in ys if x0 < x1 and y0 < y1)
    return max((r for r in rects if room.view.holds(r)), key=lambda r: r.area)


def _put_gondola(
    room: FurnishedRoom, inner: Rect, upright: bool, off: float, at: float, size: tuple[float, float, float], aisle: float
) -> bool:
    """Places one gondola, shortened if something is at its end."""
    for length in (size[1], size[1] - 0.6, size[1] - 1.2):
        for shift in (0.0, (size[1] - length) / 2, (length - size[1]) / 2):
            if length < 2.0:
                return False
            middle = (inner.x0 + off, inner.y0 + at + shift) if upright else (inner.x0 + at + shift, inner.y0 + off)
            item = FurnishingItem(
                "gondola", middle, 0.0 if upright else round(math.pi / 2, 6), (size[0], round(length, 2), size[2])
            )
            depth = min(1.0, aisle - 0.05)
            if room.place([item], [item.front(depth), around(item.ahead(-(size[0] + depth) / 2), item.yaw, depth, length)]):
                return True
    return False


def _behind_front(hall: Rect, entrance: GateView) -> Rect:
    """Returns a room without a strip behind its front."""
    x, y = entrance.face.normal
    return Rect(
        hall.x0 + _SPARE * max(x, 0.0),
        hall.y0 + _SPARE * max(y, 0.0),
        hall.x1 + _SPARE * min(x, 0.0),
        hall.y1 + _SPARE * min(y, 0.0),
    )
