"""Follows a way over arcs: goes for a place ahead, turns to it in place where no arc is free, slows down before what is near, and stops.

Pure geometry in the frame of the robot: x ahead, y to the left, metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.types import STOP, Velocity

F64 = NDArray[np.float64]
_STEP = 0.05
"""Distance between the points of an arc, metres."""
_SHORTEST = 0.3
"""Length of the shortest arcs, metres."""

_LOOK = 0.2
"""Bearing of the goal beyond which a robot whose arcs are all blocked turns to it, radians."""


@dataclass(frozen=True, slots=True)
class ArcSettings:
    """The robot, its limits, and how it chooses."""

    max_linear: float = 0.5
    """Largest speed, m/s."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""
    radius: float = 0.175
    """Of the robot, metres."""
    margin: float = 0.01
    """Free space beyond the radius, metres."""
    horizon: float = 1.0
    """Length of the longest arcs, metres."""
    max_curvature: float = 3.0
    """1/metres."""
    arcs: int = 41
    """Number of arcs that are compared."""
    braking: float = 0.7
    """Time in which the robot could drive to the end of what is free, seconds: less free space, less speed."""
    least_clear: float = 0.1
    """Free length of the best arc below which the robot does not drive, metres."""
    turn_bearing: float = 1.2
    """Bearing of the goal beyond which the robot turns in place, radians."""
    turn_gain: float = 1.5
    """Yaw rate per radian while it turns in place, 1/s."""
    yaw_weight: float = 0.12
    """Cost of a radian of heading error at the goal, metres."""
    blocked_weight: float = 0.6
    """Cost of an arc that is not free at all, metres."""
    change_weight: float = 0.02
    """Cost of another curvature than before, metres per 1/metre."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("radius", 0.0, 10.0),
            ("margin", 0.0, 5.0),
            ("horizon", _SHORTEST, 20.0),
            ("max_curvature", 0.1, 50.0),
            ("arcs", 3, 1001),
            ("braking", 0.1, 20.0),
            ("least_clear", 0.0, 5.0),
            ("turn_bearing", 0.1, math.pi),
            ("turn_gain", 0.0, 20.0),
            ("yaw_weight", 0.0, 10.0),
            ("blocked_weight", 0.0, 100.0),
            ("change_weight", 0.0, 10.0),
        )


class ArcPlanner:
    """Chooses an arc for each view. It remembers the arc before, so that it does not sway."""

    def __init__(self, settings: ArcSettings | None = None) -> None:
        self.settings = settings or ArcSettings()
        self._curvatures: F64 = np.linspace(-1.0, 1.0, self.settings.arcs) * self.settings.max_curvature
        self._before = 0.0

    def reset(self) -> None:
        """Forgets the arc before."""
        self._before = 0.0

    def velocity(self, goal: tuple[float, float, float], clearance: Callable[[F64], F64]) -> Velocity:
        """Returns the velocity towards a goal.

        Args:
            goal: x, y, yaw.
            clearance: returns distances (...,) from points (..., 2) to the nearest thing that the robot must not touch, metres.
        """
        settings = self.settings
        x, y, yaw = goal
        away, bearing = math.hypot(x, y), math.atan2(y, x)
        if away < 0.15:
            return self._turned(yaw)
        if abs(bearing) > settings.turn_bearing:
            return self._turned(bearing)
        length = min(max(away, _SHORTEST), settings.horizon)
        along: F64 = np.arange(1, math.ceil(length / _STEP) + 1, dtype=np.float64) * _STEP
        points, headings = arc_points(self._curvatures, along)
        clear = self.clear_lengths(points, along, clearance)
        reached = along[None, :] <= np.maximum(clear, _STEP)[:, None]
        distance = np.where(reached, np.hypot(points[..., 0] - x, points[..., 1] - y), np.inf)
        nearest = distance.argmin(axis=1)
        rows = np.arange(len(points))
        turn = np.abs((headings[rows, nearest] - yaw + math.pi) % (2.0 * math.pi) - math.pi)
        cost = (
            distance[rows, nearest]
            + settings.yaw_weight * turn
            + settings.blocked_weight * (1.0 - clear / along[-1])
            + settings.change_weight * np.abs(self._curvatures - self._before)
        )
        best = int(cost.argmin())
        curvature, free = float(self._curvatures[best]), float(clear[best])
        if free < settings.least_clear:
            self._before = 0.0
            return self._turned(bearing) if abs(bearing) > _LOOK else STOP
        self._before = curvature
        linear = min(settings.max_linear, free / settings.braking, settings.max_angular / max(abs(curvature), 1e-6))
        return Velocity(linear, curvature * linear)

    def clear_lengths(self, points: F64, along: F64, clearance: Callable[[F64], F64]) -> F64:
        """Returns (arcs,): how far the robot can follow each arc, metres, at most its length.

        Args:
            points: (arcs, S, 2), the points of the arcs.
            along: (S,), their distances from the start.
            clearance: as ``velocity`` takes it.
        """
        room = self.settings.radius + self.settings.margin
        # What is too near already stops only arcs that come nearer to it.
        least = min(room, float(clearance(np.zeros(2))) - 0.01)
        hits = clearance(points) < least  # (arcs, S)
        return np.asarray(np.where(hits.any(axis=1), along[hits.argmax(axis=1)] - _STEP, along[-1]), dtype=np.float64)

    def _turned(self, angle: float) -> Velocity:
        limit = self.settings.max_angular
        return Velocity(0.0, min(max(self.settings.turn_gain * angle, -limit), limit))


def arc_points(curvatures: F64, along: F64) -> tuple[F64, F64]:
    """Returns points (arcs, S, 2) and headings (arcs, S) of arcs that begin ahead, at distances ``along`` (S,), metres."""
    turn = curvatures[:, None] * along
    # sin(a)/a and (1 - cos(a))/a, which are smooth through 0.
    half = 0.5 * turn
    chord = np.sinc(half / math.pi) * along
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=-1), turn
