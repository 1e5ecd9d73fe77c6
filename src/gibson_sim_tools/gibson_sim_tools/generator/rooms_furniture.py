"""Furnishes the scan-like rooms: rounded boxes along the walls, clear of doors and of the camera path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Rgb = tuple[float, float, float]
Rect = tuple[float, float, float, float]
_PATH_CLEARANCE = 0.4
"""Minimum distance between the camera path and furniture, m."""
_CORNER = 1.0
"""Distance of furniture at walls along y from corners, which furniture at walls along x may occupy, m."""


@dataclass(frozen=True)
class RoundedBox:
    """A box with rounded edges, m; a ball if the radius is half its size."""

    center: tuple[float, float, float]
    half: tuple[float, float, float]
    radius: float
    pattern: str
    color: Rgb
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the piece of furniture, world frame."""
    yaw: float = 0.0
    """Yaw of the piece of furniture, radians."""

    def to_world(self, local: F64) -> F64:
        """Transforms points, (N, 3), relative to the centre of the box, to the world frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        points: F64 = (local + self.center) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + self.origin
        return points


@dataclass(frozen=True)
class RoomsPiece:
    """A piece of furniture. In its frame, its base is at z = 0, its back at y = 0, and it extends from x = 0 to its width."""

    name: str
    semantic_class: str
    size: tuple[float, float]
    """Width and depth, m."""
    boxes: tuple[RoundedBox, ...]


def _box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, r: float, pattern: str, color: Rgb) -> RoundedBox:
    half = ((x1 - x0) / 2, (y1 - y0) / 2, (z1 - z0) / 2)
    return RoundedBox(((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), half, min(r, 0.999 * min(half)), pattern, color)


def _ball(x: float, y: float, z: float, r: float, pattern: str, color: Rgb) -> RoundedBox:
    return _box(x - r, x + r, y - r, y + r, z - r, z + r, r, pattern, color)


def _legs(w: float, d: float, h: float, color: Rgb, thickness: float = 0.05) -> list[RoundedBox]:
    return [
        _box(x, x + thickness, y, y + thickness, 0.0, h, 0.01, "wood", color)
        for x in (0.03, w - 0.03 - thickness)
        for y in (0.05, d - 0.03 - thickness)
    ]


def _color(rng: np.random.Generator) -> Rgb:
    r, g, b = rng.uniform(0.25, 0.85, 3)
    return (float(r), float(g), float(b))


def _wood(rng: np.random.Generator) -> Rgb:
    f = float(rng.uniform(0.5, 1.1))
    return (0.68 * f, 0.48 * f, 0.30 * f)


def _table(rng: np.random.Generator) -> RoomsPiece:
    w, d, wood = float(rng.uniform(1.0, 1.5)), 0.7, _wood(rng)
    boxes = [*_legs(w, d, 0.71, wood), _box(0, w, 0.02, d, 0.70, 0.74, 0.015, "wood", wood)]
    boxes.append(_ball(0.3 * w, 0.35, 0.84, 0.1, "stripes", _color(rng)))
    boxes.append(_box(0.55 * w, 0.55 * w + 0.3, 0.2, 0.42, 0.74, 0.79, 0.01, "books", _color(rng)))
    return RoomsPiece("", "table", (w, d), tuple(boxes))


def _sofa(rng: np.random.Generator) -> RoomsPiece:
    w, d, cloth, other = float(rng.uniform(1.5, 1.9)), 0.85, _color(rng), _color(rng)
    boxes = [
        _box(0, w, 0.02, d, 0.08, 0.42, 0.07, "fabric", cloth),
        _box(0, w, 0.02, 0.25, 0.3, 0.85, 0.08, "fabric", cloth),
        _box(0, 0.18, 0.05, d, 0.2, 0.6, 0.07, "fabric", cloth),
        _box(w - 0.18, w, 0.05, d, 0.2, 0.6, 0.07, "fabric", cloth),
        _box(0.25, 0.7, 0.22, 0.38, 0.42, 0.78, 0.07, "stripes", other),
        _box(w - 0.7, w - 0.25, 0.22, 0.38, 0.42, 0.78, 0.07, "stripes", other),
    ]
    return RoomsPiece("", "sofa", (w, d), tuple(boxes))


def _cupboard(rng: np.random.Generator) -> RoomsPiece:
    w, d, h, wood = float(rng.uniform(0.8, 1.2)), 0.45, float(rng.uniform(0.9, 2.0)), _wood(rng)
    boxes = [_box(0, w, 0.02, d, 0.0, h, 0.02, "wood", wood)]
    for x in (0.02, w / 2 + 0.01):
        boxes.append(_box(x, x + w / 2 - 0.03, d - 0.01, d + 0.02, 0.08, h - 0.04, 0.01, "wood", wood))
    boxes += [_ball(w / 2 + x, d + 0.03, 0.55 * h, 0.02, "plaster", (0.3, 0.3, 0.3)) for x in (-0.06, 0.06)]
    return RoomsPiece("", "cupboard", (w, d + 0.05), tuple(boxes))


def _shelf(rng: np.random.Generator) -> RoomsPiece:
    w, d, h, wood = float(rng.uniform(0.7, 1.1)), 0.3, 1.8, _wood(rng)
    boxes = [_box(x, x + 0.03, 0.02, d, 0.0, h, 0.005, "wood", wood) for x in (0.0, w - 0.03)]
    for level in range(5):
        z = 0.05 + 0.42 * level
        boxes.append(_box(0.02, w - 0.02, 0.02, d, z, z + 0.03, 0.005, "wood", wood))
        if level < 4:
            end = float(rng.uniform(0.4, 0.95)) * w
            boxes.append(
                _box(0.04, end, 0.03, 0.24, z + 0.03, z + float(rng.uniform(0.22, 0.33)), 0.01, "books", (0.5, 0.4, 0.3))
            )
    return RoomsPiece("", "shelf", (w, d), tuple(boxes))


def _bed(rng: np.random.Generator) -> RoomsPiece:
    w, d, cloth, wood = 1.95, 0.9, _color(rng), _wood(rng)
    boxes = [
        _box(0, w, 0.02, d, 0.1, 0.3, 0.02, "wood", wood),
        _box(0.02, w - 0.02, 0.03, d - 0.02, 0.28, 0.5, 0.08, "fabric", (0.88, 0.87, 0.83)),
        _box(0.6, w, 0.02, d, 0.42, 0.56, 0.06, "carpet", cloth),
        _box(0.08, 0.5, 0.15, d - 0.15, 0.46, 0.62, 0.07, "fabric", (0.9, 0.9, 0.9)),
        _box(0, 0.05, 0.02, d, 0.1, 0.95, 0.02, "wood", wood),
    ]
    return RoomsPiece("", "bed", (w, d), tuple(boxes))


def _chair(rng: np.random.Generator) -> RoomsPiece:
    w, wood = 0.46, _wood(rng)
    boxes = [*_legs(w, w, 0.44, wood, 0.04), _box(0, w, 0.03, w, 0.43, 0.48, 0.02, "fabric", _color(rng))]
    boxes.append(_box(0, w, 0.03, 0.08, 0.46, 0.95, 0.02, "wood", wood))
    return RoomsPiece("", "chair", (w, w), tuple(boxes))


def _lamp(rng: np.random.Generator) -> RoomsPiece:
    boxes = [
        _box(0.05, 0.35, 0.05, 0.35, 0.0, 0.04, 0.015, "plaster", (0.25, 0.25, 0.26)),
        _box(0.185, 0.215, 0.185, 0.215, 0.03, 1.45, 0.01, "plaster", (0.3, 0.3, 0.3)),
        _box(0.02, 0.38, 0.02, 0.38, 1.35, 1.7, 0.12, "stripes", (0.95, 0.88, 0.7)),
    ]
    return RoomsPiece("", "lamp", (0.4, 0.4), tuple(boxes))


def _plant(rng: np.random.Generator) -> RoomsPiece:
    boxes = [_box(0.1, 0.4, 0.1, 0.4, 0.0, 0.32, 0.06, "plaster", (0.62, 0.33, 0.22))]
    for _ in range(9):
        x, y = rng.uniform(0.12, 0.38, 2)
        green = (0.16, float(rng.uniform(0.32, 0.55)), 0.14)
        boxes.append(_ball(float(x), float(y), float(rng.uniform(0.45, 1.1)), float(rng.uniform(0.06, 0.12)), "carpet", green))
    return RoomsPiece("", "plant", (0.5, 0.5), tuple(boxes))


_MAKERS: tuple[Callable[[np.random.Generator], RoomsPiece], ...] = (
    _table,
    _sofa,
    _cupboard,
    _shelf,
    _bed,
    _chair,
    _lamp,
    _plant,
    _chair,
)


def furnish(
    rooms: Sequence[Rect], doors: Sequence[tuple[int, float, float]], path: F64, rng: np.random.Generator
) -> Iterator[RoomsPiece]:
    """Yields placed pieces with unique names.

    Args:
        rooms: inner faces of the walls of each room, (x0, y0, x1, y1), metres.
        doors: axis of passage, coordinate along it, and centre along the wall, of each door.
        path: camera path, (M, 2), metres.
        rng: samples kinds and positions.
    """
    count: dict[str, int] = {}
    for room in rooms:
        for piece in (*_along_walls(room, doors, rng), *_free_standing(room, rng)):
            if not _is_clear(piece, path):
                continue
            count[piece.semantic_class] = count.get(piece.semantic_class, 0) + 1
            yield replace(piece, name=f"{piece.semantic_class}_{count[piece.semantic_class]}")


def _along_walls(room: Rect, doors: Sequence[tuple[int, float, float]], rng: np.random.Generator) -> Iterator[RoomsPiece]:
    x0, y0, x1, y1 = room
    # Wall: axis of its normal, coordinate, start, end, yaw of a piece (its y points into the room), origin of a piece at ``s`` along the wall.
    walls = (
        (1, y0, x0, x1, 0.0, lambda s, w: (s, y0, 0.0)),
        (1, y1, x0, x1, math.pi, lambda s, w: (s + w, y1, 0.0)),
        (0, x0, y0 + _CORNER, y1 - _CORNER, -math.pi / 2, lambda s, w: (x0, s + w, 0.0)),
        (0, x1, y0 + _CORNER, y1 - _CORNER, math.pi / 2, lambda s, w: (x1, s, 0.0)),
    )
    for axis, at, start, end, yaw, place in walls:
        door_centers = sorted(
            m for a, door_at, m in doors if a == axis and abs(door_at - at) < 0.1 and start - 1.0 < m < end + 1.0
        )
        edges = [start + 0.08, *(e for m in door_centers for e in (m - 0.65, m + 0.65)), end - 0.08]
        for low, high in zip(edges[::2], edges[1::2], strict=True):
            s = low + float(rng.uniform(0.0, 0.3))
            while high - s > 0.4:
                piece = _MAKERS[int(rng.integers(len(_MAKERS)))](rng)
                if piece.size[0] <= high - s:
                    yield _placed(piece, place(s, piece.size[0]), yaw)
                    s += piece.size[0]
                s += float(rng.uniform(0.1, 0.35))


def _free_standing(room: Rect, rng: np.random.Generator) -> Iterator[RoomsPiece]:
    x, y = (room[0] + room[2]) / 2, (room[1] + room[3]) / 2
    lamp = (
        _box(-0.01, 0.01, -0.01, 0.01, 2.25, 2.62, 0.004, "plaster", (0.2, 0.2, 0.2)),
        _ball(0.0, 0.0, 2.15, 0.17, "stripes", (0.97, 0.93, 0.82)),
    )
    yield _placed(RoomsPiece("", "ceiling_lamp", (0.0, 0.0), lamp), (x, y, 0.0), 0.0)
    for _ in range(3):
        r = float(rng.uniform(0.08, 0.2))
        at = (float(rng.uniform(room[0] + 1.0, room[2] - 1.0)), float(rng.uniform(room[1] + 1.0, room[3] - 1.0)), r)
        yield _placed(RoomsPiece("", "ball", (0.3, 0.3), (_ball(0.15, 0.15, 0.0, r, "stripes", _color(rng)),)), at, 0.0)


def _placed(piece: RoomsPiece, origin: tuple[float, float, float], yaw: float) -> RoomsPiece:
    return replace(piece, boxes=tuple(replace(b, origin=origin, yaw=yaw) for b in piece.boxes))


def _is_clear(piece: RoomsPiece, path: F64) -> bool:
    """Returns whether a piece is clear of the camera path; ceiling lamps always are."""
    if piece.semantic_class == "ceiling_lamp":
        return True
    box = piece.boxes[0]
    c, s = math.cos(-box.yaw), math.sin(-box.yaw)
    local = (path - box.origin[:2]) @ np.array([[c, s], [-s, c]])
    gap = np.maximum(np.maximum(-local, local - piece.size), 0.0)
    return bool(np.linalg.norm(gap, axis=1).min() > _PATH_CLEARANCE)
