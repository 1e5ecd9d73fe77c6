"""Observations as arrays of fixed shape and bounds, for learning. Pure; a callable casts rays."""

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
"""(origins (N, 3), directions (N, 3), range in metres) -> distances to the first hit (N,), metres, +inf = no hit."""

FARTHEST = 20.0
"""Distance at which values are clipped, metres."""
BEAMS = 32
"""Number of beams of the horizontal scan, counter-clockwise from straight ahead."""
SCAN_RANGE, SCAN_HEIGHT = 5.0, 0.12
"""Range of the scan, and its height above the floor, metres."""
THINGS = 8
"""Number of items in an observation, the nearest ones."""
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
    """Upper limits of the joints, radians or metres."""

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
    """Returns goal and proprioception: the goal in the base frame (forward, left, up; 0 if unknown), forward speed, yaw rate, one-hot class
    of the target, positions of the arm joints and whether the gripper holds an object, and the direction of lateral contacts.
    """
    goal = episode.goal
    goal_in_base = (0.0, 0.0, 0.0)
    if goal.position is not None:
        goal_in_base = (*obs.in_base(goal.position), goal.position[2] - obs.base.position[2])
    one_hot = [float(name == goal.target_class) for name in CLASSES]
    values = [*goal_in_base, obs.linear, obs.angular, *one_hot, *(obs.joints[name] for name in layout.joints)]
    if layout.joints:
        values.append(float(bool(obs.held)))
    values += obs.touch
    return _clipped(values, *layout.own())


def full_state(
    layout: ObservationLayout,
    episode: Episode,
    obs: Observation,
    classes: Sequence[str],
    rays: Rays,
    direction: tuple[float, float],
) -> F32:
    """Returns ``own_state``, the direction of the shortest path (unit vector, forward and left; 0 = no path), the scan, and for each of the
    nearest items: 1, forward, left, up, class number (0 = none, else index + 1).

    Args:
        layout: layout of the arrays.
        episode: the episode.
        obs: the observation.
        classes: semantic class of each item.
        rays: casts the rays of the scan.
        direction: direction of the shortest path: unit vector, world frame; zeros = no path.
    """
    cos, sin = math.cos(obs.yaw), math.sin(obs.yaw)
    in_base = np.array([cos * direction[0] + sin * direction[1], cos * direction[1] - sin * direction[0]])
    parts = [own_state(layout, episode, obs), in_base, _scan(obs, rays), _items(episode, obs, classes)]
    return _clipped(np.concatenate(parts), *layout.state())


def _scan(obs: Observation, rays: Rays) -> F64:
    angles = obs.yaw + np.arange(BEAMS) * 2.0 * math.pi / BEAMS
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)], axis=1)
    origin = np.array([*obs.xy, obs.base.position[2] + SCAN_HEIGHT])
    return np.minimum(rays(np.tile(origin, (BEAMS, 1)), directions, SCAN_RANGE), SCAN_RANGE)


def _items(episode: Episode, obs: Observation, classes: Sequence[str]) -> F64:
    rows: list[tuple[float, list[float]]] = []
    for item, name in zip(episode.items, classes, strict=True):
        position = obs.links[item_root(item)].position
        distance = obs.distance_to(position)
        if distance <= THING_RANGE:
            number = CLASSES.index(name) + 1.0 if name in CLASSES else 0.0
            rows.append((distance, [1.0, *obs.in_base(position), position[2] - obs.base.position[2], number]))
    out = np.zeros((THINGS, 5))
    for k, (_, row) in enumerate(sorted(rows)[:THINGS]):
        out[k] = row
    return out.ravel()


def _clipped(values: Sequence[float] | NDArray[np.floating], low: F32, high: F32) -> F32:
    return np.clip(np.asarray(values, dtype=np.float32), low, high)
