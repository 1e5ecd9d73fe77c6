"""Views as arrays of a fixed shape and with bounds: what learning takes in. Pure but for the rays that are given."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.tasks.episode import Episode, View, item_root

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Rays = Callable[[F64, F64, float], F64]
"""(origins (N, 3), directions (N, 3), longest in metres) -> metres to the first hit (N,), +inf = nothing."""

FARTHEST = 20.0
"""Metres: distances are clipped here."""
BEAMS = 32
"""Of the level scan, counter-clockwise from straight ahead."""
SCAN_RANGE, SCAN_HEIGHT = 5.0, 0.12
"""Metres: reach of the scan, and its height above the floor."""
THINGS = 8
"""Nearest items that are told."""
THING_RANGE = 5.0
"""Metres: farther ones are not told."""
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
"""Semantic classes that goals and items are told by: one number each."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What stands where in the array, and between which bounds; see docs/tasks.md."""

    joints: tuple[str, ...]
    """Of the arm, in their order."""
    lower: tuple[float, ...]
    """Of the joints, radians or metres."""
    upper: tuple[float, ...]

    def own(self) -> tuple[F32, F32]:
        """Returns the bounds of what the robot feels of itself, and of its goal: (N,) each."""
        low = [-FARTHEST, -FARTHEST, -1.0, -5.0, -10.0, *([0.0] * len(CLASSES)), *self.lower]
        high = [FARTHEST, FARTHEST, 1.0, 5.0, 10.0, *([1.0] * len(CLASSES)), *self.upper]
        if self.joints:
            low, high = [*low, 0.0], [*high, 1.0]
        return np.array(low, dtype=np.float32), np.array(high, dtype=np.float32)

    def state(self) -> tuple[F32, F32]:
        """Returns the bounds of all: what it feels, the scan, and the nearest items."""
        low, high = self.own()
        row_low = np.array([0.0, -THING_RANGE, -THING_RANGE, -2.0, 0.0], dtype=np.float32)
        row_high = np.array([1.0, THING_RANGE, THING_RANGE, 2.0, len(CLASSES)], dtype=np.float32)
        scan = np.zeros(BEAMS, dtype=np.float32)
        return (
            np.concatenate([low, scan, np.tile(row_low, THINGS)]),
            np.concatenate([high, scan + np.float32(SCAN_RANGE), np.tile(row_high, THINGS)]),
        )


def own_state(layout: Layout, episode: Episode, view: View) -> F32:
    """Returns the goal in the frame of the base (forward, left, height; 0 where it has to be found), forward speed and yaw rate, the
    class that is asked for, the joints of the arm, and whether the hand holds something.
    """
    goal = episode.goal
    there = (0.0, 0.0, 0.0)
    if goal.position is not None:
        there = (*view.in_base(goal.position), goal.position[2] - view.base.position[2])
    asked = [float(name == goal.target_class) for name in CLASSES]
    values = [*there, view.linear, view.angular, *asked, *(view.joints[name] for name in layout.joints)]
    if layout.joints:
        values.append(float(bool(view.held)))
    return _clipped(values, *layout.own())


def full_state(layout: Layout, episode: Episode, view: View, classes: Sequence[str], rays: Rays) -> F32:
    """Returns ``own_state``, the scan, and for each of the nearest items: 1, forward, left, height, number of its class.

    Args:
        layout: of the arrays.
        episode: whose items.
        view: what is known.
        classes: semantic class of each item.
        rays: what the scan is measured by.
    """
    return _clipped(
        np.concatenate([own_state(layout, episode, view), _scan(view, rays), _things(episode, view, classes)]), *layout.state()
    )


def _scan(view: View, rays: Rays) -> F64:
    angles = view.yaw + np.arange(BEAMS) * 2.0 * math.pi / BEAMS
    directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)], axis=1)
    origin = np.array([*view.xy, view.base.position[2] + SCAN_HEIGHT])
    return np.minimum(rays(np.tile(origin, (BEAMS, 1)), directions, SCAN_RANGE), SCAN_RANGE)


def _things(episode: Episode, view: View, classes: Sequence[str]) -> F64:
    rows: list[tuple[float, list[float]]] = []
    for item, name in zip(episode.items, classes, strict=True):
        place = view.links[item_root(item)].position
        away = view.distance_to(place)
        if away <= THING_RANGE:
            number = CLASSES.index(name) + 1.0 if name in CLASSES else 0.0
            rows.append((away, [1.0, *view.in_base(place), place[2] - view.base.position[2], number]))
    out = np.zeros((THINGS, 5))
    for k, (_, row) in enumerate(sorted(rows)[:THINGS]):
        out[k] = row
    return out.ravel()


def _clipped(values: Sequence[float] | NDArray[np.floating], low: F32, high: F32) -> F32:
    return np.clip(np.asarray(values, dtype=np.float32), low, high)
