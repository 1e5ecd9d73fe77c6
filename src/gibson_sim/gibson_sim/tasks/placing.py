"""Samples collision-free poses of robots and items on the floor. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.tasks.episode import Item
from gibson_sim.tasks.ground import Ground
from gibson_sim.types import Pose

F64 = NDArray[np.float64]
TRIES = 60
"""Number of attempts to find a pose before a scene counts as too small."""
START_CLEARANCE = 0.08
"""Free space around the start beyond the robot's radius, metres."""


def free_place(ground: Ground, rng: np.random.Generator, region: NDArray[np.bool_] | None = None) -> Pose:
    """Samples a pose of the robot, T_world_base, in the largest reachable region, or in ``region`` (H, W).

    Raises:
        SceneError: there is no free pose.
    """
    clearance = ground.space.clearance + START_CLEARANCE
    return random_free_poses(ground.floor, 1, rng, clearance=clearance, region=region)[0]


def at_distance(ground: Ground, rng: np.random.Generator, start: Pose, low: float, high: float) -> tuple[Pose, float]:
    """Samples a pose whose path from ``start`` is ``low`` to ``high`` metres long; returns it with the length of the path, metres.

    Raises:
        SceneError: there is no such pose.
    """
    distances = ground.space.planner.distances(start.position[:2])
    region = np.asarray((distances >= low) & (distances <= high))
    pose = free_place(ground, rng, region)
    row, column = ground.floor.cells(pose.position[:2])
    return pose, float(distances[row, column])


def on_floor(ground: Ground, x: float, y: float, yaw: float) -> Pose:
    """Returns a pose on the floor, T_world_root; x and y in metres, yaw in radians."""
    return pose_from_xyz_rpy((x, y, ground.floor.floor_z), (0.0, 0.0, yaw))


def clutter(
    ground: Ground,
    rng: np.random.Generator,
    path: F64,
    models: Sequence[str],
    count: int,
    *,
    keep_clear: Sequence[tuple[tuple[float, float], float]],
    beside: float = 0.35,
    prefix: str = "clutter",
) -> tuple[Item, ...]:
    """Places random items on and beside a path; fewer than ``count`` if there is no room.

    Args:
        ground: the floor and the robot.
        rng: random generator.
        path: waypoints (K, 2), world frame, metres.
        models: objects to choose from.
        count: number of items.
        keep_clear: centres (x, y) and radii, metres, of areas that stay free.
        beside: largest distance from the path along each axis, metres.
        prefix: prefix of the names.
    """
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    occupied = [*keep_clear]
    items: list[Item] = []
    for _ in range(TRIES):
        if len(items) == count:
            break
        distance = rng.uniform(0.0, arc[-1])
        x, y = (float(np.interp(distance, arc, path[:, k])) for k in range(2))
        x, y = (float(c) for c in np.array([x, y]) + rng.uniform(-beside, beside, 2))
        model = models[int(rng.integers(len(models)))]
        yaw = float(rng.uniform(-math.pi, math.pi))
        if float(ground.floor.clearance((x, y))) < _RADIUS or any(
            math.dist((x, y), centre) < radius + _RADIUS for centre, radius in occupied
        ):
            continue
        occupied.append(((x, y), _RADIUS))
        items.append(Item(f"{prefix}_{len(items) + 1}", model, on_floor(ground, x, y, yaw)))
    return tuple(items)


_RADIUS = 0.26
"""Radius of the largest clutter object, metres."""


def no_room(task: str, ground: Ground, what: str) -> SceneError:
    """Returns the error for a scene that is too small for a task."""
    return SceneError(f"task {task}: scene {ground.scene.name!r} has no room for it: {what}; choose another scene")
