"""Traversability of each floor of a scene for a robot of a given size, over low steps and gentle slopes, and below higher obstacles.

The heights of the floors are given by the scene, or detected in its triangles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.formats.mesh import merge
from gibson_sim.geometry.rasterise import Grid, clip_to_slab
from gibson_sim.geometry.triangle_meshes import areas_of, unit_normals
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import (
    FLOOR_CLEARANCE,
    FLOOR_TOLERANCE,
    MIN_GROUND_SHARE,
    FloorMap,
    grid_about,
    has_ground_at,
    inside_solids,
    under_ceiling,
)
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SceneSpec

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]

MAX_RISE = 0.3
"""Maximum height difference between ramps and steps and the floor that they belong to, metres."""
_LAYER = 0.01
"""Thickness of the height layers, metres."""

STOREY = 1.8
"""Minimum height difference between two floors, metres: beds and tables are not floors."""
SMALLEST_SHARE = 0.2
"""Minimum area of a floor, as a fraction of that of the largest one."""
SMALLEST_AREA = 2.0
"""Minimum area of a floor, square metres."""
_HEADROOM = 1.5
"""Minimum height of a mesh above its floors, metres: a roof is not a floor."""
_UP = 0.8
"""Minimum cosine of the angle between the normal of a floor and the vertical."""
_BIN = 0.02
"""Bin width of the histogram of triangle heights, metres."""


@dataclass(frozen=True, slots=True)
class RobotSize:
    """The size and capabilities of a robot that determine traversability."""

    radius: float = 0.3
    """Radius of the circle about its base, metres."""
    height: float = 0.5
    """Height above the floor, metres."""
    step: float = FLOOR_CLEARANCE
    """Maximum height of a step that it climbs, up or down, metres."""
    slope: float = math.radians(20.0)
    """Maximum slope that it drives on, radians."""

    def __post_init__(self) -> None:
        for name, low, high in (("radius", 0.0, 10.0), ("height", 0.02, 10.0), ("step", 0.0, MAX_RISE), ("slope", 0.0, 1.2)):
            value = getattr(self, name)
            if not low <= value <= high:
                unit = "rad" if name == "slope" else "m"
                raise SceneError(f"robot size: {name} is {value:g} {unit}, must be from {low:g} to {high:g} {unit}")
        if self.height <= self.step:
            raise SceneError(f"robot size: height is {self.height:g} m, must be more than step, which is {self.step:g} m")


def floor_maps(
    scene: SceneSpec,
    robot: RobotSize | None = None,
    *,
    resolution: float = 0.05,
    floors: Sequence[float] | None = None,
    bodies: bool = True,
) -> tuple[FloorMap, ...]:
    """Returns a map of every floor, from the lowest: its free cells are those that the robot can reach and stand in.

    Obstacles are not inflated by the robot's radius: ``FloorMap.inflate``, ``shortest_path`` and other functions do that.

    Args:
        scene: the scene, whose collision shapes are used.
        robot: size of the robot; None = 0.5 m high, climbs 3 cm.
        resolution: edge of a cell, metres; made coarser, with a warning, if a map would become too large.
        floors: heights of the floors, world metres; None = those of ``scene_floors``.
        bodies: whether to include movable bodies at their start poses; without them the map is that with all doors open.

    Raises:
        SceneError: the scene has no surface at a floor's height.
    """
    heights = scene_floors(scene) if floors is None else tuple(floors)
    corners = scene_triangles(scene, bodies=bodies)
    return tuple(
        traversable_map(
            corners,
            floor_z=z,
            robot=robot or RobotSize(),
            resolution=resolution,
            ground_plane=has_ground_at(scene, z),
        )
        for z in heights
    )


def traversable_map(
    corners: ArrayLike, *, floor_z: float, robot: RobotSize, resolution: float = 0.05, ground_plane: bool = False
) -> FloorMap:
    """Returns the map of one floor.

    A robot can stand in a cell on a surface within the slope limit that has no obstacle between the robot's step and its height above it. The
    cell is free if a chain of such cells connects it to the floor, each at most a step higher or lower than the previous one. Cells inside
    solids that stand on the floor are not free.

    Args:
        corners: (F, 3, 3), triangles, world metres.
        floor_z: height of the floor, world metres.
        robot: size of the robot.
        resolution: edge of a cell, metres; made coarser, with a warning, if the map would become too large.
        ground_plane: whether the floor is everywhere; a floor among the triangles takes precedence.

    Raises:
        SceneError: the scene has no surface at this height.
    """
    every = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    near = every[_reaches(every, floor_z - MAX_RISE, floor_z + MAX_RISE + robot.height)]
    surfaces = near[np.abs(unit_normals(near)[:, 2]) >= math.cos(robot.slope)]
    surfaces = surfaces[_reaches(surfaces, floor_z - MAX_RISE, floor_z + MAX_RISE)]
    level = surfaces[_reaches(surfaces, floor_z - FLOOR_TOLERANCE, floor_z + FLOOR_TOLERANCE)][:, :, :2]
    obstacles = clip_to_slab(near, floor_z + FLOOR_CLEARANCE, floor_z + robot.height)
    grid = grid_about(level, obstacles, resolution, floor_z, ground_plane)

    solid = inside_solids(every, grid, floor_z, floor_z - FLOOR_TOLERANCE, floor_z + FLOOR_CLEARANCE, ground_plane=ground_plane)
    layers = _layers(surfaces, floor_z, grid, solid, ground_plane)
    steps = max(1, math.floor(robot.step / _LAYER + 1e-6))
    seeds = np.zeros_like(layers)
    middle = len(layers) // 2
    seeds[middle - steps : middle + steps + 1] = layers[middle - steps : middle + steps + 1]
    for index in np.flatnonzero(_grown(seeds, layers, steps).any(axis=(1, 2))):
        height = floor_z + (index - middle) * _LAYER
        low = height + max(robot.step, FLOOR_CLEARANCE) + _LAYER / 2
        layers[index] &= ~grid.cover(clip_to_slab(near, low, height + robot.height))
    free = _grown(seeds & layers, layers, steps).any(axis=0)
    floor = np.asarray(free | solid | layers.any(axis=0))
    occupied = np.asarray((grid.cover(obstacles) | floor) & ~free)
    return FloorMap(grid.resolution, grid.origin, occupied, floor, under_ceiling(every, floor_z, grid), floor_z)


def scene_floors(scene: SceneSpec, triangles: tuple[F64, NDArray[np.int32]] | None = None) -> tuple[float, ...]:
    """Returns the heights of all floors, from the lowest, world metres: those given by the scene, else detected ones.

    Args:
        scene: the scene.
        triangles: its ``collision_triangles``: vertices (V, 3), world metres, and triangles (F, 3); None = load them.
    """
    if scene.other_floors:
        return scene.floors
    heights = find_floors(*(triangles or collision_triangles(scene)))
    others = [z for z in heights if abs(z - scene.floor_z) >= STOREY]
    return tuple(sorted([scene.floor_z, *others]))


def find_floors(vertices: F64, triangles: NDArray[np.int32]) -> tuple[float, ...]:
    """Returns the heights of the floors of a mesh, from the lowest, world metres.

    The mesh must extend at least 1.5 m above a floor: a roof is not a floor.

    Args:
        vertices: (V, 3), world metres.
        triangles: (F, 3), rows of ``vertices``.
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    if not len(corners):
        return ()
    normals = unit_normals(corners)
    areas = areas_of(corners)
    top = _quantile(corners[:, :, 2].max(axis=1), areas, 0.999)
    z = corners[:, :, 2].mean(axis=1)
    up = (normals[:, 2] > _UP) & (z < top - _HEADROOM)
    z, areas = z[up], areas[up]
    floors: list[tuple[float, float]] = []
    while len(z):
        bins = np.floor((z - z.min()) / _BIN).astype(np.int64)
        # Noise of a scan spreads a floor over three bins.
        height = np.convolve(np.bincount(bins, weights=areas), np.ones(3), mode="same")
        peak = z.min() + (int(height.argmax()) + 0.5) * _BIN
        near = np.abs(z - peak) <= 1.5 * _BIN
        area = float(areas[near].sum())
        if area < max(SMALLEST_AREA, SMALLEST_SHARE * max((a for _, a in floors), default=0.0)):
            break
        floors.append((_quantile(z[near], areas[near], 0.5), area))
        rest = np.abs(z - peak) >= STOREY
        z, areas = z[rest], areas[rest]
    return tuple(sorted(float(np.round(height, 6)) + 0.0 for height, _ in floors))


