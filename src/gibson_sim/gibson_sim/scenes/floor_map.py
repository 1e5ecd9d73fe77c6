"""Where on a floor a robot can stand: an occupancy grid made from collision triangles. Knows no ROS and no physics engine.

Cells are square; row 0 is at the lowest y, column 0 at the lowest x, as in ``nav_msgs/OccupancyGrid``.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.scenes.mesh import collision_triangles
from gibson_sim.scenes.spec import SceneSpec

logger = logging.getLogger(__name__)

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FLOOR_CLEARANCE = 0.03
"""What rises less than this above the floor is driven over, metres: thresholds, carpets, the bumps of a scan."""
FLOOR_TOLERANCE = 0.10
"""A level surface this near to the floor's height is floor, metres."""
_LEVEL = math.cos(math.radians(20.0))
_MAX_CELLS = 16_000_000
_ROUNDING = 1e-6
_PAIRS_AT_ONCE = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class FloorMap:
    """An occupancy grid in the world frame."""

    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """World x, y of the lower left corner of cell [0, 0], metres."""
    occupied: Bools
    """(H, W): something stands here between the floor and the robot's height."""
    floor: Bools
    """(H, W): there is floor to stand on. What is neither occupied nor floor is unknown."""
    distance_to_obstacle: F64 = field(init=False)
    """(H, W): metres from the centre of a cell to the nearest point of a cell that is not free; 0 in such cells."""

    def __post_init__(self) -> None:
        if self.occupied.shape != self.floor.shape or self.occupied.ndim != 2 or not self.occupied.size:
            raise SceneError(
                f"floor map: occupied is {self.occupied.shape} and floor {self.floor.shape}; must be one (H, W) with cells"
            )
        object.__setattr__(self, "distance_to_obstacle", _distance_to_blocked(~self.free, self.resolution))

    @property
    def free(self) -> Bools:
        """(H, W): floor with nothing on it."""
        return np.asarray(self.floor & ~self.occupied)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (along y), columns (along x)."""
        rows, columns = self.occupied.shape
        return rows, columns

    def cells(self, xy: ArrayLike) -> I64:
        """Returns row and column, (..., 2), of world points (..., 2); they may lie outside the grid."""
        points = np.asarray(xy, dtype=np.float64)
        return np.floor((points - self.origin) / self.resolution + _ROUNDING).astype(np.int64)[..., ::-1]

    def centers(self, cells: ArrayLike) -> F64:
        """Returns world x, y, (..., 2), of the centres of cells given as row, column, (..., 2)."""
        rows_columns = np.asarray(cells, dtype=np.float64)
        return np.asarray((rows_columns[..., ::-1] + 0.5) * self.resolution + np.asarray(self.origin))

    def clearance(self, xy: ArrayLike) -> F64:
        """Returns ``distance_to_obstacle`` of the cells that hold world points (..., 2); 0 outside the grid."""
        cells = self.cells(xy)
        inside = np.asarray(((cells >= 0) & (cells < np.array(self.shape))).all(axis=-1))
        safe = np.where(inside[..., None], cells, 0)
        return np.where(inside, self.distance_to_obstacle[safe[..., 0], safe[..., 1]], 0.0)

    def inflate(self, radius: float) -> Bools:
        """Returns (H, W): cells about any point of which a disc of ``radius`` (metres) lies in free space."""
        return np.asarray(self.distance_to_obstacle >= radius + self.resolution * math.sqrt(0.5))

    def largest_free_region(self, radius: float = 0.0) -> Bools:
        """Returns (H, W): the largest connected part of the places for a disc of ``radius``; all False if there is none.

        A part that touches the rim of the map is outdoors, so an enclosed part of 1 m^2 or more goes before it.
        """
        labels, count = ndimage.label(self.inflate(radius) if radius > 0 else self.free)
        if not count:
            return np.zeros(self.shape, dtype=bool)
        areas = np.bincount(labels.ravel(), minlength=count + 1) * self.resolution**2
        areas[0] = 0.0
        enclosed = areas.copy()
        free_labels, _ = ndimage.label(self.free)
        rim = np.unique(np.concatenate([free_labels[0], free_labels[-1], free_labels[:, 0], free_labels[:, -1]]))
        enclosed[np.unique(labels[np.isin(free_labels, rim[rim > 0])])] = 0.0
        best = enclosed if enclosed.max() >= 1.0 else areas
        return np.asarray(labels == int(best.argmax()))

    def nearest_free(self, xy: tuple[float, float], radius: float = 0.0) -> tuple[float, float] | None:
        """Returns the centre of the nearest place for a disc of ``radius``, world metres; None if there is none."""
        cells = np.argwhere(self.inflate(radius) if radius > 0 else self.free)
        if not len(cells):
            return None
        centers = self.centers(cells)
        x, y = centers[int(np.argmin(np.sum((centers - np.asarray(xy)) ** 2, axis=1)))]
        return float(x), float(y)


def scene_floor_map(scene: SceneSpec, *, robot_height: float, resolution: float = 0.05) -> FloorMap:
    """Returns the floor map of a scene's static collision shapes for a robot ``robot_height`` metres high."""
    vertices, triangles = collision_triangles(scene)
    ground = scene.ground_z is not None and abs(scene.ground_z - scene.floor_z) <= FLOOR_TOLERANCE
    return make_floor_map(
        vertices, triangles, floor_z=scene.floor_z, robot_height=robot_height, resolution=resolution, ground_plane=ground
    )


