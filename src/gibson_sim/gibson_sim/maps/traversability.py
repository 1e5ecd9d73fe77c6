"""Where a robot of some size can go on each floor of a scene: over low steps and gentle slopes, under what is higher than it is."""

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
from gibson_sim.geometry.triangles import unit_normals
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FLOOR_CLEARANCE, FLOOR_TOLERANCE, FloorMap, grid_about, inside_solids, under_ceiling
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import SceneSpec

F64 = NDArray[np.float64]
STOREY = 1.8
"""Two floors are at least this far apart, metres: beds and tables are no floors."""
SMALLEST_SHARE = 0.2
"""A floor has at least this part of the area of the largest one."""
SMALLEST_AREA = 2.0
"""Square metres of a floor."""
_HEADROOM = 1.5
_UP = 0.8
_BIN = 0.02


def scene_floors(scene: SceneSpec, triangles: tuple[F64, NDArray[np.int32]] | None = None) -> tuple[float, ...]:
    """Returns the heights of all floors, from the lowest, metres: those that the scene names, else those that are found.

    Args:
        scene: the scene.
        triangles: its ``collision_triangles``; None = read here.
    """
    if scene.other_floors:
        return scene.floors
    found = find_floors(*(triangles or collision_triangles(scene)))
    others = [z for z in found if abs(z - scene.floor_z) >= STOREY]
    return tuple(sorted([scene.floor_z, *others]))


