"""Views of rooms from inside: free floor, faces of the walls, and zones that doors and windows keep free.

Derived only from the finished walls, so that the furnishing and the check use the same geometry.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from gibson_sim_tools.making.building import Opening, Point, Room, Storey, Wall
from gibson_sim_tools.making.planning.rectangles import Rect, bounding_rect, is_covered, subtract

PASSAGE_DEPTH = 0.75
"""Depth of the free zone in front of a door or a passage, m."""
LEAF_DEPTH = 0.96
"""Depth of the free zone on the side to which a door opens, m."""
SLIDING_DEPTH = 0.15
"""Depth of the free zone of a sliding leaf, m."""
WINDOW_DEPTH = 0.45
"""Depth of the zone in front of a window in which nothing is higher than the sill, m."""


@dataclass(frozen=True, slots=True)
class WallFace:
    """The side of a wall that faces a room."""

    wall: Wall
    start: Point
    along: Point
    """Unit vector of the wall's direction."""
    normal: Point
    """Unit vector into the room."""
    side: int
    """1 = the room is on the left of the wall, -1 = on the right."""
    low: float
    high: float
    """Start and end of the visible part, m along the wall."""

    @property
    def length(self) -> float:
        """Length of the visible part, m."""
        return self.high - self.low

    @property
    def yaw(self) -> float:
        """Yaw of furniture with its back to the wall, radians."""
        return round(math.atan2(self.normal[1], self.normal[0]), 6) + 0.0

    @property
    def outer(self) -> bool:
        """Whether it is part of an outside wall."""
        return not (self.wall.left and self.wall.right)

    def point(self, along: float, distance: float = 0.0) -> Point:
        """Returns the point at a distance along the wall and a distance from its surface, m."""
        return (
            self.start[0] + self.along[0] * along + self.normal[0] * distance,
            self.start[1] + self.along[1] * along + self.normal[1] * distance,
        )

    def rect(self, low: float, high: float, near: float, far: float) -> Rect:
        """Returns the rectangle between two positions along the wall and two distances from its surface, m."""
        return bounding_rect((self.point(low, near), self.point(high, far)))


@dataclass(frozen=True, slots=True)
class GateView:
    """A door or passage, seen from a room."""

    face: WallFace
    opening: Opening
    zones: tuple[Rect, ...]
    """Zones kept free of furniture."""
    other_room: str

    @property
    def point(self) -> Point:
        """Position in the room just inside the opening."""
        return self.face.point(self.opening.middle, 0.42)


@dataclass(frozen=True, slots=True)
class WindowView:
    """A window, seen from a room."""

    face: WallFace
    opening: Opening
    zone: Rect
    """Zone in which nothing is higher than the sill."""


@dataclass(frozen=True, slots=True)
class RoomView:
    """The inside of a room."""

    room: Room
    cells: tuple[Rect, ...]
    """Free floor within the walls, without stairs and openings, as disjoint rectangles."""
    faces: tuple[WallFace, ...]
    """Faces, one for each wall."""
    sides: tuple[WallFace, ...]
    """Faces, with collinear walls merged."""
    gates: tuple[GateView, ...]
    windows: tuple[WindowView, ...]

    @property
    def area(self) -> float:
        """Area of the free floor, m^2."""
        return sum(c.area for c in self.cells)

    def holds(self, rect: Rect) -> bool:
        """Returns whether a rectangle lies within the walls."""
        return is_covered(rect, self.cells)

    def depth_at(self, face: WallFace, along: float) -> float:
        """Returns the depth of the free floor in front of a position on a wall, m."""
        x, y = face.point(along)
        across = 0 if face.normal[0] else 1
        wall_coordinate, sign = (x, y)[across], face.normal[across]
        intervals = sorted(
            tuple(sorted((edge - wall_coordinate) * sign for edge in (c[across], c[across + 2])))
            for c in self.cells
            if c[1 - across] - 1e-6 < (x, y)[1 - across] < c[3 - across] + 1e-6
        )
        depth = 0.0
        for low, high in intervals:
            if low <= depth + 1e-6:
                depth = max(depth, high)
        return depth


def face_of(wall: Wall, room: str) -> WallFace:
    """Returns the side of a wall that faces a room, over its whole length."""
    length = math.dist(wall.start, wall.end)
    along = (round((wall.end[0] - wall.start[0]) / length), round((wall.end[1] - wall.start[1]) / length))
    side = 1 if wall.left == room else -1
    normal = (-along[1] * side, along[0] * side)
    start = (wall.start[0] + normal[0] * wall.thickness / 2, wall.start[1] + normal[1] * wall.thickness / 2)
    return WallFace(wall, start, along, normal, side, 0.0, length)


