"""Observations as arrays of fixed shape and bounds, for learning. Pure except for the ray caster that is passed in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.tasks.episode import Episode, Observation, item_root

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Rays = Callable[[F64, F64, float], F64]
"""(origins (N, 3), directions (N, 3), range in metres) -> metres to the first hit (N,), +inf = none."""

FARTHEST = 20.0
"""Distance at which values are clipped, metres."""
BEAMS = 32
"""Beams of the horizontal scan, counter-clockwise from straight ahead."""
SCAN_RANGE, SCAN_HEIGHT = 5.0, 0.12
"""Range of the scan, and its height above the floor, metres."""
THINGS = 8
"""Number of nearest items in an observation."""
THING_RANGE = 5.0
"""Distance up to which items are included, metres."""
CLASSES = (
    "ball",
    "basket",
    "bin",
    "book",
    "bottle",
    "box",
    "chair",
    "table",
    "teapot",
    "vase",
    "cup",
    "can",
    "cabinet",
    "door",
    "bowl",
)
"""Semantic classes of goals and items, by index."""


@dataclass(frozen=True, slots=True)
class ObservationLayout:
    """Layout and bounds of the observation arrays; see docs/tasks.md."""

    joints: tuple[str, ...]
    """Joints of the arm, in order."""
    lower: tuple[float, ...]
    """Lower limits of the joints, radians or metres."""
    upper: tuple[float, ...]
    """Upper limits, likewise."""

    def own(self) -> tuple[F32, F32]:
        """Returns the bounds of ``own_state``, (N,) each."""
        low = [-FARTHEST, -FARTHEST, -1.0, -5.0, -10.0, *([0.0] * len(CLASSES)), *self.lower]
        high = [FARTHEST, FARTHEST, 1.0, 5.0, 10.0, *([1.0] * len(CLASSES)), *self.upper]
        if self.joints:
            low, high = [*low, 0.0], [*high, 1.0]
        low, high = [*low, -1.0, -1.0], [*high, 1.0, 1.0]
        return np.array(low, dtype=np.float32), np.array(high, dtype=np.float32)

    def state(self) -> tuple[F32, F32]:
        """Returns the bounds of ``full_state``, (N,) each."""
        low, high = self.own()
        row_low = np.array([0.0, -THING_RANGE, -THING_RANGE, -2.0, 0.0], dtype=np.float32)
        row_high = np.array([1.0, THING_RANGE, THING_RANGE, 2.0, len(CLASSES)], dtype=np.float32)
        one, scan = np.ones(2, dtype=np.float32), np.zeros(BEAMS, dtype=np.float32)
        return (
            np.concatenate([low, -one, scan, np.tile(row_low, THINGS)]),
            np.concatenate([high, one, scan + np.float32(SCAN_RANGE), np.tile(row_high, THINGS)]),
        )


def own_state(layout: ObservationLayout, episode: Episode, obs: Observation) -> F32:
    """Returns goal and proprioception: the goal in the base frame (forward, left, up; 0 if it has to be found), forward speed, yaw rate,
    one-hot class of the target, positions of the arm joints and whether the gripper holds something, and where the robot is touched.
    """
    goal = episode.goal
    there = (0.0, 0.0, 0.0)
    if goal.position is not None:
        there = (*obs.in_base(goal.position), goal.position[2] - obs.base.position[2])
    one_hot = [float(name == goal.target_class) for name in CLASSES]
    values = [*there, obs.linear, obs.angular, *one_hot, *(obs.joints[name] for name in layout.joints)]
    if layout.joints:
        values.append(float(bool(obs.held)))
    values += obs.touch
    return _clipped(values, *layout.own())


def full_state(
    layout: ObservationLayout, episode: Episode, obs: Observation, classes: Sequence[str], rays: Rays, way: tuple[float, float]
) -> F32:
    """Returns ``own_state``, where the shortest path leads (unit vector, forward and left; 0 = there is no path), the scan, and for each of
    the nearest items: 1, forward, left, up, class number (0 = none, else index + 1).

    Args:
        layout: of the arrays.
        episode: the episode.
        obs: the observation.
        classes: semantic class of each item.
        rays: casts the rays of the scan.
        way: where the shortest path leads: unit vector, world frame; zeros = there is no path.
    """
    cos, sin = math.cos(obs.yaw), math.sin(obs.yaw)
    ahead = np.array([cos * way[0] + sin * way[1], cos * way[1] - sin * way[0]])
    parts = [own_state(layout, episode, obs), ahead, _scan(obs, rays), _things(episode, obs, classes)]
    return _clipped(np.concatenate(parts), *layout.state())


def _scan(obs: Observation, rays: Rays) -> F64:
    angles = obs.yaw + np.arange(BEAMS) * 2.0 * math.pi / BEAMS
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)], axis=1)
    origin = np.array([*obs.xy, obs.base.position[2] + SCAN_HEIGHT])
    return np.minimum(rays(np.tile(origin, (BEAMS, 1)), directions, SCAN_RANGE), SCAN_RANGE)


def _things(episode: Episode, obs: Observation, classes: Sequence[str]) -> F64:
    rows: list[tuple[float, list[float]]] = []
    for item, name in zip(episode.items, classes, strict=True):
        place = obs.links[item_root(item)].position
        away = obs.distance_to(place)
        if away <= THING_RANGE:
            number = CLASSES.index(name) + 1.0 if name in CLASSES else 0.0
            rows.append((away, [1.0, *obs.in_base(place), place[2] - obs.base.position[2], number]))
    out = np.zeros((THINGS, 5))
    for k, (_, row) in enumerate(sorted(rows)[:THINGS]):
        out[k] = row
    return out.ravel()


def _clipped(values: Sequence[float] | NDArray[np.floating], low: F32, high: F32) -> F32:
    return np.clip(np.asarray(values, dtype=np.float32), low, high)
