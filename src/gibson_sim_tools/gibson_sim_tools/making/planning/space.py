"""A room while it is being furnished: what stands in it, and whether one more thing fits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.types import Vec3
from gibson_sim_tools.making.building import Body, Lamp, Piece, Point
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.rectangles import EPSILON, Box, Rect, around
from gibson_sim_tools.making.planning.rooms import Face, RoomView

CELL = 0.05
"""Of the grid on which ways are looked for, metres."""
WAY_RADIUS = 0.375
"""Half the width of a way, and half a cell."""
HEAD_HEIGHT = 2.0
"""What hangs higher is in nobody's way, metres."""
GAP = 0.01
"""Between furniture and the wall behind it, metres."""


@dataclass(frozen=True, slots=True)
class Part:
    """Something that is about to be placed: a piece, or a body that moves."""

    kind: str
    """Of the catalogue, or the model of a body."""
    middle: Point
    yaw: float
    size: Vec3
    lift: float = 0.0
    """Height of its underside above the floor."""
    movable: bool = False

    @property
    def rect(self) -> Rect:
        """What it covers, seen from above."""
        return around(self.middle, self.yaw, self.size[0], self.size[1])

    @property
    def box(self) -> Box:
        """Its box, above the floor of its storey."""
        return Box(self.rect, self.lift, self.lift + self.size[2])

    @property
    def flat(self) -> bool:
        """Whether it lies on the floor and is walked on."""
        return not self.movable and CATALOGUE[self.kind].stands == "lies"

    def ahead(self, distance: float, aside: float = 0.0) -> Point:
        """Returns the point so far before its middle and to its left."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return (self.middle[0] + cos * distance - sin * aside, self.middle[1] + sin * distance + cos * aside)

    def front(self, depth: float) -> Rect:
        """Returns the floor before it, as wide as it is."""
        return around(self.ahead((self.size[0] + depth) / 2), self.yaw, depth, self.size[1])


@dataclass
class Furnishings:
    """What has been placed in a building so far."""

    rng: np.random.Generator
    pieces: list[Piece] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)

    def mark(self) -> tuple[int, int, int, dict[str, int]]:
        """Returns where all lists end, for `rewind`."""
        return len(self.pieces), len(self.bodies), len(self.lamps), dict(self._counts)

    def rewind(self, mark: tuple[int, int, int, dict[str, int]]) -> None:
        """Takes away everything that came after a mark."""
        del self.pieces[mark[0] :], self.bodies[mark[1] :], self.lamps[mark[2] :]
        self._counts = dict(mark[3])

    def name(self, stem: str) -> str:
        """Returns a name that nothing else has."""
        self._counts[stem] = self._counts.get(stem, 0) + 1
        return stem if self._counts[stem] == 1 else f"{stem}_{self._counts[stem]}"


class FurnishedRoom:
    """A room with what stands in it.

    Args:
        view: the room from within.
        storey: its number.
        floor_z: of the storey, metres.
        height: to the ceiling, metres.
        all_things: of the building; what is placed here is added to it.
        strict: whether to do without nothing that such a room should have.
        curtains: whether windows get some.
        workplace: whether people work in the building rather than live there.
        ways: further places that must be reached, such as the foot of a stair, with the floor that stays free there.
    """

    def __init__(
        self,
        view: RoomView,
        storey: int,
        floor_z: float,
        height: float,
        all_things: Furnishings,
        ways: Sequence[tuple[Point, Rect]] = (),
        *,
        strict: bool = True,
        curtains: bool = True,
        workplace: bool = False,
    ) -> None:
        self.view = view
        self.storey = storey
        self.floor_z = floor_z
        self.height = height
        self.things = all_things
        self.rng = all_things.rng
        self.strict = strict
        self.curtains = curtains
        self.workplace = workplace
        self.parts: list[Part] = []
        self._boxes: list[Box] = []
        self._kept = [zone for gate in view.gates for zone in gate.zones] + [zone for _, zone in ways]
        self._fronts: list[Rect] = []
        self._goals = [gate.point for gate in view.gates] + [point for point, _ in ways]
        self._origin = (min(c.x0 for c in view.cells), min(c.y0 for c in view.cells))
        self._floor = self._painted()

    @property
    def kind(self) -> str:
        """What the room is for."""
        return self.view.room.kind

    def size(self, kind: str, **fixed: float) -> Vec3:
        """Returns a size that a kind of piece may have; ``depth``, ``width`` or ``height`` may be given."""
        entry = CATALOGUE[kind]

        def draw(name: str, limits: tuple[float, float]) -> float:
            return round(fixed[name], 3) if name in fixed else round(float(self.rng.uniform(*limits)), 2)

        return (draw("depth", entry.depth), draw("width", entry.width), draw("height", entry.height))

    def lift(self, kind: str) -> float:
        """Returns a height above the floor at which a kind of piece may hang."""
        return round(float(self.rng.uniform(*CATALOGUE[kind].lift)), 2)

    def on_wall(self, kind: str, face: Face, along: float, size: Vec3, lift: float = 0.0, gap: float = GAP) -> Part:
        """Returns a piece with its back to a wall."""
        return Part(kind, _exact(face.point(along, size[0] / 2 + gap)), face.yaw, size, lift)

    def fits(self, part: Part) -> bool:
        """Returns whether a thing lies in the room, meets nothing, and keeps doors, windows and what others need before them free."""
        box = part.box
        rect = box.rect
        if not self.view.holds(rect) or box.z1 > self.height + EPSILON:
            return False
        if part.flat:
            return not any(other.flat and other.rect.overlaps(rect) for other in self.parts)
        if any(other.overlaps(box) for other in self._boxes):
            return False
        if box.z0 < HEAD_HEIGHT and any(zone.overlaps(rect) for zone in self._kept):
            return False
        if box.z0 < 1.0 and any(zone.overlaps(rect) for zone in self._fronts):
            return False
        return not any(
            box.z1 > w.opening.sill + 0.02 and box.z0 < w.opening.sill + w.opening.height and w.zone.overlaps(rect)
            for w in self.view.windows
        )

    def is_open(self, zone: Rect) -> bool:
        """Returns whether a piece of floor lies in the room and nothing stands on it."""
        return self.view.holds(zone) and not any(box.z0 < 1.0 and box.rect.overlaps(zone) for box in self._boxes)

    def place(self, parts: Sequence[Part], fronts: Sequence[Rect] = (), *, apart: bool = True) -> bool:
        """Places things together, if all fit and all doors can still be reached from each other.

        Args:
            parts: that do not meet each other.
            fronts: floor that is to be left free for them.
            apart: whether the fronts may not be taken by anything that comes later.

        Returns:
            Whether they were placed.
        """
        if not all(self.fits(p) for p in parts) or not all(self.is_open(zone) for zone in fronts):
            return False
        solid = [p for p in parts if not p.flat and p.lift < HEAD_HEIGHT]
        if any(p.lift < 1.2 and p.size[0] > 0.06 for p in solid) and not self._connected(solid, fronts):
            return False
        self.parts += parts
        self._boxes += [p.box for p in parts if not p.flat]
        for part in solid:
            self._paint(self._floor, part.rect, 0)
        if apart:
            self._fronts += fronts
        seed = int(self.rng.integers(1 << 16))
        for part in parts:
            self._record(part, seed)
        return True

    def _record(self, part: Part, seed: int) -> None:
        """Adds a thing to those of the building."""
        x, y = _exact(part.middle)
        position = (x, y, round(self.floor_z + part.lift, 4))
        if part.movable:
            self.things.bodies.append(Body(self.things.name(f"{self.view.room.name}_{part.kind}"), part.kind, position, part.yaw))
        else:
            name = self.things.name(f"{self.view.room.name}_{part.kind}")
            self.things.pieces.append(
                Piece(name, part.kind, self.storey, self.view.room.name, position, part.yaw, part.size, seed)
            )

    def add_body(self, body: Body) -> None:
        """Adds a body that lies on something."""
        self.things.bodies.append(body)

    def place_first(
        self, candidates: Iterable[tuple[Sequence[Part], Sequence[Rect]]], *, apart: bool = True
    ) -> Sequence[Part] | None:
        """Places the first group of things that fits, and returns it."""
        for parts, fronts in candidates:
            if self.place(parts, fronts, apart=apart):
                return parts
        return None

    def spots(
        self,
        width: float,
        *,
        score: Callable[[Face, float], float] | None = None,
        step: float = 0.1,
        faces: Sequence[Face] | None = None,
    ) -> Iterator[tuple[Face, float]]:
        """Yields where the middle of something so wide may come along the walls, the best first; both ends of a wall are among them."""
        found: list[tuple[float, Face, float]] = []
        for face in self.view.sides if faces is None else faces:
            room = face.length - width
            if room < -1e-6:
                continue
            count = max(1, math.ceil(max(room, 0.0) / step))
            for n in range(count + 1):
                along = face.low + width / 2 + max(room, 0.0) * n / count
                value = (score(face, along) if score else 0.0) + float(self.rng.random())
                found.append((value, face, along))
        found.sort(key=lambda entry: -entry[0])
        yield from ((face, along) for _, face, along in found)

    def stretches(self, face: Face, depth: float, height: float) -> list[tuple[float, float]]:
        """Returns the parts of a wall along which something so deep and high may stand, as (from, to) in metres along it."""
        strip = face.rect(face.low, face.high, GAP, depth)
        blocked = [zone for zone in self._kept if zone.overlaps(strip)]
        blocked += [p.rect for p in self.parts if not p.flat and p.lift < height and p.rect.overlaps(strip)]
        blocked += [w.zone for w in self.view.windows if w.opening.sill + 0.02 < height and w.zone.overlaps(strip)]
        axis = 0 if face.along[0] else 1
        spans = [sorted((edge - face.start[axis]) * face.along[axis] for edge in (r[axis], r[axis + 2])) for r in blocked]
        free, low = [], face.low
        for start, end in sorted(spans):
            if start > low + 0.05:
                free.append((low, start))
            low = max(low, end)
        return [*free, (low, face.high)] if low < face.high - 0.05 else free

    def corner_gap(self, face: Face, along: float, width: float) -> float:
        """Returns how far something against a wall is from the nearer end of that wall, metres."""
        return max(0.0, min(along - width / 2 - face.low, face.high - along - width / 2))

    def distance_to_doors(self, point: Point) -> float:
        """Returns how far a point is from the nearest door, metres."""
        return min((math.dist(point, goal) for goal in self._goals), default=5.0)

    def _connected(self, parts: Sequence[Part], fronts: Sequence[Rect]) -> bool:
        """Returns whether all doors, and the floor before what is new, can still be reached from each other."""
        free = self._floor.copy()
        for part in parts:
            self._paint(free, part.rect, 0)
        wide = self._distances(free) >= WAY_RADIUS
        _, regions = cv2.connectedComponents(wide.astype(np.uint8), connectivity=4)
        labels = np.asarray(regions, np.int32)
        found = {self._label_near(labels, goal, 0.15) for goal in self._goals}
        if len(found) != 1 or 0 in found:
            return False
        main = found.pop()
        return all((labels[self._slices(zone.grown(0.3))] == main).any() for zone in [*self._fronts, *fronts])

    def _label_near(self, labels: NDArray[np.int32], point: Point, radius: float) -> int:
        """Returns the part of the floor that a point lies in or near to; 0 = none."""
        near = labels[self._slices(Rect(point[0], point[1], point[0], point[1]).grown(radius))]
        return int(near.max()) if near.size else 0

    def _painted(self) -> NDArray[np.uint8]:
        """Returns the free floor as a grid with an edge of one cell around, 1 = free."""
        x1, y1 = max(c.x1 for c in self.view.cells), max(c.y1 for c in self.view.cells)
        grid = np.zeros((math.ceil((y1 - self._origin[1]) / CELL) + 2, math.ceil((x1 - self._origin[0]) / CELL) + 2), np.uint8)
        for cell in self.view.cells:
            self._paint(grid, cell, 1)
        return grid

    def _slices(self, rect: Rect) -> tuple[slice, slice]:
        """Returns the cells whose middles lie in a rectangle."""
        x0, y0 = self._origin
        columns = slice(
            max(0, math.ceil((rect.x0 - x0) / CELL + 0.5 - 1e-6)), max(0, math.floor((rect.x1 - x0) / CELL + 0.5 + 1e-6) + 1)
        )
        rows = slice(
            max(0, math.ceil((rect.y0 - y0) / CELL + 0.5 - 1e-6)), max(0, math.floor((rect.y1 - y0) / CELL + 0.5 + 1e-6) + 1)
        )
        return rows, columns

    def _paint(self, grid: NDArray[np.uint8], rect: Rect, value: int) -> None:
        """Sets the cells whose middles lie in a rectangle."""
        grid[self._slices(rect)] = value

    @staticmethod
    def _distances(free: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Returns how far each free cell is from what is not, metres."""
        distances = cv2.distanceTransform(free, cv2.DIST_L2, 5).astype(np.float32)
        return (distances * CELL - CELL / 2).astype(np.float32)


def _exact(point: Point) -> Point:
    """Returns a point in whole tenths of millimetres."""
    return (round(point[0], 4), round(point[1], 4))