def scene_triangles(scene: SceneSpec, *, bodies: bool = True) -> F64:
    """Returns the collision shapes of a scene without its robots as triangles (F, 3, 3), world metres; bodies at their start poses.

    Args:
        scene: the scene.
        bodies: whether to include movable bodies.
    """
    fixed = collision_triangles(scene)
    vertices, triangles = merge([fixed, body_triangles(scene)]) if bodies and scene.bodies else fixed
    return np.asarray(vertices[triangles])


def _layers(surfaces: F64, floor_z: float, grid: Grid, solid: Bools, ground_plane: bool) -> Bools:
    """Returns a mask (L, H, W) of the cells with a surface (F, 3, 3), by height layer; the middle layer is at the floor.

    Cells that are ``solid``, (H, W), have no floor.
    """
    half = round(MAX_RISE / _LAYER)
    layers = np.zeros((2 * half + 1, *grid.shape), dtype=bool)
    for index in range(len(layers)):
        low = floor_z + (index - half - 0.5) * _LAYER
        inside = surfaces[_reaches(surfaces, low, low + _LAYER)]
        layers[index] = grid.cover(clip_to_slab(inside, low, low + _LAYER))
    # There may be gaps between the floor tiles of a model.
    about = layers[half - 2 : half + 3].any(axis=0)
    closed = ndimage.binary_closing(np.pad(about, 2), np.ones((3, 3)))[2:-2, 2:-2]
    layers[half] |= closed & ~about
    if ground_plane and (about & ~solid).mean() < MIN_GROUND_SHARE:
        layers[half] = True
    layers[: half + round(FLOOR_CLEARANCE / _LAYER) + 1] &= ~solid
    return layers


def _grown(seeds: Bools, places: Bools, steps: int) -> Bools:
    """Returns a mask (L, H, W) of the ``places`` connected to ``seeds`` over adjacent cells, each at most ``steps`` layers higher or lower."""
    structure = np.zeros((2 * steps + 1, 3, 3), dtype=bool)
    structure[:, 1, :] = structure[:, :, 1] = True
    used = np.flatnonzero(places.any(axis=(1, 2)))
    if not len(used):
        return np.zeros_like(places)
    # Omit empty layers at the bottom and the top to save time.
    part = slice(int(used[0]), int(used[-1]) + 1)
    out = np.zeros_like(places)
    out[part] = ndimage.binary_propagation(seeds[part], structure, mask=places[part])
    return out


def _reaches(corners: F64, low: float, high: float) -> Bools:
    """Returns a mask (F,) of the triangles (F, 3, 3) with a part between two heights."""
    return np.asarray((corners[:, :, 2].max(axis=1) >= low) & (corners[:, :, 2].min(axis=1) <= high))


def _quantile(values: F64, weights: F64, share: float) -> float:
    """Returns the weighted quantile of values (N,): the smallest value up to which they have a share of all weights (N,)."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, share * total[-1])), len(values) - 1)])
