"""A room during furnishing: the items placed so far, and tests whether another item fits."""

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
from gibson_sim_tools.making.planning.rooms import RoomView, WallFace

CELL = 0.05
"""Cell size of the grid for the connectivity test, metres."""
PASSAGE_RADIUS = 0.375
"""Half the least width of a passage plus half a cell, metres."""
HEAD_HEIGHT = 2.0
"""Height from which hanging objects are no obstacle, metres."""
GAP = 0.01
"""Gap between furniture and the wall behind it, metres."""


@dataclass(frozen=True, slots=True)
class FurnishingItem:
    """A candidate for placement: a piece, or a movable body."""

    kind: str
    """Key of the catalogue, or the model of a body."""
    middle: Point
    yaw: float
    size: Vec3
    lift: float = 0.0
    """Height of its underside above the floor."""
    movable: bool = False

    @property
    def rect(self) -> Rect:
        """Footprint."""
        return around(self.middle, self.yaw, self.size[0], self.size[1])

    @property
    def box(self) -> Box:
        """Bounding box, relative to the floor of its storey."""
        return Box(self.rect, self.lift, self.lift + self.size[2])

    @property
    def flat(self) -> bool:
        """Whether it lies flat on the floor, as a rug does."""
        return not self.movable and CATALOGUE[self.kind].stands == "lies"

    def ahead(self, distance: float, aside: float = 0.0) -> Point:
        """Returns the point at a distance before its centre and a distance to its left."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return (self.middle[0] + cos * distance - sin * aside, self.middle[1] + sin * distance + cos * aside)

    def front(self, depth: float) -> Rect:
        """Returns the floor before it, over its whole width."""
        return around(self.ahead((self.size[0] + depth) / 2), self.yaw, depth, self.size[1])


@dataclass
class Furnishings:
    """The pieces, bodies and lamps placed in a building so far."""

    rng: np.random.Generator
    pieces: list[Piece] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)

    def mark(self) -> tuple[int, int, int, dict[str, int]]:
        """Returns the lengths of all lists, for ``rewind``."""
        return len(self.pieces), len(self.bodies), len(self.lamps), dict(self._counts)

    def rewind(self, mark: tuple[int, int, int, dict[str, int]]) -> None:
        """Removes everything added after a mark."""
        del self.pieces[mark[0] :], self.bodies[mark[1] :], self.lamps[mark[2] :]
        self._counts = dict(mark[3])

    def name(self, stem: str) -> str:
        """Returns a unique name."""
        self._counts[stem] = self._counts.get(stem, 0) + 1
        return stem if self._counts[stem] == 1 else f"{stem}_{self._counts[stem]}"


class FurnishedRoom:
    """A room with the items placed in it.

    Args:
        view: inside of the room.
        storey: index of the storey.
        floor_z: of the storey, metres.
        height: of the ceiling above the floor, metres.
        furnishings: of the building; items placed here are added to it.
        stair_ends: further points that must be reachable, with the zones that stay free there.
        strict: whether every usual item of such a room is required.
        curtains: whether windows have curtains.
        workplace: whether the building is an office or a shop.
    """

    def __init__(
        self,
        view: RoomView,
        storey: int,
        floor_z: float,
        height: float,
        furnishings: Furnishings,
        stair_ends: Sequence[tuple[Point, Rect]] = (),
        *,
        strict: bool = True,
        curtains: bool = True,
        workplace: bool = False,
    ) -> None:
        self.view = view
        self.storey = storey
        self.floor_z = floor_z
        self.height = height
        self.things = furnishings
        self.rng = furnishings.rng
        self.strict = strict
        self.curtains = curtains
        self.workplace = workplace
        self.items: list[FurnishingItem] = []
        self._boxes: list[Box] = []
        self._kept = [zone for gate in view.gates for zone in gate.zones] + [zone for _, zone in stair_ends]
        self._fronts: list[Rect] = []
        self._goals = [gate.point for gate in view.gates] + [point for point, _ in stair_ends]
        self._origin = (min(c.x0 for c in view.cells), min(c.y0 for c in view.cells))
        self._floor = self._painted()

    @property
    def kind(self) -> str:
        """Kind of the room."""
        return self.view.room.kind

    def size(self, kind: str, **fixed: float) -> Vec3:
        """Returns a random size of a kind of furniture; ``depth``, ``width`` or ``height`` may be fixed."""
        entry = CATALOGUE[kind]

        def draw(name: str, limits: tuple[float, float]) -> float:
            return round(fixed[name], 3) if name in fixed else round(float(self.rng.uniform(*limits)), 2)

        return (draw("depth", entry.depth), draw("width", entry.width), draw("height", entry.height))

    def lift(self, kind: str) -> float:
        """Returns a random mounting height of a kind of furniture, metres above the floor."""
        return round(float(self.rng.uniform(*CATALOGUE[kind].lift)), 2)

    def on_wall(self, kind: str, face: WallFace, along: float, size: Vec3, lift: float = 0.0, gap: float = GAP) -> FurnishingItem:
        """Returns an item with its back to a wall."""
        return FurnishingItem(kind, _exact(face.point(along, size[0] / 2 + gap)), face.yaw, size, lift)

    def fits(self, item: FurnishingItem) -> bool:
        """Returns whether an item lies in the room, overlaps nothing, and leaves the zones of doors, windows and other items free."""
        box = item.box
        rect = box.rect
        if not self.view.holds(rect) or box.z1 > self.height + EPSILON:
            return False
        if item.flat:
            return not any(other.flat and other.rect.overlaps(rect) for other in self.items)
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
        """Returns whether a zone lies in the room and nothing stands on it."""
        return self.view.holds(zone) and not any(box.z0 < 1.0 and box.rect.overlaps(zone) for box in self._boxes)

    def place(self, items: Sequence[FurnishingItem], fronts: Sequence[Rect] = (), *, apart: bool = True) -> bool:
        """Places items together if all fit and all doors remain connected.

        Args:
            items: items that do not overlap each other.
            fronts: zones that they keep free.
            apart: whether later items must leave the fronts free too.

        Returns:
            Whether they were placed.
        """
        if not all(self.fits(p) for p in items) or not all(self.is_open(zone) for zone in fronts):
            return False
        solid = [p for p in items if not p.flat and p.lift < HEAD_HEIGHT]
        if any(p.lift < 1.2 and p.size[0] > 0.06 for p in solid) and not self._connected(solid, fronts):
            return False
        self.items += items
        self._boxes += [p.box for p in items if not p.flat]
        for item in solid:
            self._paint(self._floor, item.rect, 0)
        if apart:
            self._fronts += fronts
        seed = int(self.rng.integers(1 << 16))
        for item in items:
            self._record(item, seed)
        return True

    def _record(self, item: FurnishingItem, seed: int) -> None:
        """Adds an item to the building."""
        x, y = _exact(item.middle)
        position = (x, y, round(self.floor_z + item.lift, 4))
        if item.movable:
            self.things.bodies.append(Body(self.things.name(f"{self.view.room.name}_{item.kind}"), item.kind, position, item.yaw))
        else:
            name = self.things.name(f"{self.view.room.name}_{item.kind}")
            self.things.pieces.append(
                Piece(name, item.kind, self.storey, self.view.room.name, position, item.yaw, item.size, seed)
            )

    def add_body(self, body: Body) -> None:
        """Adds a body that stands on an item."""
        self.things.bodies.append(body)

    def place_first(
        self, candidates: Iterable[tuple[Sequence[FurnishingItem], Sequence[Rect]]], *, apart: bool = True
    ) -> Sequence[FurnishingItem] | None:
        """Places the first group of items that fits, and returns it."""
        for items, fronts in candidates:
            if self.place(items, fronts, apart=apart):
                return items
        return None

    def spots(
        self,
        width: float,
        *,
        score: Callable[[WallFace, float], float] | None = None,
        step: float = 0.1,
        faces: Sequence[WallFace] | None = None,
    ) -> Iterator[tuple[WallFace, float]]:
        """Yields positions of the centre of an item of this width along the walls, the best first, including both ends of each wall."""
        found: list[tuple[float, WallFace, float]] = []
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

    def stretches(self, face: WallFace, depth: float, height: float) -> list[tuple[float, float]]:
        """Returns the free intervals of a wall for an item of this depth and height, as (from, to), metres along it."""
        strip = face.rect(face.low, face.high, GAP, depth)
        blocked = [zone for zone in self._kept if zone.overlaps(strip)]
        blocked += [p.rect for p in self.items if not p.flat and p.lift < height and p.rect.overlaps(strip)]
        blocked += [w.zone for w in self.view.windows if w.opening.sill + 0.02 < height and w.zone.overlaps(strip)]
        axis = 0 if face.along[0] else 1
        spans = [sorted((edge - face.start[axis]) * face.along[axis] for edge in (r[axis], r[axis + 2])) for r in blocked]
        free, low = [], face.low
        for start, end in sorted(spans):
            if start > low + 0.05:
                free.append((low, start))
            low = max(low, end)
        return [*free, (low, face.high)] if low < face.high - 0.05 else free

    def corner_gap(self, face: WallFace, along: float, width: float) -> float:
        """Returns the distance of an item at a wall from the nearer end of that wall, metres."""
        return max(0.0, min(along - width / 2 - face.low, face.high - along - width / 2))

    def distance_to_doors(self, point: Point) -> float:
        """Returns the distance of a point from the nearest door, metres."""
        return min((math.dist(point, goal) for goal in self._goals), default=5.0)

    def _connected(self, items: Sequence[FurnishingItem], fronts: Sequence[Rect]) -> bool:
        """Returns whether all doors and fronts remain connected with new items in place."""
        free = self._floor.copy()
        for item in items:
            self._paint(free, item.rect, 0)
        wide = self._distances(free) >= PASSAGE_RADIUS
        _, regions = cv2.connectedComponents(wide.astype(np.uint8), connectivity=4)
        labels = np.asarray(regions, np.int32)
        found = {self._label_near(labels, goal, 0.15) for goal in self._goals}
        if len(found) != 1 or 0 in found:
            return False
        main = found.pop()
        return all((labels[self._slices(zone.grown(0.3))] == main).any() for zone in [*self._fronts, *fronts])

    def _label_near(self, labels: NDArray[np.int32], point: Point, radius: float) -> int:
        """Returns the label of the region at or near a point; 0 = none."""
        near = labels[self._slices(Rect(point[0], point[1], point[0], point[1]).grown(radius))]
        return int(near.max()) if near.size else 0

    def _painted(self) -> NDArray[np.uint8]:
        """Returns the free floor as a grid with a border of one cell, 1 = free."""
        x1, y1 = max(c.x1 for c in self.view.cells), max(c.y1 for c in self.view.cells)
        grid = np.zeros((math.ceil((y1 - self._origin[1]) / CELL) + 2, math.ceil((x1 - self._origin[0]) / CELL) + 2), np.uint8)
        for cell in self.view.cells:
            self._paint(grid, cell, 1)
        return grid

    def _slices(self, rect: Rect) -> tuple[slice, slice]:
        """Returns the cells whose centres lie in a rectangle."""
        x0, y0 = self._origin
        columns = slice(
            max(0, math.ceil((rect.x0 - x0) / CELL + 0.5 - 1e-6)), max(0, math.floor((rect.x1 - x0) / CELL + 0.5 + 1e-6) + 1)
        )
        rows = slice(
            max(0, math.ceil((rect.y0 - y0) / CELL + 0.5 - 1e-6)), max(0, math.floor((rect.y1 - y0) / CELL + 0.5 + 1e-6) + 1)
        )
        return rows, columns

    def _paint(self, grid: NDArray[np.uint8], rect: Rect, value: int) -> None:
        """Sets the cells whose centres lie in a rectangle."""
        grid[self._slices(rect)] = value

    @staticmethod
    def _distances(free: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Returns the distance of each free cell to the nearest occupied one, metres."""
        distances = cv2.distanceTransform(free, cv2.DIST_L2, 5).astype(np.float32)
        return (distances * CELL - CELL / 2).astype(np.float32)


def _exact(point: Point) -> Point:
    """Returns a point rounded to 0.1 mm."""
    return (round(point[0], 4), round(point[1], 4))