def door_zones(face: WallFace, opening: Opening) -> tuple[Rect, ...]:
    """Returns the zones that a door or passage keeps free, including the sweep of its leaf."""
    low, high = opening.middle - opening.width / 2 - 0.03, opening.middle + opening.width / 2 + 0.03
    passage_zone = face.rect(low, high, 0.0, PASSAGE_DEPTH)
    if opening.kind != "door" or opening.swing != face.side:
        return (passage_zone,)
    if not opening.body.startswith("sliding"):
        return (face.rect(low, high, 0.0, LEAF_DEPTH),)
    # A sliding leaf and its rail occupy the wall beside the opening.
    start, end = (low - opening.width - 0.1, high) if opening.hinge == "start" else (low, high + opening.width + 0.1)
    return passage_zone, face.rect(start, end, 0.0, SLIDING_DEPTH)


def window_zone(face: WallFace, opening: Opening) -> Rect:
    """Returns the zone in front of a window."""
    return face.rect(opening.middle - opening.width / 2, opening.middle + opening.width / 2, 0.0, WINDOW_DEPTH)


def wall_rect(wall: Wall) -> Rect:
    """Returns the footprint of a wall, extended by half its thickness at both ends, so that corners are closed."""
    return bounding_rect((wall.start, wall.end)).grown(wall.thickness / 2)


def room_view(storey: Storey, room: Room, blocked: Sequence[Rect]) -> RoomView:
    """Returns the inside of a room.

    Args:
        storey: storey of the room.
        room: the room.
        blocked: stairs and openings in the floor.
    """
    walls = [w for w in storey.walls if room.name in (w.left, w.right)]
    cells = subtract(cells_of(room.corners), [*(wall_rect(w) for w in storey.walls), *blocked])
    faces = tuple(_clip_to_floor(face_of(w, room.name), cells) for w in walls)
    gates = tuple(
        GateView(f, o, door_zones(f, o), f.wall.right if f.side > 0 else f.wall.left)
        for f in faces
        for o in f.wall.openings
        if o.kind != "window"
    )
    windows = tuple(WindowView(f, o, window_zone(f, o)) for f in faces for o in f.wall.openings if o.kind == "window")
    return RoomView(room, cells, faces, _merge_collinear(faces), gates, windows)


def _merge_collinear(faces: Sequence[WallFace]) -> tuple[WallFace, ...]:
    """Merges adjacent collinear faces."""
    sides: list[WallFace] = []
    for face in sorted((f for f in faces if f.length > 0.0), key=lambda f: (f.normal, f.point(f.low))):
        last = sides[-1] if sides else None
        if last and last.normal == face.normal and math.dist(last.point(last.high), face.point(face.low)) < 1e-3:
            wall = last.wall if last.length > face.length else face.wall
            sides[-1] = WallFace(wall, last.start, last.along, last.normal, last.side, last.low, last.high + face.length)
        else:
            sides.append(face)
    return tuple(sides)


def cells_of(corners: Sequence[Point]) -> tuple[Rect, ...]:
    """Returns disjoint rectangles that cover a polygon with axis-aligned edges."""
    bounds = bounding_rect(corners)
    xs, ys = sorted({c[0] for c in corners}), sorted({c[1] for c in corners})
    outside = [
        Rect(x0, y0, x1, y1)
        for x0, x1 in itertools.pairwise(xs)
        for y0, y1 in itertools.pairwise(ys)
        if not _polygon_contains(corners, ((x0 + x1) / 2, (y0 + y1) / 2))
    ]
    return subtract([bounds], outside)


def _polygon_contains(corners: Sequence[Point], point: Point) -> bool:
    """Returns whether a point lies in a polygon (even-odd rule)."""
    is_inside = False
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (a[1] > point[1]) != (b[1] > point[1]) and point[0] < a[0] + (b[0] - a[0]) * (point[1] - a[1]) / (b[1] - a[1]):
            is_inside = not is_inside
    return is_inside


def _clip_to_floor(face: WallFace, cells: Sequence[Rect]) -> WallFace:
    """Clips a face to the part with floor in front of it."""
    strip = face.rect(face.low, face.high, 0.0, 0.02)
    ends = [
        (x - face.start[0]) * face.along[0] + (y - face.start[1]) * face.along[1]
        for cell in cells
        if cell.overlaps(strip)
        for x, y in (
            (max(cell.x0, strip.x0), max(cell.y0, strip.y0)),
            (min(cell.x1, strip.x1), min(cell.y1, strip.y1)),
        )
    ]
    low, high = (min(ends), max(ends)) if ends else (0.0, 0.0)
    return WallFace(face.wall, face.start, face.along, face.normal, face.side, low, high)
