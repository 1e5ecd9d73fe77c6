"""Adds radiators, curtains, pictures and plants to rooms."""

from __future__ import annotations

import math

from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_ROOMS_WITH_CURTAINS = ("living", "bedroom", "study")


def hang_radiators(room: FurnishedRoom) -> None:
    """Adds a radiator below each window that is high and wide enough, except in rooms with counters."""
    if room.kind in ("kitchen", "kitchenette", "shop", "storage", "toilet"):
        return
    for window in room.view.windows:
        width = min(1.4, window.opening.width - 0.1)
        if width >= 0.6:
            size = room.size("radiator", width=width)
            room.place([room.on_wall("radiator", window.face, window.opening.middle, size, room.lift("radiator"), 0.02)])


def hang_curtains(room: FurnishedRoom) -> None:
    """Hangs curtains on both sides of each window if both fit, else none."""
    if room.kind not in _ROOMS_WITH_CURTAINS or room.rng.random() < 0.15:
        return
    for window in room.view.windows:
        size = room.size("curtain", height=min(room.height - 0.2, 2.4))
        half = (window.opening.width + size[1]) / 2
        lift = room.lift("curtain")
        room.place([room.on_wall("curtain", window.face, window.opening.middle + s * half, size, lift) for s in (-1, 1)])


def hang_above(room: FurnishedRoom, kind: str, item: FurnishingItem, face: WallFace, *, min_gap: float = 0.25) -> bool:
    """Hangs a piece on the wall above an item, centred.

    Args:
        room: the room.
        kind: kind of the piece.
        item: the item below.
        face: the wall.
        min_gap: minimum distance between the two, metres.
    """
    along = (item.middle[0] - face.start[0]) * face.along[0] + (item.middle[1] - face.start[1]) * face.along[1]
    limits = CATALOGUE[kind].lift
    low = max(limits[0], item.lift + item.size[2] + min_gap)
    size = room.size(
        kind, width=min(float(room.rng.uniform(*CATALOGUE[kind].width)), max(item.size[1] - 0.1, CATALOGUE[kind].width[0]))
    )
    return low <= limits[1] + 0.15 and room.place(
        [room.on_wall(kind, face, along, size, max(low, min(room.lift(kind), limits[1])), 0.005)]
    )


def hang_pictures(room: FurnishedRoom, count: int) -> None:
    """Hangs pictures on bare walls, centred in the free intervals."""
    hung: list[FurnishingItem] = []
    for _ in range(count):
        size, lift = room.size("painting"), room.lift("painting")

        def picture_score(face: WallFace, along: float) -> float:
            point = face.point(along)
            distance = min((math.dist(point, p.middle) for p in hung), default=3.0)
            return 2.0 * min(distance, 3.0) + min(room.corner_gap(face, along, 0.4), 1.2) - (1.0 if face.outer else 0.0)

        for face, along in room.wall_positions(size[1] + 0.3, score=picture_score, step=0.25):
            item = room.on_wall("painting", face, along, size, lift, 0.005)
            if room.place([item]):
                hung.append(item)
                break


def fill_corners(room: FurnishedRoom, kind: str, count: int) -> None:
    """Places pieces in free corners, those far from doors first."""
    for _ in range(count):
        size = room.size(kind)
        side = max(size[0], size[1])
        half = size[1] / 2 + 0.06
        corners = [
            (face, along)
            for face in room.view.sides
            for along in (face.low + half, face.high - half)
            if _in_corner(room, face, along)
        ]
        corners.sort(key=lambda spot: -room.distance_to_doors(spot[0].point(spot[1], side)) + float(room.rng.random()))
        for face, along in corners:
            if face.length > side + 0.3 and room.place([room.on_wall(kind, face, along, size, gap=0.06)]):
                break


def _in_corner(room: FurnishedRoom, face: WallFace, along: float) -> bool:
    """Returns whether the nearer end of a wall is an inside corner of the room."""
    end = face.low - 0.05 if along < (face.low + face.high) / 2 else face.high + 0.05
    return not any(cell.holds(face.point(end, 0.1)) for cell in room.view.cells)
