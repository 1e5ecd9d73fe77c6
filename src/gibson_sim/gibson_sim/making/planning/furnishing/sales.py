"""Furniture of the sales room of a shop."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gibson_sim.making.planning.furnishing.dressing import fill_corners
from gibson_sim.making.planning.furnishing.groups import Group, by_wall, near_corner
from gibson_sim.making.planning.rectangles import Rect, around
from gibson_sim.making.planning.rooms import Gate
from gibson_sim.making.planning.space import FurnishedRoom, Part

_ENTRY = 2.1
"""Floor without gondolas behind the front, metres."""


def furnish_shop(room: FurnishedRoom) -> bool:
    """Furnishes a sales room: till by the entrance, fridge and shelves along the walls, gondolas in rows between."""
    entrance = next(gate for gate in room.view.gates if not gate.other_room)
    if not _put_till(room, entrance) or not by_wall(room, "display_fridge", near_corner(room, 1.8)):
        return False
    aisle = round(float(room.rng.uniform(1.2, 1.5)), 2)
    if not _put_gondolas(room, entrance, aisle):
        return False
    _line_walls(room)
    fill_corners(room, "plant", 2)
    return True


def _line_walls(room: FurnishedRoom) -> None:
    """Lines the walls with shelves, those along one stretch of wall equally wide."""
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


def _put_till(room: FurnishedRoom, entrance: Gate) -> bool:
    """Places the till beside the entrance, its front to the way in, with room for who stands behind it."""
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
                    till = Part("till", point, round(yaw, 6) + 0.0, size)
                    behind = around(till.ahead(-size[0] / 2 - 0.4), yaw, 0.8, size[1])
                    yield [till], [till.front(0.9), behind]

    return bool(room.place_first(groups()))


def _put_gondolas(room: FurnishedRoom, entrance: Gate, aisle: float) -> int:
    """Fills the middle of the largest part of the room with rows of gondolas; returns how many."""
    hall = _behind_front(max(room.view.cells, key=lambda c: c.area), entrance)
    # Shelves of half a metre stand along the walls, with an aisle before them.
    inner = hall.grown(-0.5 - aisle)
    depth, _, height = room.size("gondola")
    lengthwise = room.rng.random() < 0.6
    upright = (entrance.face.normal[1] != 0) == lengthwise
    across, along = (inner.width, inner.depth) if upright else (inner.depth, inner.width)
    rows = int((across + aisle) / (depth + aisle) + 1e-6)
    if along < 2.0 or rows < 1:
        return 0
    each = 1 if along <= 4.0 else 2
    gap = 0.0 if along <= 5.0 else aisle
    length = round(min(4.0, (along - (each - 1) * gap) / each), 2)
    pitch = across / rows if rows == 1 else (across - depth) / (rows - 1)
    count = 0
    for row in range(rows):
        off = across / 2 if rows == 1 else depth / 2 + row * pitch
        for n in range(each):
            at = along / 2 + (n - (each - 1) / 2) * (length + gap)
            count += _put_gondola(room, inner, upright, off, at, (depth, length, height), aisle)
    return count


def _put_gondola(
    room: FurnishedRoom, inner: Rect, upright: bool, off: float, at: float, size: tuple[float, float, float], aisle: float
) -> bool:
    """Places one gondola, a shorter one where there is something at its end."""
    for length in (size[1], size[1] - 0.6, size[1] - 1.2):
        for shift in (0.0, (size[1] - length) / 2, (length - size[1]) / 2):
            if length < 2.0:
                return False
            middle = (inner.x0 + off, inner.y0 + at + shift) if upright else (inner.x0 + at + shift, inner.y0 + off)
            part = Part("gondola", middle, 0.0 if upright else round(math.pi / 2, 6), (size[0], round(length, 2), size[2]))
            depth = min(1.0, aisle - 0.05)
            if room.place([part], [part.front(depth), around(part.ahead(-(size[0] + depth) / 2), part.yaw, depth, length)]):
                return True
    return False


def _behind_front(hall: Rect, entrance: Gate) -> Rect:
    """Returns a room without a stretch behind its front."""
    x, y = entrance.face.normal
    spare = _ENTRY - 1.7
    return Rect(
        hall.x0 + spare * max(x, 0.0), hall.y0 + spare * max(y, 0.0), hall.x1 + spare * min(x, 0.0), hall.y1 + spare * min(y, 0.0)
    )
