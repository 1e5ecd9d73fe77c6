"""Images of obstacles from close by, to learn free distances from: what stands on the floor, seen from all sides, in all rooms.

The shards of ``data.py`` show a robot's way, where most of what is near is a wall. These show what ``clutter.random_obstacle`` makes, a few
pieces at a time, from 0.5 to 2.6 m, in the light and with the cameras of the domain ``trained``. They have no pairs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.tasks.episode import item_body
from gibson_sim_learn.path_following.clutter import random_obstacle
from gibson_sim_learn.path_following.data import (
    PAIR,
    ROBOT_RADIUS,
    Shard,
    World,
    camera_poses,
    column_bearings,
    free_distances,
    sees,
    shard_rng,
    with_bodies,
)
from gibson_sim_learn.path_following.domains import TRAINED, draw
from gibson_sim_learn.path_following.drawing import CAMERA_X, HFOV, Drawing

F64 = NDArray[np.float64]
_RECOLOUR_CHANCE = 0.5
"""Probability that a shard has other colours and textures than its scene."""
_ARRANGEMENTS = 5
"""Of obstacles, in a shard."""
_AT_A_TIME = (3, 10)
"""Fewest and most obstacles of an arrangement."""
_VIEWS = 160
"""Images of an arrangement, at most."""
_DISTANCES = (0.5, 2.6)
"""Of the robot from the middle of an obstacle, metres."""
_TURNED = 0.35
"""Standard deviation of the angle between where it looks and where the obstacle is, radians."""


def draw_obstacle_shard(world: World, seed: int, number: int) -> Shard:
    """Returns a shard; equal arguments give equal data."""
    rng = shard_rng(f"obstacles {seed} {world.scene.name} {number}")
    images, free = [], []
    with Drawing(world.scene, rng, _RECOLOUR_CHANCE) as drawing:
        for _ in range(_ARRANGEMENTS):
            places = random_free_poses(world.coarse, int(rng.integers(_AT_A_TIME[0], _AT_A_TIME[1] + 1)), rng, clearance=0.2)
            bodies = [item_body(random_obstacle(rng, f"obstacle_{k}", *pose.position)) for k, pose in enumerate(places)]
            floor = with_bodies(world.scene, world.floor, bodies)
            poses = views_around(np.array([pose.position[:2] for pose in places]), world.floor, floor, rng)
            drawn = [draw(TRAINED, rng) for _ in places]
            conditions = [drawn[int(rng.integers(len(drawn)))] for _ in poses]
            cameras = camera_poses(poses, CAMERA_X)
            images.append(drawing.images(bodies, cameras, conditions, 1.0))
            bearings = np.array([column_bearings(HFOV + each.hfov_change) for each in conditions])
            free.append(free_distances(floor, cameras, bearings.reshape(len(cameras), -1)))
    return Shard(np.concatenate(images), np.concatenate(free).astype(np.float32), np.zeros(0, PAIR))


def views_around(places: F64, before: FloorMap, after: FloorMap, rng: np.random.Generator) -> F64:
    """Returns poses (N, 3), metres and radians, of a robot that touches nothing and looks at one of some places, no wall between.

    Args:
        places: of the obstacles, world frame, metres.
        before: the map without them.
        after: the map with them.
        rng: of the poses.
    """
    goals = places[rng.integers(0, len(places), 4 * _VIEWS)]
    away, angle = rng.uniform(*_DISTANCES, len(goals)), rng.uniform(-math.pi, math.pi, len(goals))
    x, y = (goals - away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)).T
    poses = np.column_stack([x, y, angle + rng.normal(0.0, _TURNED, len(goals))])
    fits = np.flatnonzero(after.clearance(poses[:, :2]) >= ROBOT_RADIUS)
    seen = [k for k in fits if sees(before, poses[k], goals[k : k + 1])[0]]
    return poses[seen[:_VIEWS]]