def make_floor_map(
    vertices: ArrayLike,
    triangles: ArrayLike,
    *,
    floor_z: float,
    robot_height: float,
    resolution: float = 0.05,
    ground_plane: bool = False,
) -> FloorMap:
    """Returns the occupancy grid of a triangle mesh, world frame, z up.

    A cell is occupied where any part of a triangle between ``floor_z + FLOOR_CLEARANCE`` and ``floor_z + robot_height`` touches it.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3), rows of ``vertices``.
        floor_z: height of the floor, metres.
        robot_height: metres above the floor.
        resolution: edge of a cell, metres; made coarser, with a warning, where the map would become too large.
        ground_plane: there is a floor everywhere, also where no triangle is. Where the mesh has a floor of its own, that one
            decides what is indoors.

    Raises:
        SceneError: there is nothing at this height.
    """
    v = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    corners = v[np.asarray(triangles, dtype=np.int64).reshape(-1, 3)]
    low, high = floor_z + FLOOR_CLEARANCE, floor_z + robot_height
    if high <= low:
        raise SceneError(f"floor map: robot_height is {robot_height:g} m, must be more than {FLOOR_CLEARANCE:g} m")
    tops, bottoms = corners[:, :, 2].max(axis=1), corners[:, :, 2].min(axis=1)
    obstacles = _clip_to_slab(corners[(tops > low) & (bottoms < high)], low, high)
    floors = corners[_is_floor(corners, floor_z)]
    solid = [a.reshape(-1, 2) for a in (obstacles, floors[:, :, :2]) if len(a)]
    if not solid:
        if not ground_plane:
            raise SceneError(
                f"floor map: the scene has neither floor nor obstacles near z = {floor_z:g} m; give the right floor_z"
            )
        solid = [np.array([[-5.0, -5.0], [5.0, 5.0]])]
    box = np.concatenate(solid)
    first, last = box.min(axis=0), box.max(axis=0)
    resolution = _affordable(resolution, last - first)
    # Whole multiples of the cell, so that maps of one scene line up; one cell of rim so that outdoors is connected.
    first = np.floor(first / resolution + _ROUNDING) - 1
    width, height = (int(n) for n in np.ceil(last / resolution - _ROUNDING) - first + 1)
    origin = first * resolution

    floor = _rasterise((floors[:, :, :2] - origin) / resolution, (height, width))
    # Neighbouring floor tiles of a model may leave cracks.
    floor = np.asarray(ndimage.binary_closing(np.pad(floor, 2), np.ones((3, 3)))[2:-2, 2:-2])
    occupied = _rasterise((obstacles - origin) / resolution, (height, width))
    if ground_plane and floor.mean() < 0.2:
        floor = np.ones((height, width), dtype=bool)
    return FloorMap(resolution, (float(origin[0]), float(origin[1])), occupied, floor)


def _affordable(resolution: float, size: F64) -> float:
    """Returns a cell size for which a map of ``size`` (2,) metres fits into memory."""
    needed = math.sqrt(float(size[0] * size[1]) / _MAX_CELLS)
    if needed <= resolution:
        return resolution
    coarser = math.ceil(needed / 0.05) * 0.05
    logger.warning("the scene is %.0f x %.0f m: its floor map gets cells of %.2f m", size[0], size[1], coarser)
    return coarser


