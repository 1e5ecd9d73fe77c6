"""State of a room during furnishing: the items placed so far, and tests whether another item fits."""

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
from gibson_sim_tools.making.planning.rectangles import EPSILON, Box, Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import RoomView, WallFace

CELL = 0.05
"""Cell size of the grid for the connectivity test, m."""
PASSAGE_RADIUS = 0.375
"""Half the minimum width of a passage plus half a cell, m."""
HEAD_HEIGHT = 2.0
"""Height from which mounted objects are not obstacles, m."""
WALL_GAP = 0.01
"""Gap between furniture and the wall behind it, m."""


@dataclass(frozen=True, slots=True)
class FurnishingItem:
    """A candidate for placement: a piece, or a movable body."""

    kind: str
    """Key of the catalogue, or model of a body."""
    middle: Point
    yaw: float
    size: Vec3
    """Depth (x), width (y), height (z), m."""
    lift: float = 0.0
    """Height of the underside above the floor, m."""
    movable: bool = False
    """Whether it is a movable body."""

    @property
    def rect(self) -> Rect:
        """Footprint."""
        return rotated_bounds(self.middle, self.yaw, self.size[0], self.size[1])

    @property
    def box(self) -> Box:
        """Bounding box; heights above the floor of its storey."""
        return Box(self.rect, self.lift, self.lift + self.size[2])

    @property
    def lies_flat(self) -> bool:
        """Whether it lies flat on the floor, as a rug does."""
        return not self.movable and CATALOGUE[self.kind].stands == "lies"

    def point_ahead(self, distance: float, left: float = 0.0) -> Point:
        """Returns the point at a distance in front of its centre and a distance to the left, m."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return (self.middle[0] + cos * distance - sin * left, self.middle[1] + sin * distance + cos * left)

    def front(self, depth: float) -> Rect:
        """Returns the floor in front of it over its whole width. ``depth``: m."""
        return rotated_bounds(self.point_ahead((self.size[0] + depth) / 2), self.yaw, depth, self.size[1])


@dataclass
class Furnishings:
    """Pieces, bodies and lamps placed in a building so far."""

    rng: np.random.Generator
    pieces: list[Piece] = field(default_factory=list)
    bodies: list[Body] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    _counts: dict[str, int] = field(default_factory=dict)

    def snapshot(self) -> tuple[int, int, int, dict[str, int]]:
        """Returns the current state, for ``restore``."""
        return len(self.pieces), len(self.bodies), len(self.lamps), dict(self._counts)

    def restore(self, snapshot: tuple[int, int, int, dict[str, int]]) -> None:
        """Removes everything added since a snapshot."""
        del self.pieces[snapshot[0] :], self.bodies[snapshot[1] :], self.lamps[snapshot[2] :]
        self._counts = dict(snapshot[3])

    def name(self, stem: str) -> str:
        """Returns a unique name."""
        self._counts[stem] = self._counts.get(stem, 0) + 1
        return stem if self._counts[stem] == 1 else f"{stem}_{self._counts[stem]}"


class FurnishedRoom:
    """A room with the items placed in it.

    Args:
        view: view of the room.
        storey: index of the storey.
        floor_z: height of the storey's floor, metres.
        height: height of the ceiling above the floor, metres.
        furnishings: furnishings of the building; placed items are added to it.
        stair_ends: further points that must be reachable, with the zones that stay free around them.
        strict: whether all usual items of such a room are required.
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
        self.furnishings = furnishings
        self.rng = furnishings.rng
        self.strict = strict
        self.curtains = curtains
        self.workplace = workplace
        self.items: list[FurnishingItem] = []
        self._boxes: list[Box] = []
        self._kept_free = [zone for gate in view.gates for zone in gate.zones] + [zone for _, zone in stair_ends]
        self._fronts: list[Rect] = []
        self._reachable_points = [gate.point for gate in view.gates] + [point for point, _ in stair_ends]
        self._origin = (min(c.x0 for c in view.cells), min(c.y0 for c in view.cells))
        self._floor = self._rasterised_floor()

    @property
    def kind(self) -> str:
        """Kind of the room."""
        return self.view.room.kind

    def size(self, kind: str, **fixed: float) -> Vec3:
        """Samples a size of a kind of furniture, m; ``depth``, ``width`` or ``height`` may be fixed."""
        entry = CATALOGUE[kind]

        def sample(name: str, limits: tuple[float, float]) -> float:
            return round(fixed[name], 3) if name in fixed else round(float(self.rng.uniform(*limits)), 2)

        return (sample("depth", entry.depth), sample("width", entry.width), sample("height", entry.height))

    def lift(self, kind: str) -> float:
        """Samples a mounting height of a kind of furniture, m above the floor."""
        return round(float(self.rng.uniform(*CATALOGUE[kind].lift)), 2)

    def on_wall(
        self, kind: str, face: WallFace, along: float, size: Vec3, lift: float = 0.0, gap: float = WALL_GAP
    ) -> FurnishingItem:
        """Returns an item with its back to a wall. ``along``: position of its centre along the wall, m."""
        return FurnishingItem(kind, rounded(face.point(along, size[0] / 2 + gap)), face.yaw, size, lift)

    def fits(self, item: FurnishingItem) -> bool:
        """Returns whether an item is in the room, overlaps nothing, and leaves the zones of doors, windows and other items free."""
        box = item.box
        rect = box.rect
        if not self.view.holds(rect) or box.z1 > self.height + EPSILON:
            return False
        if item.lies_flat:
            return not any(other.lies_flat and other.rect.overlaps(rect) for other in self.items)
        if any(other.overlaps(box) for other in self._boxes):
            return False
        if box.z0 < HEAD_HEIGHT and any(zone.overlaps(rect) for zone in self._kept_free):
            return False
        if box.z0 < 1.0 and any(zone.overlaps(rect) for zone in self._fronts):
            return False
        return not any(
            box.z1 > w.opening.sill + 0.02 and box.z0 < w.opening.sill + w.opening.height and w.zone.overlaps(rect)
            for w in self.view.windows
        )

    def is_open(self, zone: Rect) -> bool:
        """Returns whether a zone is in the room and free of items."""
        return self.view.holds(zone) and not any(box.z0 < 1.0 and box.rect.overlaps(zone) for box in self._boxes)

    def place(self, items: Sequence[FurnishingItem], fronts: Sequence[Rect] = (), *, apart: bool = True) -> bool:
        """Places a group of items if all fit and all doors remain connected.

        Args:
            items: items that do not overlap each other.
            fronts: zones that must be free.
            apart: whether later items must leave the fronts free, too.

        Returns:
            Whether the group was placed.
        """
        if not all(self.fits(p) for p in items) or not all(self.is_open(zone) for zone in fronts):
            return False
        obstacles = [p for p in items if not p.lies_flat and p.lift < HEAD_HEIGHT]
        if any(p.lift < 1.2 and p.size[0] > 0.06 for p in obstacles) and not self._connected(obstacles, fronts):
            return False
        self.items += items
        self._boxes += [p.box for p in items if not p.lies_flat]
        for item in obstacles:
            self._paint(self._floor, item.rect, 0)
        if apart:
            self._fronts += fronts
        seed = int(self.rng.integers(1 << 16))
        for item in items:
            self._record(item, seed)
        return True

    def _record(self, item: FurnishingItem, seed: int) -> None:
        """Adds an item to the building."""
        x, y = rounded(item.middle)
        position = (x, y, round(self.floor_z + item.lift, 4))
        if item.movable:
            self.furnishings.bodies.append(
                Body(self.furnishings.name(f"{self.view.room.name}_{item.kind}"), item.kind, position, item.yaw)
            )
        else:
            name = self.furnishings.name(f"{self.view.room.name}_{item.kind}")
            self.furnishings.pieces.append(
                Piece(name, item.kind, self.storey, self.view.room.name, position, item.yaw, item.size, seed)
            )

    def add_body(self, body: Body) -> None:
        """Adds a body that rests on an item."""
        self.furnishings.bodies.append(body)

    def place_first(
        self, candidates: Iterable[tuple[Sequence[FurnishingItem], Sequence[Rect]]], *, apart: bool = True
    ) -> Sequence[FurnishingItem] | None:
        """Places the first group of items that fits, and returns it; None if none fits."""
        for items, fronts in candidates:
            if self.place(items, fronts, apart=apart):
                return items
        return None

    def wall_positions(
        self,
        width: float,
        *,
        score: Callable[[WallFace, float], float] | None = None,
        step: float = 0.1,
        faces: Sequence[WallFace] | None = None,
    ) -> Iterator[tuple[WallFace, float]]:
        """Yields positions along the walls for the centre of an item of this width, m, the best first, including both ends of each wall."""
        candidates: list[tuple[float, WallFace, float]] = []
        for face in self.view.sides if faces is None else faces:
            slack = face.length - width
            if slack < -1e-6:
                continue
            count = max(1, math.ceil(max(slack, 0.0) / step))
            for n in range(count + 1):
                along = face.low + width / 2 + max(slack, 0.0) * n / count
                value = (score(face, along) if score else 0.0) + float(self.rng.random())
                candidates.append((value, face, along))
        candidates.sort(key=lambda entry: -entry[0])
        yield from ((face, along) for _, face, along in candidates)

    def free_intervals(self, face: WallFace, depth: float, height: float) -> list[tuple[float, float]]:
        """Returns the intervals of a wall, (start, end), m along it, that are free for an item of this depth and height."""
        strip = face.rect(face.low, face.high, WALL_GAP, depth)
        blocked = [zone for zone in self._kept_free if zone.overlaps(strip)]
        blocked += [p.rect for p in self.items if not p.lies_flat and p.lift < height and p.rect.overlaps(strip)]
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
        """Returns the distance of an item at a wall from the nearer end of the wall, m."""
        return max(0.0, min(along - width / 2 - face.low, face.high - along - width / 2))

    def distance_to_doors(self, point: Point) -> float:
        """Returns the distance of a point from the nearest door, m."""
        return min((math.dist(point, goal) for goal in self._reachable_points), default=5.0)

    def _connected(self, items: Sequence[FurnishingItem], fronts: Sequence[Rect]) -> bool:
        """Returns whether all doors and fronts remain connected with the new items in place."""
        free = self._floor.copy()
        for item in items:
            self._paint(free, item.rect, 0)
        is_passable = self._distances(free) >= PASSAGE_RADIUS
        _, regions = cv2.connectedComponents(is_passable.astype(np.uint8), connectivity=4)
        labels = np.asarray(regions, np.int32)
        labels_at_goals = {self._label_near(labels, goal, 0.15) for goal in self._reachable_points}
        if len(labels_at_goals) != 1 or 0 in labels_at_goals:
            return False
        main = labels_at_goals.pop()
        return all((labels[self._slices(zone.grown(0.3))] == main).any() for zone in [*self._fronts, *fronts])

    def _label_near(self, labels: NDArray[np.int32], point: Point, radius: float) -> int:
        """Returns the label of a region within ``radius`` (m) of a point; 0 = none."""
        near = labels[self._slices(Rect(point[0], point[1], point[0], point[1]).grown(radius))]
        return int(near.max()) if near.size else 0

    def _rasterised_floor(self) -> NDArray[np.uint8]:
        """Rasterises the free floor, with a border of one cell; 1 = free."""
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
        """Returns the distance of each free cell to the nearest occupied one, m."""
        distances = cv2.distanceTransform(free, cv2.DIST_L2, 5).astype(np.float32)
        return (distances * CELL - CELL / 2).astype(np.float32)


def rounded(point: Point) -> Point:
    """Returns a point rounded to 0.1 mm."""
    return (round(point[0], 4), round(point[1], 4))
