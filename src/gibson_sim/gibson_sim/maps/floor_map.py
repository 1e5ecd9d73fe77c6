"""The occupancy grid of a floor, computed from collision triangles. Must import neither ROS nor a physics engine.

Cells are square; row 0 is at the lowest y, column 0 at the lowest x, as in ``nav_msgs/OccupancyGrid``. A cell is occupied if it intersects an
obstacle between the floor and the robot's height, or if it is inside a solid that stands on the floor, since the triangles of a wardrobe are
only its faces.
A point belongs to the highest floor below it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.geometry.rasterise import ROUNDING, Grid, clip_to_slab
from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SceneSpec

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
T = TypeVar("T", bound=np.generic)
logger = logging.getLogger(__name__)
FLOOR_CLEARANCE = 0.03
"""Height above the floor below which objects are not obstacles, metres: thresholds, carpets, the bumps of a scan."""
FLOOR_TOLERANCE = 0.10
"""Maximum height difference between a level surface and the floor of which it is a part, metres."""
_LEVEL = math.cos(math.radians(20.0))
"""Minimum cosine of the angle between the normal of a floor and the vertical."""
MIN_GROUND_SHARE = 0.2
"""Minimum share of cells with floor; below it the ground plane is the floor everywhere."""
_MAX_CELLS = 4_000_000
"""Maximum number of cells, 100 x 100 m at 5 cm: named poses of 16 million took four seconds and a gigabyte."""
_MAX_SIDE = 20_000
"""Maximum number of cells in a row or column: objects in a line, kilometres apart, would take gigabytes."""
_COARSE = 0.3
"""Cell size above which robots find no paths, metres: a quarter of the cells is then sufficient, in a quarter of the time."""
_EXACT_BELOW = 2000.0
"""Distance below which single precision represents all squares of distances exactly, half cells."""
_CEILING = (1.8, 6.0)
"""Height range above the floor in which a level surface is a ceiling, metres."""
_CEILING_WIDTH = 0.6
"""Minimum width of a ceiling, metres: lintels, tops of walls and lamps are narrower."""
_CEILING_LEVEL = math.cos(math.radians(50.0))
"""Minimum cosine of the angle between the normal of a ceiling and the vertical."""
_OPEN_SHARE = 0.2
"""Minimum share of the border of a region that is not enclosed, for it to be outdoors, such as lawns and terraces."""
_ROOM_AREA = 1.0
"""Minimum area of a room, square metres."""
_YARD_WEIGHT = 0.02
"""Weight of area without a ceiling in scenes with ceilings."""
_FLAT = 0.9
"""Minimum cosine between the vertical and the normal of an underside that rests on the floor."""
_STEEP = 0.05
"""Minimum cosine between the vertical and the normal of a surface that covers or supports something."""
_MAX_COVERED = 0.9
"""Maximum share of the floor that objects cover; if more faces point down, the mesh is wrong."""
_TIE = 0.002
"""Maximum distance of an underside below the floor that it rests on, metres."""
_BELOW = 0.2
"""Distance below a floor within which a point still belongs to it, metres: bodies on an uneven floor. A slab is thicker."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorMap:
    """An occupancy grid in the world frame."""

    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """World x, y of the lower left corner of cell [0, 0], metres."""
    occupied: Bools
    """Mask of cells with an obstacle between the floor and the robot's height, (H, W)."""
    floor: Bools
    """Mask of cells with floor, (H, W). A cell that is neither occupied nor floor is unknown."""
    covered: Bools | None = None
    """Mask of cells below a ceiling, (H, W); None = unknown."""
    floor_z: float = 0.0
    """Height of the floor, metres."""
    distance_to_obstacle: F64 = field(init=False)
    """Distance from the centre of a cell to the nearest point of a cell that is not free, (H, W), metres; 0 in such cells."""

    def __post_init__(self) -> None:
        if self.occupied.shape != self.floor.shape or self.occupied.ndim != 2 or not self.occupied.size:
            raise SceneError(
                f"floor map: occupied is {self.occupied.shape} and floor {self.floor.shape}; must be one (H, W) with cells"
            )
        object.__setattr__(self, "distance_to_obstacle", _distance_to_blocked(~self.free, self.resolution))

    def furnished(self, vertices: F64, triangles: NDArray[np.integer[Any]], robot_height: float) -> FloorMap:
        """Returns the map with additional obstacles: cells in which they collide with a robot ``robot_height`` metres high are occupied.

        Args:
            vertices: (V, 3), world frame, metres.
            triangles: (F, 3), rows of ``vertices``.
            robot_height: height of the robot above the floor, metres.
        """
        return self.with_obstacles(clip_to_slab(vertices[triangles], self.floor_z + FLOOR_CLEARANCE, self.floor_z + robot_height))

    def with_obstacles(self, polygons: Sequence[F64] | F64) -> FloorMap:
        """Returns the map with additional obstacles: the cells that overlap convex polygons (P, K, 2), world metres, are occupied."""
        return replace(self, occupied=self.occupied | self.grid.cover(np.asarray(polygons, dtype=np.float64)))

    @property
    def grid(self) -> Grid:
        """The cells of the map."""
        return Grid(self.resolution, self.origin, self.shape)

    @property
    def free(self) -> Bools:
        """Mask of the cells with floor and without obstacles, (H, W)."""
        return np.asarray(self.floor & ~self.occupied)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows (along y) and columns (along x)."""
        rows, columns = self.occupied.shape
        return rows, columns

    def cells(self, xy: ArrayLike) -> I64:
        """Returns row and column, (..., 2), of world points (..., 2), metres; they may be outside the grid."""
        points = np.asarray(xy, dtype=np.float64)
        return np.floor((points - self.origin) / self.resolution + ROUNDING).astype(np.int64)[..., ::-1]

    def centers(self, cells: ArrayLike) -> F64:
        """Returns world x, y, (..., 2), metres, of the centres of cells given as row, column, (..., 2)."""
        rows_columns = np.asarray(cells, dtype=np.float64)
        return np.asarray((rows_columns[..., ::-1] + 0.5) * self.resolution + np.asarray(self.origin))

    def clearance(self, xy: ArrayLike) -> F64:
        """Returns (...,): ``distance_to_obstacle``, metres, of the cells of world points (..., 2); 0 outside the grid."""
        return self.look_up(self.distance_to_obstacle, xy, outside=0.0)

    def look_up(self, values: NDArray[T], xy: ArrayLike, *, outside: float | bool) -> NDArray[T]:
        """Returns (...,): the values (H, W) of the cells of world points (..., 2), metres; ``outside`` for points outside the grid."""
        cells = self.cells(xy)
        inside = np.asarray(((cells >= 0) & (cells < np.array(self.shape))).all(axis=-1))
        safe = np.where(inside[..., None], cells, 0)
        return np.where(inside, values[safe[..., 0], safe[..., 1]], values.dtype.type(outside))

    def inflate(self, radius: float) -> Bools:
        """Returns a mask (H, W) of the cells in which a disc of ``radius`` (metres) about any point is in free space."""
        return np.asarray(self.distance_to_obstacle >= radius + self.resolution * math.sqrt(0.5))

    def largest_free_region(self, radius: float = 0.0) -> Bools:
        """Returns a mask (H, W) of the largest connected region that is free for a disc of ``radius``, metres; all False if there is none.

        Indoor regions, which are below a ceiling or enclosed by walls, take precedence over outdoor regions if one has 1 m^2 or more. A region is
        open if it touches the border of the map, or has no walls at its border, as a lawn. In scenes with ceilings, enclosed regions without a
        ceiling (yards) have a low weight.
        """
        places = self.inflate(radius) if radius > 0 else self.free
        covered = np.zeros(self.shape, dtype=bool) if self.covered is None else self.covered
        labels, count = ndimage.label(places & (covered | ~self._open()))
        has_ceilings = (covered & places).sum() * self.resolution**2 >= _ROOM_AREA
        weight = np.where(covered, 1.0, _YARD_WEIGHT if has_ceilings else 1.0)
        areas = np.bincount(labels.ravel(), weights=weight.ravel(), minlength=count + 1) * self.resolution**2
        areas[0] = 0.0
        if areas.max() >= _ROOM_AREA:
            return np.asarray(labels == int(areas.argmax()))
        labels, count = ndimage.label(places)
        if not count:
            return places
        return np.asarray(labels == 1 + int(np.bincount(labels.ravel())[1:].argmax()))

    def _open(self) -> Bools:
        """Returns a mask (H, W) of the free cells of regions that are not enclosed."""
        unknown, _ = ndimage.label(np.pad(~(self.floor | self.occupied), 1, constant_values=True))
        outside = (unknown == unknown[0, 0])[1:-1, 1:-1]
        labels, count = ndimage.label(self.free)
        beside_nothing = ndimage.binary_dilation(np.pad(outside, 1, constant_values=True))[1:-1, 1:-1]
        beside_anything = ndimage.binary_dilation(~self.free, border_value=True)
        ends = np.bincount(labels[beside_nothing], minlength=count + 1)
        rims = np.bincount(labels[beside_anything], minlength=count + 1)
        is_open = ends > _OPEN_SHARE * rims
        rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        is_open[rim] = True
        is_open[0] = False
        return np.asarray(is_open[labels])

    def nearest_free(self, xy: tuple[float, float], radius: float = 0.0) -> tuple[float, float] | None:
        """Returns the centre of the cell nearest to ``xy`` that is free for a disc of ``radius``, world metres; None if there is none."""
        cells = np.argwhere(self.inflate(radius) if radius > 0 else self.free)
        if not len(cells):
            return None
        centers = self.centers(cells)
        x, y = centers[int(np.argmin(np.sum((centers - np.asarray(xy)) ** 2, axis=1)))]
        return float(x), float(y)


def scene_floor_map(scene: SceneSpec, *, robot_height: float, resolution: float = 0.05) -> FloorMap:
    """Returns the map of the floor at ``scene.floor_z``, computed from the scene's static collision shapes.

    Args:
        scene: the scene.
        robot_height: height of the robot above the floor, metres.
        resolution: edge of a cell, metres; made coarser, with a warning, if the map would become too large.

    Raises:
        SceneError: the scene has no surface at this height.
    """
    vertices, triangles = collision_triangles(scene)
    ground = has_ground_at(scene, scene.floor_z)
    return make_floor_map(
        vertices, triangles, floor_z=scene.floor_z, robot_height=robot_height, resolution=resolution, ground_plane=ground
    )


def has_ground_at(scene: SceneSpec, floor_z: float) -> bool:
    """Returns whether the scene's ground plane is the floor at a height, world metres."""
    return scene.ground_z is not None and abs(scene.ground_z - floor_z) <= FLOOR_TOLERANCE


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

    A cell is occupied if it intersects a part of a triangle between ``floor_z + FLOOR_CLEARANCE`` and ``floor_z + robot_height``, or is inside
    a solid that stands on the floor.

    Args:
        vertices: (V, 3), metres.
        triangles: (F, 3), rows of ``vertices``.
        floor_z: height of the floor, world metres.
        robot_height: height of the robot above the floor, metres.
        resolution: edge of a cell, metres; made coarser, with a warning, if the map would become too large.
        ground_plane: whether the floor is everywhere, also without triangles; a floor in the mesh takes precedence.

    Raises:
        SceneError: the scene has no surface at this height.
    """
    v = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    corners = v[np.asarray(triangles, dtype=np.int64).reshape(-1, 3)]
    low, high = floor_z + FLOOR_CLEARANCE, floor_z + robot_height
    if high <= low:
        raise SceneError(f"floor map: robot_height is {robot_height:g} m, must be more than {FLOOR_CLEARANCE:g} m")
    tops, bottoms = corners[:, :, 2].max(axis=1), corners[:, :, 2].min(axis=1)
    obstacles = clip_to_slab(corners[(tops > low) & (bottoms < high)], low, high)
    floors = corners[_is_floor(corners, floor_z)][:, :, :2]
    grid = grid_about(floors, obstacles, resolution, floor_z, ground_plane)

    floor = grid.cover(floors)
    # There may be gaps between the floor tiles of a model.
    floor = np.asarray(ndimage.binary_closing(np.pad(floor, 2), np.ones((3, 3)))[2:-2, 2:-2])
    solid = inside_solids(corners, grid, floor_z, floor_z - FLOOR_TOLERANCE, low, ground_plane=ground_plane)
    if ground_plane and (floor & ~solid).mean() < MIN_GROUND_SHARE:
        floor = np.ones(grid.shape, dtype=bool)
    covered = under_ceiling(corners, floor_z, grid)
    return FloorMap(grid.resolution, grid.origin, grid.cover(obstacles) | solid, floor, covered, floor_z)


def grid_about(floors: F64, obstacles: F64, resolution: float, floor_z: float, ground_plane: bool) -> Grid:
    """Returns the grid about polygons (P, K, 2) of floors and obstacles, world metres.

    Args:
        floors: polygons of floors; P may be 0.
        obstacles: polygons of obstacles; P may be 0.
        resolution: edge of a cell, metres; made coarser, with a warning, if the grid would become too large.
        floor_z: height of the floor for the error message, world metres.
        ground_plane: whether the floor is everywhere.

    Raises:
        SceneError: there are neither floors nor obstacles nor a ground plane.
    """
    solid = [a.reshape(-1, 2) for a in (obstacles, floors) if len(a)]
    if not solid:
        if not ground_plane:
            raise SceneError(
                f"floor map: the scene has neither floor nor obstacles near z = {floor_z:g} m; give the right floor_z"
            )
        solid = [np.array([[-5.0, -5.0], [5.0, 5.0]])]
    box = np.concatenate(solid)
    return Grid.around(box, _affordable(resolution, box.max(axis=0) - box.min(axis=0)))


def under_ceiling(corners: F64, floor_z: float, grid: Grid) -> Bools:
    """Returns a mask (H, W) of the cells below a ceiling, that is, below level triangles at the height of a ceiling.

    Args:
        corners: (F, 3, 3), triangles, world metres.
        floor_z: height of the floor, world metres.
        grid: the cells.
    """
    middle = corners[:, :, 2].mean(axis=1) - floor_z
    near = corners[(middle >= _CEILING[0]) & (middle <= _CEILING[1])]
    level = near[np.abs(unit_normals(near)[:, 2]) >= _CEILING_LEVEL]
    first = np.asarray(grid.origin)
    last = first + grid.resolution * np.array(grid.shape[::-1])
    inside = (level[:, :, :2].max(axis=1) > first).all(axis=1) & (level[:, :, :2].min(axis=1) < last).all(axis=1)
    covered = grid.cover(level[inside][:, :, :2])
    width = max(1, round(_CEILING_WIDTH / grid.resolution))
    return np.asarray(ndimage.binary_opening(covered, np.ones((width, width))))


def inside_solids(corners: F64, grid: Grid, floor_z: float, low: float, high: float, *, ground_plane: bool = False) -> Bools:
    """Returns a mask (H, W) of the cells inside solids that stand on the floor.

    At the centre of such a cell there is an underside at the height of the floor, and the next surface above it faces up: the top of the solid.
    Above the floor of a room the next surface is the ceiling, which faces down; the underside of a table is higher. In meshes with flipped or
    doubled faces, equal areas of floor face down and up; for them the result is empty.

    Args:
        corners: (F, 3, 3), triangles, counter-clockwise seen from outside, world metres.
        grid: the cells.
        floor_z: height of the floor, world metres.
        low: lower limit of the floor's surfaces, world metres.
        high: upper limit of the floor's surfaces, world metres.
        ground_plane: whether the floor is everywhere, also without triangles.
    """
    bottoms, tops = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    at_floor = (bottoms >= low) & (tops <= high)
    facing = unit_normals(corners)[:, 2]
    down, up = corners[at_floor & (facing < -_FLAT)], corners[at_floor & (facing > _LEVEL)]
    down = down[down[:, :, 2].max(axis=1) >= floor_z - _TIE]
    floor_area = max(_area(up), 0.5 * grid.resolution**2 * grid.shape[0] * grid.shape[1] if ground_plane else 0.0)
    if not len(down) or _area(down) > _MAX_COVERED * floor_area:
        return np.zeros(grid.shape, dtype=bool)
    underside = grid.heights(down, np.maximum)
    standing = underside > -np.inf
    # Only triangles above these cells can be tops or ceilings.
    first, last = (np.asarray(grid.origin) + end * grid.resolution for end in _bounds(standing))
    over = (corners[:, :, :2].max(axis=1) > first).all(axis=1) & (corners[:, :, :2].min(axis=1) < last).all(axis=1)
    above = over & (bottoms > high)
    roof = grid.heights(corners[above & (facing < -_STEEP)], np.minimum)
    top = grid.heights(corners[above & (facing > _STEEP)], np.minimum)
    return np.asarray(standing & (underside >= grid.heights(up, np.maximum) - _TIE) & (top < roof))


def _area(corners: F64) -> float:
    """Returns the projected area of triangles (F, 3, 3) from above, square metres."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def _bounds(cells: Bools) -> tuple[I64, I64]:
    """Returns the bounding rectangle of the True cells (H, W): first and last corner as column and row, (2,) each."""
    indices = np.argwhere(cells)[:, ::-1]
    return (indices.min(axis=0), indices.max(axis=0) + 1) if len(indices) else (np.zeros(2, np.int64), np.zeros(2, np.int64))