def _is_floor(corners: F64, floor_z: float) -> Bools:
    """Returns (F,): triangles (F, 3, 3) that are level and at the height of the floor."""
    near = (np.abs(corners[:, :, 2] - floor_z) <= FLOOR_TOLERANCE).all(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    return np.asarray(near & (np.abs(normals[:, 2]) >= _LEVEL * length) & (length > 0))


def _clip_to_slab(corners: F64, low: float, high: float) -> F64:
    """Returns the parts of triangles (F, 3, 3) between two heights, seen from above: closed polygons (F, 9, 2), corners repeated."""
    if not len(corners):
        return np.zeros((0, 9, 2))
    slots, valid = [], []
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        za, zb = a[:, 2], b[:, 2]
        slots.append(a[:, :2])
        valid.append((za >= low) & (za <= high))
        # In the order in which the edge passes them.
        up = (zb > za)[:, None]
        near, far = np.where(up[:, 0], low, high), np.where(up[:, 0], high, low)
        for z in (near, far):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (z - za) / (zb - za)
            crosses = (za != zb) & (t > 0) & (t < 1)
            slots.append(a[:, :2] + np.where(crosses, t, 0.0)[:, None] * (b - a)[:, :2])
            valid.append(crosses)
    points, used = np.stack(slots, axis=1), np.stack(valid, axis=1)
    # An unused slot repeats the one used before it (cyclically), which adds an edge of length 0.
    order = np.where(used, np.arange(9), -1)
    before = np.maximum.accumulate(order, axis=1)
    before = np.where(before < 0, order.max(axis=1, keepdims=True), before)
    return np.asarray(np.take_along_axis(points, np.maximum(before, 0)[:, :, None], axis=1)[used.any(axis=1)])


def _rasterise(polygons: F64, shape: tuple[int, int]) -> Bools:
    """Returns (H, W): every cell that a convex polygon (P, K, 2), in cells, shares more than its rim with."""
    grid = np.zeros((shape[0], shape[1] + 1), dtype=np.int32)
    if not len(polygons):
        return np.zeros(shape, dtype=bool)
    first, last = _cell_range(polygons[:, :, 1].min(axis=1), polygons[:, :, 1].max(axis=1), shape[0])
    counts = np.maximum(last - first + 1, 0)
    ends = np.cumsum(counts)
    for start in range(0, int(ends[-1]), _PAIRS_AT_ONCE):
        pairs = np.arange(start, min(start + _PAIRS_AT_ONCE, int(ends[-1])))
        which = np.searchsorted(ends, pairs, side="right")
        rows = first[which] + pairs - (ends[which] - counts[which])
        left, right = _extent_in_band(polygons[which], rows.astype(np.float64))
        a, b = _cell_range(left, right, shape[1])
        np.add.at(grid, (rows, a), 1)
        np.add.at(grid, (rows, np.maximum(b + 1, a)), -1)
    return np.asarray(np.cumsum(grid, axis=1)[:, :-1] > 0)


def _cell_range(low: F64, high: F64, size: int) -> tuple[I64, I64]:
    """Returns the first and last cell of closed intervals; an interval on the border of two cells belongs to the upper one."""
    first = np.floor(low + _ROUNDING).astype(np.int64)
    last = np.maximum(np.ceil(high - _ROUNDING).astype(np.int64) - 1, first)
    return np.clip(first, 0, size - 1), np.clip(last, 0, size - 1)


def _extent_in_band(polygons: F64, rows: F64) -> tuple[F64, F64]:
    """Returns the smallest and the largest x of convex polygons (P, K, 2) within the bands rows <= y <= rows + 1."""
    x, y = polygons[:, :, 0], polygons[:, :, 1]
    bottom, top = rows[:, None], rows[:, None] + 1.0
    inside = (y >= bottom - _ROUNDING) & (y <= top + _ROUNDING)
    left = np.where(inside, x, np.inf).min(axis=1)
    right = np.where(inside, x, -np.inf).max(axis=1)
    dx, dy = np.roll(x, -1, axis=1) - x, np.roll(y, -1, axis=1) - y
    for level in (bottom, top):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (level - y) / dy
        crosses = (dy != 0) & (t >= 0) & (t <= 1)
        at = x + np.where(crosses, t, 0.0) * dx
        left = np.minimum(left, np.where(crosses, at, np.inf).min(axis=1))
        right = np.maximum(right, np.where(crosses, at, -np.inf).max(axis=1))
    return left, right


def _distance_to_blocked(blocked: Bools, resolution: float) -> F64:
    """Returns (H, W): metres from cell centres to the nearest blocked cell or the rim of the map, exact."""
    rows, columns = blocked.shape
    # On a lattice of half cells the nearest point of a square to a cell's centre is always a lattice point.
    lattice = np.zeros((2 * rows + 1, 2 * columns + 1), dtype=bool)
    lattice[0] = lattice[-1] = lattice[:, 0] = lattice[:, -1] = True
    for i in range(3):
        for j in range(3):
            lattice[i : i + 2 * rows - 1 : 2, j : j + 2 * columns - 1 : 2] |= blocked
    distance = ndimage.distance_transform_edt(~lattice)
    return np.asarray(distance[1::2, 1::2] * (resolution / 2), dtype=np.float64)
