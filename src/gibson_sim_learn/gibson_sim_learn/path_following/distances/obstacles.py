"""Training data of free distances: images of obstacles from close by, from all sides, in all rooms.

In the shards of ``data.py``, along paths, most near surfaces are walls. These shards show the obstacles of ``clutter.random_obstacle``, a few at a
time, from 0.5 to 2.6 m, in the light and with the cameras of the domain ``trained``, and views from random poses between them. Each image has
an earlier one of the same camera. They have no pairs.
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
    has_line_of_sight,
    random_view_poses,
    relative_pose,
    shard_rng,
    with_bodies,
)
from gibson_sim_learn.path_following.domains import TRAINED, draw
from gibson_sim_learn.path_following.drawing import CAMERA_AHEAD, HFOV, Drawing

F64 = NDArray[np.float64]
_RECOLOUR_CHANCE = 0.5
"""Probability that colours and textures of the scene change in a shard."""
_ARRANGEMENTS = 5
"""Number of arrangements of obstacles in a shard."""
_OBSTACLES = (3, 10)
"""Smallest and largest number of obstacles in an arrangement."""
_VIEWS, _RANDOM_VIEWS = 110, 40
"""Largest numbers of views of obstacles and of views from random poses, in an arrangement."""
_DISTANCES = (0.5, 2.6)
"""Smallest and largest distance of the robot from the centre of an obstacle, metres."""
_BEARING_DEVIATION = 0.35
"""Standard deviation of the bearing of the obstacle, radians."""
_BASELINE = (0.08, 0.45)
"""Smallest and largest distance driven between the earlier image and the present one, metres."""
_TURN_DEVIATION = 0.15
"""Standard deviation of the turn in between, radians."""
_MARGIN = 0.08
"""By how much the clearance of the earlier pose may be smaller than the robot's radius, metres."""


def draw_obstacle_shard(world: World, seed: int, number: int) -> Shard:
    """Returns a shard; equal arguments give equal data."""
    rng = shard_rng(f"obstacles {seed} {world.scene.name} {number}")
    images, free, poses = [], [], []
    with Drawing(world.scene, rng, _RECOLOUR_CHANCE) as drawing:
        for _ in range(_ARRANGEMENTS):
            places = random_free_poses(world.coarse, int(rng.integers(_OBSTACLES[0], _OBSTACLES[1] + 1)), rng, clearance=0.2)
            bodies = [item_body(random_obstacle(rng, f"obstacle_{k}", *pose.position)) for k, pose in enumerate(places)]
            floor = with_bodies(world.scene, world.floor, bodies)
            close = poses_around(np.array([pose.position[:2] for pose in places]), world.floor, floor, rng)
            now, before = with_earlier_poses(
                np.concatenate([close, random_view_poses(world, floor, rng, _RANDOM_VIEWS)]), floor, rng
            )
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


def with_earlier_poses(poses: F64, floor: FloorMap, rng: np.random.Generator) -> tuple[F64, F64]:
    """Returns poses (M, 3) of the cameras of robots, and their earlier poses (M, 3), on an arc; without those that would have collided.

    Args:
        poses: (N, 3), poses of the robots, world frame, metres and radians.
        floor: the map with all bodies.
        rng: of the arcs.
    """
    distance, turn = rng.uniform(*_BASELINE, len(poses)), rng.normal(0.0, _TURN_DEVIATION, len(poses))
    x, y, yaw = poses.T
    chord = yaw - turn / 2.0
    before = np.column_stack([x - distance * np.cos(chord), y - distance * np.sin(chord), yaw - turn])
    fits = floor.clearance(before[:, :2]) >= ROBOT_RADIUS - _MARGIN
    return camera_poses(poses[fits], CAMERA_AHEAD), camera_poses(before[fits], CAMERA_AHEAD)


def poses_around(places: F64, before: FloorMap, after: FloorMap, rng: np.random.Generator) -> F64:
    """Returns collision-free poses (N, 3) of a robot that faces one of some obstacles, in line of sight, world frame, metres and radians.

    Args:
        places: (K, 2), positions of the obstacles, world frame, metres.
        before: the map without them.
        after: the map with them.
        rng: of the poses.
    """
    goals = places[rng.integers(0, len(places), 4 * _VIEWS)]
    distance, angle = rng.uniform(*_DISTANCES, len(goals)), rng.uniform(-math.pi, math.pi, len(goals))
    x, y = (goals - distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)).T
    poses = np.column_stack([x, y, angle + rng.normal(0.0, _BEARING_DEVIATION, len(goals))])
    fits = np.flatnonzero(after.clearance(poses[:, :2]) >= ROBOT_RADIUS)
    seen = [k for k in fits if has_line_of_sight(before, poses[k], goals[k : k + 1])[0]]
    return poses[seen[:_VIEWS]]
