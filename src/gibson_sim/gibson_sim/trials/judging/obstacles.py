"""Obstacles of a run as named cells on the floor: the map, spawned objects and bodies of the scene. Also descriptions of positions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.bags.plots.run_data import Floor
from gibson_sim.description.body import BodySpec
from gibson_sim.errors import GibsonSimError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.trials.records import RunSpec

F64 = NDArray[np.float64]
MAP_HEIGHT = 0.5
"""Height above the floor up to which objects count as obstacles, m, as in a map for a robot of unknown height."""
_CELL_SIZE = 0.02
"""Cell size for bodies, metres."""
_SCENES = 16
"""Number of scenes kept in memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """Occupied squares on the floor."""

    name: str
    """``the map``, or the name of the body."""
    centers: F64
    """(N, 2), map frame, metres; N is 1 or more."""
    edge: float
    """Edge length of a square, metres."""
    tree: cKDTree

    @classmethod
    def of(cls, name: str, centers: F64, edge: float) -> Obstacles:
        """Returns squares with the given centres (N, 2)."""
        return cls(name, centers, edge, cKDTree(centers))

    def distance(self, points: F64) -> F64:
        """Returns the exact distances (M,), metres, from points (M, 2) to the nearest square; 0 inside a square."""
        half = self.edge / 2.0
        nearest, _ = self.tree.query(points)
        # The nearest square is no farther than the nearest centre, so its centre is within half a diagonal of that distance.
        distances = np.empty(len(points))
        near = self.tree.query_ball_point(points, nearest + half * np.sqrt(2.0) + 1e-9)
        for i, (point, indices) in enumerate(zip(points, near, strict=True)):
            outside = np.maximum(np.abs(self.centers[indices] - point) - half, 0.0)
            distances[i] = np.sqrt((outside**2).sum(axis=1).min())
        return distances

    def least_distance(self, points: F64) -> tuple[float, int]:
        """Returns the least ``distance`` of points (M, 2), metres, and the index of that point."""
        rough, _ = self.tree.query(points)
        # A square's nearest point is at most half a diagonal nearer than its centre.
        candidates = np.flatnonzero(rough <= rough.min() + self.edge * np.sqrt(0.5))
        exact = self.distance(points[candidates])
        best = int(exact.argmin())
        return float(exact[best]), int(candidates[best])


def floor_obstacles(floor: Floor) -> Obstacles | None:
    """Returns the occupied cells of a map; None = none."""
    rows, columns = np.nonzero(floor.cells >= 100)
    if not len(rows):
        return None
    centers = np.column_stack([columns + 0.5, rows + 0.5]) * floor.resolution + np.array(floor.origin)
    return Obstacles.of("the map", centers, floor.resolution)


@lru_cache(maxsize=_SCENES)
def load_scene_or_none(name: str) -> SceneSpec | None:
    """Returns a scene by name or file; None = it cannot be loaded on this machine."""
    try:
        return load_scene(name)
    except GibsonSimError:
        return None


@lru_cache(maxsize=_SCENES)
def scene_floor(name: str) -> Floor | None:
    """Returns the floor map of a scene, as its simulation publishes it for a low robot; None = it cannot be created."""
    scene = load_scene_or_none(name)
    if scene is None:
        return None
    try:
        floor = scene_floor_map(scene, robot_height=MAP_HEIGHT)
    except GibsonSimError:
        return None
    cells = np.where(floor.occupied, 100, np.where(floor.floor, 0, -1)).astype(np.int8)
    return Floor(cells, floor.resolution, floor.origin, f"scene {name}")


def body_obstacles(run: RunSpec) -> tuple[Obstacles, ...]:
    """Returns the obstacles of a run besides the map: spawned objects at their poses, and bodies of the scene with the closed doors."""
    scene = load_scene_or_none(run.scene)
    if scene is None:
        return ()
    spawned = []
    for placed in run.things:
        pose = pose_from_xyz_rpy((placed.pose[0], placed.pose[1], placed.z), (0.0, 0.0, placed.pose[2]))
        try:
            body = load_spawnable(placed.object, "", name=placed.name, pose=pose)
        except GibsonSimError:
            continue
        if isinstance(body, BodySpec) and (obstacle := _body_cells(scene, body)) is not None:
            spawned.append(obstacle)
    return (*spawned, *_scene_bodies(run.scene, run.closed_doors))


@lru_cache(maxsize=_SCENES)
def _scene_bodies(name: str, closed_doors: tuple[str, ...]) -> tuple[Obstacles, ...]:
    """Returns the bodies of a scene at their poses after loading, with the given doors closed."""
    scene = load_scene_or_none(name)
    assert scene is not None
    bodies = (replace(body, joints=()) if body.name in closed_doors and body.model.joints else body for body in scene.bodies)
    return tuple(obstacle for body in bodies if (obstacle := _body_cells(scene, body)) is not None)


def _body_cells(scene: SceneSpec, body: BodySpec) -> Obstacles | None:
    """Returns the cells that a body covers below ``MAP_HEIGHT``; None = none."""
    vertices, triangles = body_triangles(replace(scene, bodies=(body,)))
    if not len(triangles):
        return None
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    columns, rows = np.maximum(1, np.ceil((high - low) / _CELL_SIZE).astype(int) + 1)
    no_cells = np.zeros((rows, columns), dtype=bool)
    floor = FloorMap(_CELL_SIZE, (float(low[0]), float(low[1])), no_cells, ~no_cells, floor_z=scene.floor_z)
    cells = np.argwhere(floor.furnished(vertices, triangles, MAP_HEIGHT).occupied)
    return Obstacles.of(body.name, floor.centers(cells), _CELL_SIZE) if len(cells) else None


def place_text(run: RunSpec, x: float, y: float) -> str:
    """Returns a description of a point: ``at (3.10, 4.20) in kitchen``; without the room if the scene has no named room there."""
    scene = load_scene_or_none(run.scene)
    room = None if scene is None else scene.room_at(x, y, scene.floors.index(scene.floor_z))
    return f"at ({x:.2f}, {y:.2f})" + (f" in {room.name}" if room is not None else "")
