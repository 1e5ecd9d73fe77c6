"""Images of obstacles from close by, to learn free distances from: what stands on the floor, seen from all sides, in all rooms.

The shards of ``data.py`` show a robot's way, where most of what is near is a wall. These show what ``clutter.random_obstacle`` makes, a few
pieces at a time, from 0.5 to 2.6 m, in the light and with the cameras of the domain ``trained``; and what a robot sees anywhere between
them. Each image has one of the same camera a little earlier. They have no pairs.
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
    relative_pose,
    sees,
    shard_rng,
    views_anywhere,
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
_VIEWS, _ANYWHERE = 110, 40
"""Views of obstacles in an arrangement, and views from anywhere, at most."""
_DISTANCES = (0.5, 2.6)
"""Of the robot from the middle of an obstacle, metres."""
_TURNED = 0.35
"""Standard deviation of the angle between where it looks and where the obstacle is, radians."""
_DRIVEN = (0.08, 0.45)
"""Way between the earlier image and the present one, metres."""
_BENT = 0.15
"""Standard deviation of the turn in between, radians."""
_MARGIN = 0.08
"""Distance by which the robot may have stood too near to things then, metres: it does not matter how it came here."""


def draw_obstacle_shard(world: World, seed: int, number: int) -> Shard:
    """Returns a shard; equal arguments give equal data."""
    rng = shard_rng(f"obstacles {seed} {world.scene.name} {number}")
    images, free, poses = [], [], []
    with Drawing(world.scene, rng, _RECOLOUR_CHANCE) as drawing:
        for _ in range(_ARRANGEMENTS):
            places = random_free_poses(world.coarse, int(rng.integers(_AT_A_TIME[0], _AT_A_TIME[1] + 1)), rng, clearance=0.2)
            bodies = [item_body(random_obstacle(rng, f"obstacle_{k}", *pose.position)) for k, pose in enumerate(places)]
            floor = with_bodies(world.scene, world.floor, bodies)
            close = views_around(np.array([pose.position[:2] for pose in places]), world.floor, floor, rng)
            now, before = driven_to(np.concatenate([close, views_anywhere(world, floor, rng, _ANYWHERE)]), floor, rng)
            drawn = [draw(TRAINED, rng) for _ in places]
            conditions = [drawn[int(rng.integers(len(drawn)))] for _ in now]
            both = np.stack([now, before], axis=1)
            images.append(
                drawing.images(bodies, both.reshape(-1, 3), [each for each in conditions for _ in range(2)], 1.0, alike=2)
            )
            bearings = np.array([column_bearings(HFOV + each.hfov_change) for each in conditions])
            free.append(free_distances(floor, now, bearings.reshape(len(now), -1)))
            poses.append(relative_pose(now, before))
    every = np.concatenate(images)
    return Shard(
        every[::2],
        np.concatenate(free).astype(np.float32),
        np.zeros(0, PAIR),
        earlier=every[1::2],
        earlier_pose=np.concatenate(poses).astype(np.float32),
    )


def driven_to(poses: F64, floor: FloorMap, rng: np.random.Generator) -> tuple[F64, F64]:
    """Returns poses (M, 3) of the cameras of robots, and (M, 3) where each was a little earlier, on an arc; those that came through things are
    left out.

    Args:
        poses: (N, 3), of the robots, world frame, metres and radians.
        floor: the map with all that stands on it.
        rng: of the arcs.
    """
    distance, turn = rng.uniform(*_DRIVEN, len(poses)), rng.normal(0.0, _BENT, len(poses))
    x, y, yaw = poses.T
    chord = yaw - turn / 2.0
    before = np.column_stack([x - distance * np.cos(chord), y - distance * np.sin(chord), yaw - turn])
    fits = floor.clearance(before[:, :2]) >= ROBOT_RADIUS - _MARGIN
    return camera_poses(poses[fits], CAMERA_X), camera_poses(before[fits], CAMERA_X)


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