def _is_floor(corners: F64, floor_z: float) -> Bools:
    """Returns a mask (F,) of the triangles (F, 3, 3) that are level and at the height of the floor."""
    near = (np.abs(corners[:, :, 2] - floor_z) <= FLOOR_TOLERANCE).all(axis=1)
    return np.asarray(near & (np.abs(unit_normals(corners)[:, 2]) >= _LEVEL))


def _affordable(resolution: float, size: F64) -> float:
    """Returns a cell size, metres, no finer than ``resolution``, with which a map of ``size`` (2,) metres fits into memory."""
    needed = max(math.sqrt(float(size[0] * size[1]) / _MAX_CELLS), float(size.max()) / _MAX_SIDE)
    if needed <= resolution:
        return resolution
    if needed > _COARSE:
        needed *= 2
    coarser = math.ceil(round(needed / 0.05, 9)) * 0.05
    logger.warning("the scene is %.0f x %.0f m: its floor map gets cells of %.2f m", size[0], size[1], coarser)
    return coarser


def _distance_to_blocked(blocked: Bools, resolution: float) -> F64:
    """Returns (H, W): distance from cell centres to the nearest blocked cell or the border of the map, metres, exact within a thousand cells."""
    rows, columns = blocked.shape
    # On a grid of half cells, the point of a cell nearest to the centre of another cell is always a grid point.
    lattice = np.zeros((2 * rows + 1, 2 * columns + 1), dtype=bool)
    lattice[0] = lattice[-1] = lattice[:, 0] = lattice[:, -1] = True
    for i in range(3):
        for j in range(3):
            lattice[i : i + 2 * rows - 1 : 2, j : j + 2 * columns - 1 : 2] |= blocked
    # OpenCV takes a fifth of the time of SciPy but uses single precision; squared distances are integers and can be restored by rounding.
    distance = cv2.distanceTransform((~lattice).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1::2, 1::2].astype(np.float64)
    exact = np.where(distance < _EXACT_BELOW, np.sqrt(np.rint(np.square(distance))), distance)
    return np.asarray(exact * (resolution / 2), dtype=np.float64)


def floor_at(floors: Sequence[float], z: float) -> int:
    """Returns the index of the floor on which a point is: the highest that is at most 0.2 m above it, else the lowest.

    So a lamp at the ceiling belongs to the floor below it, and a robot on a staircase to the floor that it comes from going up.

    Args:
        floors: heights of the floors in increasing order, world metres; empty counts as one floor.
        z: height of the point, world metres.
    """
    return max((number for number, floor_z in enumerate(floors) if floor_z <= z + _BELOW), default=0)


def with_floor_at(scene: SceneSpec, z: float) -> SceneSpec:
    """Returns the scene with ``floor_z`` at the floor on which a point is; ``z``: height of the point, world metres."""
    floor_z = scene.floors[floor_at(scene.floors, z)]
    return scene if floor_z == scene.floor_z else replace(scene, floor_z=floor_z, other_floors=scene.floors)


def floor_name(scene: SceneSpec) -> str:
    """Returns the name of the floor at ``floor_z`` where a scene has several, such as ``floor 1``, 0 = the lowest; else an empty text."""
    return f"floor {scene.floors.index(scene.floor_z)}" if len(scene.floors) > 1 else ""
