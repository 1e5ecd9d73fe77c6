"""DAgger: drives with the present network in the training scenes, in lockstep, and labels its images by ground truth.

The images of a follower depend on how it drives. Shards of its own drives have the same format as those of ``data.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.types import RecordedPath
from gibson_sim.errors import SceneError
from gibson_sim_learn.path_following.cases import draw_cases
from gibson_sim_learn.path_following.clutter import random_object
from gibson_sim_learn.path_following.data import (
    Shard,
    World,
    camera_poses,
    column_bearings,
    free_distances,
    make_pairs,
    path_row,
    save_shard,
    with_bodies,
)
from gibson_sim_learn.path_following.domains import TRAINED, Conditions, draw
from gibson_sim_learn.path_following.drawing import HFOV
from gibson_sim_learn.path_following.drives import Driver, PathSite, Recording, Trace, follow, record
from gibson_sim_learn.remaining import Remaining

F64 = NDArray[np.float64]
LENGTHS = (5.0, 7.0, 9.0, 11.0)
"""Lengths of the paths of successive drives, metres."""
_MOVED, _TURNED = 0.03, math.radians(3.0)
"""Distance, metres, and turn, radians, since the previous kept view from which on a view is kept."""
_DOMAIN = replace(TRAINED, obstacles=(0, 2))
"""Domain of training, with obstacles on the path."""

DriverOf = Callable[[RecordedPath], Driver]
"""Returns the driver of a path."""


def drive_all(
    folder: Path,
    scenes: Sequence[str],
    drives: int,
    seed: int,
    driver_of: DriverOf,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Makes the missing shards of one round, one for each drive.

    Args:
        folder: folder of the shards.
        scenes: names of the scenes.
        drives: drives in each.
        seed: of paths and conditions; another one for each round.
        driver_of: returns the driver of a path: a follower with the network.
        progress: called after each drive with one line on it.
    """
    total = drives * len(scenes)
    done = sum((folder / f"{scene}-{number:03d}").is_dir() for scene in scenes for number in range(drives))
    remaining = Remaining(done)
    for scene in scenes:
        names = [folder / f"{scene}-{number:03d}" for number in range(drives)]
        if all(name.is_dir() for name in names):
            continue
        world = World.load(scene)
        with PathSite(scene) as site:
            for number, name in enumerate(names):
                if name.is_dir():
                    continue
                length = LENGTHS[number % len(LENGTHS)]
                conditions = draw(_DOMAIN, np.random.default_rng([seed, number]))
                try:
                    # Each path has a seed of its own: a small home has no room for a second long one among those of one seed.
                    recording = record(site, draw_cases(site.ground, scene, length, 1, 1000 * seed + number)[0])
                    trace = _drive(site, recording, driver_of(recording.path), conditions, number)
                except SceneError as error:  # no room for such a path, or the robot cannot be put on it
                    done += 1
                    progress(f"drive {done} of {total}, {name.name}: {error}")
                    continue
                save_shard(name, drive_shard(world, site, recording, trace, conditions, seed))
                done += 1
                result = f"{trace.ended}, coverage {trace.outcome(recording).coverage:.2f}"
                progress(f"drive {done} of {total}, {name.name}: {result}{remaining.text(done, total)}")


def _drive(site: PathSite, recording: Recording, driver: Driver, conditions: Conditions, seed: int) -> Trace:
    # Added objects are random, not the models of table 2.
    return follow(site, recording, lambda _: driver, conditions, seed, make_item=random_object, keep_views=True)


def drive_shard(world: World, site: PathSite, recording: Recording, trace: Trace, conditions: Conditions, seed: int) -> Shard:
    """Returns the images of a drive with their ground truth.

    Args:
        world: the scene and its maps.
        site: the scene with its robot.
        recording: the path.
        trace: the drive, with its images.
        conditions: of the drive.
        seed: of the choice of pairs of different places.
    """
    kept = keyframe_ticks(np.array([tick.pose for tick in trace.ticks]))
    nodes = np.array(recording.poses)
    later = np.array([trace.ticks[k].pose for k in kept])
    rows = [path_row(node.distance) for node in recording.path.nodes]
    nearest = np.linalg.norm(later[:, None, :2] - nodes[None, :, :2], axis=2).argmin(axis=1)
    ahead = site.rig.camera_ahead
    before, after = camera_poses(nodes, ahead), camera_poses(later, ahead)
    scene = world.scene
    floor = world.floor
    if trace.layout is not None:
        floor = with_bodies(scene, world.bare, trace.layout.bodies)
    bearings = column_bearings(HFOV), column_bearings(HFOV + conditions.hfov_change)
    free = [free_distances(world.floor, before, bearings[0]), free_distances(floor, after, bearings[1])]
    pairs = make_pairs(
        after,
        [(0, rows[node]) for node in nearest],
        before,
        [(0, row) for row in rows],
        floor,
        np.random.default_rng(seed),
    )
    pairs["later"] += len(before)
    images = [node.view[0] for node in recording.path.nodes] + [trace.views[k][0] for k in kept]
    return Shard(np.stack(images), np.concatenate(free).astype(np.float32), pairs)


def keyframe_ticks(poses: F64) -> list[int]:
    """Returns the rows of poses (N, 3) at which the robot has moved or turned enough since the previous keyframe."""
    kept = [0]
    for k, pose in enumerate(poses):
        last = poses[kept[-1]]
        turned = abs((pose[2] - last[2] + math.pi) % (2.0 * math.pi) - math.pi)
        if math.dist(pose[:2], last[:2]) >= _MOVED or turned >= _TURNED:
            kept.append(k)
    return kept