def find_floors(vertices: F64, triangles: NDArray[np.int32]) -> tuple[float, ...]:
    """Returns the heights of the floors of a mesh, from the lowest, metres.

    A roof is no floor: something must stand or hang at least 1.5 m above one.

    Args:
        vertices: (V, 3), world frame, metres.
        triangles: (F, 3).
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    if not len(corners):
        return ()
    normals = unit_normals(corners)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    top = _quantile(corners[:, :, 2].max(axis=1), areas, 0.999)
    z = corners[:, :, 2].mean(axis=1)
    up = (normals[:, 2] > _UP) & (z < top - _HEADROOM)
    z, areas = z[up], areas[up]
    found: list[tuple[float, float]] = []
    while len(z):
        bins = np.floor((z - z.min()) / _BIN).astype(np.int64)
        # Three bins together: the noise of a scan spreads a floor.
        height = np.convolve(np.bincount(bins, weights=areas), np.ones(3), mode="same")
        peak = z.min() + (int(height.argmax()) + 0.5) * _BIN
        near = np.abs(z - peak) <= 1.5 * _BIN
        area = float(areas[near].sum())
        if area < max(SMALLEST_AREA, SMALLEST_SHARE * max((a for _, a in found), default=0.0)):
            break
        found.append((_quantile(z[near], areas[near], 0.5), area))
        rest = np.abs(z - peak) >= STOREY
        z, areas = z[rest], areas[rest]
    return tuple(sorted(float(np.round(height, 6)) + 0.0 for height, _ in found))


def _quantile(values: F64, weights: F64, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(total, share * total[-1])), len(values) - 1)])


Bools = NDArray[np.bool_]

REACH = 0.3
"""How far above and below the height of a floor ramps and steps belong to it, metres."""
_LAYER = 0.01
"""Heights are told apart by this much, metres."""


@dataclass(frozen=True, slots=True)
class RobotSize:
    """What decides where a robot can go."""

    radius: float = 0.3
    """Of the circle about its base, metres."""
    height: float = 0.5
    """Metres above the floor."""
    step: float = FLOOR_CLEARANCE
    """The highest step that it climbs, up or down, metres."""
    slope: float = math.radians(20.0)
    """The steepest slope that it drives on, radians."""

    def __post_init__(self) -> None:
        for name, low, high in (("radius", 0.0, 10.0), ("height", 0.02, 10.0), ("step", 0.0, REACH), ("slope", 0.0, 1.2)):
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
    """Returns a map of every floor, from the lowest: its free cells are those that a robot can stand in and come to.

    The maps are not grown by the robot's radius: ``FloorMap.inflate``, ``shortest_path`` and the others do that.

    Args:
        scene: its collision shapes count.
        robot: None = one 0.5 m high that climbs 3 cm.
        resolution: edge of a cell, metres.
        floors: heights of the floors, metres; None = those that the scene names, else those that are found in it.
        bodies: what can be moved counts too, where it stands at load; False = only what is fixed, as if all doors were open.

    Raises:
        SceneError: there is nothing at a floor's height.
    """
    heights = scene_floors(scene) if floors is None else tuple(floors)
    corners = scene_triangles(scene, bodies=bodies)
    return tuple(
        traversable_map(
            corners,
            floor_z=z,
            robot=robot or RobotSize(),
            resolution=resolution,
            ground_plane=scene.ground_z is not None and abs(scene.ground_z - z) <= FLOOR_TOLERANCE,
        )
        for z in heights
    )


def scene_triangles(scene: SceneSpec, *, bodies: bool = True) -> F64:
    """Returns the collision shapes of everything but robots as triangles (F, 3, 3), world frame, metres; bodies where they stand at load."""
    fixed = collision_triangles(scene)
    vertices, triangles = merge([fixed, body_triangles(scene)]) if bodies and scene.bodies else fixed
    return np.asarray(vertices[triangles])


def traversable_map(
    corners: ArrayLike, *, floor_z: float, robot: RobotSize, resolution: float = 0.05, ground_plane: bool = False
) -> FloorMap:
    """Returns the map of one floor.

    A cell can be stood in at a height where a surface within the slope limit lies, and nothing between the robot's step and its
    height above that. It is free if such places lead to it from the floor, each at most a step higher or lower than the one before.
    Inside of what stands on the floor nothing is free.

    Args:
        corners: (F, 3, 3), triangles, world frame, metres.
        floor_z: height of the floor, metres.
        robot: its size.
        resolution: edge of a cell, metres; made coarser, with a warning, where the map would become too large.
        ground_plane: there is a floor everywhere, unless the triangles have one of their own.

    Raises:
        SceneError: there is nothing at this height.
    """
    every = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    near = every[_reaches(every, floor_z - REACH, floor_z + REACH + robot.height)]
    surfaces = near[np.abs(unit_normals(near)[:, 2]) >= math.cos(robot.slope)]
    surfaces = surfaces[_reaches(surfaces, floor_z - REACH, floor_z + REACH)]
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


def _reaches(corners: F64, low: float, high: float) -> Bools:
    """Returns (F,): triangles (F, 3, 3) that have a part between two heights."""
    return np.asarray((corners[:, :, 2].max(axis=1) >= low) & (corners[:, :, 2].min(axis=1) <= high))


def _layers(surfaces: F64, floor_z: float, grid: Grid, solid: Bools, ground_plane: bool) -> Bools:
    """Returns (L, H, W): where surfaces (F, 3, 3) lie, in layers about the height of the floor; the middle one is the floor's.

    In cells that are ``solid``, (H, W), there is no floor.
    """
    half = round(REACH / _LAYER)
    layers = np.zeros((2 * half + 1, *grid.shape), dtype=bool)
    for index in range(len(layers)):
        low = floor_z + (index - half - 0.5) * _LAYER
        inside = surfaces[_reaches(surfaces, low, low + _LAYER)]
        layers[index] = grid.cover(clip_to_slab(inside, low, low + _LAYER))
    # Neighbouring floor tiles of a model may leave cracks.
    about = layers[half - 2 : half + 3].any(axis=0)
    closed = ndimage.binary_closing(np.pad(about, 2), np.ones((3, 3)))[2:-2, 2:-2]
    layers[half] |= closed & ~about
    if ground_plane and (about & ~solid).mean() < 0.2:
        layers[half] = True
    layers[: half + round(FLOOR_CLEARANCE / _LAYER) + 1] &= ~solid
    return layers


def _grown(seeds: Bools, places: Bools, steps: int) -> Bools:
    """Returns (L, H, W): the places that are led to from seeds, from cell to cell beside it, at most ``steps`` layers up or down."""
    structure = np.zeros((2 * steps + 1, 3, 3), dtype=bool)
    structure[:, 1, :] = structure[:, :, 1] = True
    used = np.flatnonzero(places.any(axis=(1, 2)))
    if not len(used):
        return np.zeros_like(places)
    # Layers without any place at the bottom and the top cost time only.
    part = slice(int(used[0]), int(used[-1]) + 1)
    out = np.zeros_like(places)
    out[part] = ndimage.binary_propagation(seeds[part], structure, mask=places[part])
    return out
