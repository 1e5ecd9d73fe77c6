"""What a room looks like from within: its free floor, the faces of its walls, and what doors and windows need before them.

Made of the finished walls alone, so that the furnisher and the check see the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from gibson_sim_tools.making.building import Opening, Point, Room, Storey, Wall
from gibson_sim_tools.making.planning.rectangles import Rect, inside, spanning, without

PASSAGE_DEPTH = 0.75
"""Room that is kept free before a door or a passage, metres."""
LEAF_DEPTH = 0.96
"""The same on the side to which a door opens."""
SLIDING_DEPTH = 0.15
"""Of a sliding door, from the wall."""
WINDOW_DEPTH = 0.45
"""Nothing higher than the sill stands nearer to a window, metres."""


@dataclass(frozen=True, slots=True)
class Face:
    """The side of a wall that a room sees."""

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
    """Where the visible part begins and ends, metres along the wall."""

    @property
    def length(self) -> float:
        """Of the visible part."""
        return self.high - self.low

    @property
    def yaw(self) -> float:
        """Of what stands with its back to it."""
        return round(math.atan2(self.normal[1], self.normal[0]), 6) + 0.0

    @property
    def outer(self) -> bool:
        """Whether the outside is behind it."""
        return not (self.wall.left and self.wall.right)

    def point(self, along: float, off: float = 0.0) -> Point:
        """Returns the point so far along the wall and so far off it."""
        return (
            self.start[0] + self.along[0] * along + self.normal[0] * off,
            self.start[1] + self.along[1] * along + self.normal[1] * off,
        )

    def rect(self, low: float, high: float, near: float, far: float) -> Rect:
        """Returns the rectangle between two places along the wall and two distances off it."""
        return spanning((self.point(low, near), self.point(high, far)))


@dataclass(frozen=True, slots=True)
class Gate:
    """A door or passage, seen from a room."""

    face: Face
    opening: Opening
    zones: tuple[Rect, ...]
    """Kept free of furniture."""
    other_room: str

    @property
    def point(self) -> Point:
        """Where somebody stands who has just come in."""
        return self.face.point(self.opening.middle, 0.42)


@dataclass(frozen=True, slots=True)
class Window:
    """A window, seen from a room."""

    face: Face
    opening: Opening
    zone: Rect
    """Free of what is higher than its sill."""


@dataclass(frozen=True, slots=True)
class RoomView:
    """A room from within."""

    room: Room
    cells: tuple[Rect, ...]
    """Its floor within the walls, without stairs and holes: rectangles that do not overlap."""
    faces: tuple[Face, ...]
    """One for each wall."""
    sides: tuple[Face, ...]
    """The same, but walls in one line make one side."""
    gates: tuple[Gate, ...]
    windows: tuple[Window, ...]

    @property
    def area(self) -> float:
        """Of the free floor, m²."""
        return sum(c.area for c in self.cells)

    def holds(self, rect: Rect) -> bool:
        """Returns whether a rectangle lies within the walls."""
        return inside(rect, self.cells)

    def depth_at(self, face: Face, along: float) -> float:
        """Returns how far it is from a place on a wall straight to the other side, metres."""
        x, y = face.point(along)
        across = 0 if face.normal[0] else 1
        here, towards = (x, y)[across], face.normal[across]
        stretches = sorted(
            tuple(sorted((edge - here) * towards for edge in (c[across], c[across + 2])))
            for c in self.cells
            if c[1 - across] - 1e-6 < (x, y)[1 - across] < c[3 - across] + 1e-6
        )
        reach = 0.0
        for low, high in stretches:
            if low <= reach + 1e-6:
                reach = max(reach, high)
        return reach


def face_of(wall: Wall, room: str) -> Face:
    """Returns the side of a wall that a room sees, in its whole length."""
    length = math.dist(wall.start, wall.end)
    along = (round((wall.end[0] - wall.start[0]) / length), round((wall.end[1] - wall.start[1]) / length))
    side = 1 if wall.left == room else -1
    normal = (-along[1] * side, along[0] * side)
    start = (wall.start[0] + normal[0] * wall.thickness / 2, wall.start[1] + normal[1] * wall.thickness / 2)
    return Face(wall, start, along, normal, side, 0.0, length)


def door_zones(face: Face, opening: Opening) -> tuple[Rect, ...]:
    """Returns the floor before a door or passage that stays free, the sweep of its leaf included."""
    low, high = opening.middle - opening.width / 2 - 0.03, opening.middle + opening.width / 2 + 0.03
    way = face.rect(low, high, 0.0, PASSAGE_DEPTH)
    if opening.kind != "door" or opening.swing != face.side:
        return (way,)
    if not opening.body.startswith("sliding"):
        return (face.rect(low, high, 0.0, LEAF_DEPTH),)
    # A sliding leaf and its rail take some of the wall beside the opening.
    start, end = (low - opening.width - 0.1, high) if opening.hinge == "start" else (low, high + opening.width + 0.1)
    return way, face.rect(start, end, 0.0, SLIDING_DEPTH)


def window_zone(face: Face, opening: Opening) -> Rect:
    """Returns the floor before a window."""
    return face.rect(opening.middle - opening.width / 2, opening.middle + opening.width / 2, 0.0, WINDOW_DEPTH)


def wall_rect(wall: Wall) -> Rect:
    """Returns what a wall covers, seen from above; it reaches half its thickness beyond both ends, so that corners are closed."""
    return spanning((wall.start, wall.end)).grown(wall.thickness / 2)


def room_view(storey: Storey, room: Room, blocked: Sequence[Rect]) -> RoomView:
    """Returns a room from within.

    Args:
        storey: that it is in.
        room: the room.
        blocked: flights of stairs and holes, which are no floor.
    """
    walls = [w for w in storey.walls if room.name in (w.left, w.right)]
    cells = without(cells_of(room.corners), [*(wall_rect(w) for w in storey.walls), *blocked])
    faces = tuple(_visible(face_of(w, room.name), cells) for w in walls)
    gates = tuple(
        Gate(f, o, door_zones(f, o), f.wall.right if f.side > 0 else f.wall.left)
        for f in faces
        for o in f.wall.openings
        if o.kind != "window"
    )
    windows = tuple(Window(f, o, window_zone(f, o)) for f in faces for o in f.wall.openings if o.kind == "window")
    return RoomView(room, cells, faces, _sides(faces), gates, windows)


def _sides(faces: Sequence[Face]) -> tuple[Face, ...]:
    """Returns faces with those that lie in one line and touch made one."""
    sides: list[Face] = []
    for face in sorted((f for f in faces if f.length > 0.0), key=lambda f: (f.normal, f.point(f.low))):
        last = sides[-1] if sides else None
        if last and last.normal == face.normal and math.dist(last.point(last.high), face.point(face.low)) < 1e-3:
            wall = last.wall if last.length > face.length else face.wall
            sides[-1] = Face(wall, last.start, last.along, last.normal, last.side, last.low, last.high + face.length)
        else:
            sides.append(face)
    return tuple(sides)


def cells_of(corners: Sequence[Point]) -> tuple[Rect, ...]:
    """Returns rectangles that do not overlap and cover a polygon with edges along the axes."""
    bounds = spanning(corners)
    xs, ys = sorted({c[0] for c in corners}), sorted({c[1] for c in corners})
    outside = [
        Rect(x0, y0, x1, y1)
        for x0, x1 in itertools.pairwise(xs)
        for y0, y1 in itertools.pairwise(ys)
        if not _holds(corners, ((x0 + x1) / 2, (y0 + y1) / 2))
    ]
    return without([bounds], outside)


def _holds(corners: Sequence[Point], point: Point) -> bool:
    """Returns whether a point lies in a polygon: the number of edges to its right is odd."""
    crossed = False
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (a[1] > point[1]) != (b[1] > point[1]) and point[0] < a[0] + (b[0] - a[0]) * (point[1] - a[1]) / (b[1] - a[1]):
            crossed = not crossed
    return crossed


def _visible(face: Face, cells: Sequence[Rect]) -> Face:
    """Returns a face cut to the part before which there is floor."""
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
    return Face(face.wall, face.start, face.along, face.normal, face.side, low, high)
