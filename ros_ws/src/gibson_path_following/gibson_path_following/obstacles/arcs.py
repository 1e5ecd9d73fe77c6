"""Follows a local plan with circular arcs: drives towards a goal ahead, rotates in place where no arc is free, slows down before obstacles, stops.

Pure geometry in the robot frame: x forward, y to the left, metres and radians.
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
_MIN_LENGTH = 0.3
"""Length of the shortest arcs, metres."""
_AT_GOAL = 0.15
"""Distance to the goal within which the robot only rotates to the goal heading, metres."""
_ALIGNED = 0.2
"""Bearing of the goal beyond which a robot without a free arc rotates towards it, radians."""


@dataclass(frozen=True, slots=True)
class ArcSettings:
    """Limits of the robot, and weights of the cost of an arc."""

    max_linear: float = 0.5
    """Largest speed, m/s."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""
    robot_radius: float = 0.175
    """Radius of the robot, metres."""
    safety_margin: float = 0.01
    """Least distance between robot and obstacle, metres."""
    horizon: float = 1.0
    """Length of the longest arcs, metres."""
    max_curvature: float = 3.0
    """Largest curvature, 1/m."""
    arc_count: int = 41
    """Number of sampled arcs."""
    min_time_to_collision: float = 0.7
    """Least time in which the robot could reach the end of an arc's free length, seconds; it limits the speed."""
    min_free_length: float = 0.1
    """Free length of the best arc below which the robot does not drive, metres."""
    rotate_in_place_bearing: float = 1.2
    """Bearing of the goal beyond which the robot rotates in place, radians."""
    rotate_in_place_gain: float = 1.5
    """Yaw rate per radian of heading error while it rotates in place, 1/s."""
    heading_weight: float = 0.12
    """Cost of the heading error at the goal, m/rad."""
    obstacle_weight: float = 0.6
    """Cost of an arc without any free length, metres."""
    change_weight: float = 0.02
    """Cost of a change of curvature since the previous view, metres per 1/m."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("robot_radius", 0.0, 10.0),
            ("safety_margin", 0.0, 5.0),
            ("horizon", _MIN_LENGTH, 20.0),
            ("max_curvature", 0.1, 50.0),
            ("arc_count", 3, 1001),
            ("min_time_to_collision", 0.1, 20.0),
            ("min_free_length", 0.0, 5.0),
            ("rotate_in_place_bearing", 0.1, math.pi),
            ("rotate_in_place_gain", 0.0, 20.0),
            ("heading_weight", 0.0, 10.0),
            ("obstacle_weight", 0.0, 100.0),
            ("change_weight", 0.0, 10.0),
        )


class ArcPlanner:
    """Selects the arc of least cost for each view. It keeps the previous curvature, so that the robot does not oscillate."""

    def __init__(self, settings: ArcSettings | None = None) -> None:
        self.settings = settings or ArcSettings()
        self._curvatures: F64 = np.linspace(-1.0, 1.0, self.settings.arc_count) * self.settings.max_curvature
        """(arcs,), 1/m, positive to the left."""
        self._previous = 0.0
        """Curvature of the previous view, 1/m."""

    def reset(self) -> None:
        """Drops the previous curvature."""
        self._previous = 0.0

    def velocity(self, goal: tuple[float, float, float], clearance: Callable[[F64], F64]) -> Velocity:
        """Returns the velocity towards a goal.

        Args:
            goal: x, y and goal heading, robot frame, metres and radians.
            clearance: returns the distances (...,) from points (..., 2), robot frame, to the nearest obstacle, metres.
        """
        settings = self.settings
        x, y, yaw = goal
        goal_distance, bearing = math.hypot(x, y), math.atan2(y, x)
        if goal_distance < _AT_GOAL:
            return self._rotate_in_place(yaw)
        if abs(bearing) > settings.rotate_in_place_bearing:
            return self._rotate_in_place(bearing)
        length = min(max(goal_distance, _MIN_LENGTH), settings.horizon)
        arc_lengths: F64 = np.arange(1, math.ceil(length / _STEP) + 1, dtype=np.float64) * _STEP
        points, headings = arc_points(self._curvatures, arc_lengths)
        free = self.free_lengths(points, arc_lengths, clearance)
        is_reached = arc_lengths[None, :] <= np.maximum(free, _STEP)[:, None]
        distance = np.where(is_reached, np.hypot(points[..., 0] - x, points[..., 1] - y), np.inf)
        nearest = distance.argmin(axis=1)
        rows = np.arange(len(points))
        heading_error = np.abs((headings[rows, nearest] - yaw + math.pi) % (2.0 * math.pi) - math.pi)
        cost = (
            distance[rows, nearest]
            + settings.heading_weight * heading_error
            + settings.obstacle_weight * (1.0 - free / arc_lengths[-1])
            + settings.change_weight * np.abs(self._curvatures - self._previous)
        )
        best = int(cost.argmin())
        curvature, free_length = float(self._curvatures[best]), float(free[best])
        if free_length < settings.min_free_length:
            self._previous = 0.0
            return self._rotate_in_place(bearing) if abs(bearing) > _ALIGNED else STOP
        self._previous = curvature
        linear = min(
            settings.max_linear, free_length / settings.min_time_to_collision, settings.max_angular / max(abs(curvature), 1e-6)
        )
        return Velocity(linear, curvature * linear)

    def free_lengths(self, points: F64, arc_lengths: F64, clearance: Callable[[F64], F64]) -> F64:
        """Returns (arcs,), float64: free length of each arc up to its first collision, metres; at most the length of the arc.

        Args:
            points: (arcs, S, 2), points of the arcs, robot frame, metres.
            arc_lengths: (S,), arc length from the robot to each point, metres.
            clearance: as of ``velocity``.
        """
        required = self.settings.robot_radius + self.settings.safety_margin
        # An obstacle that is too near already blocks only the arcs that come nearer to it.
        required = min(required, float(clearance(np.zeros(2))) - 0.01)
        collides = clearance(points) < required  # (arcs, S)
        first = arc_lengths[collides.argmax(axis=1)] - _STEP
        return np.asarray(np.where(collides.any(axis=1), first, arc_lengths[-1]), dtype=np.float64)

    def _rotate_in_place(self, angle: float) -> Velocity:
        """Returns the rotation in place towards a heading error, radians."""
        limit = self.settings.max_angular
        return Velocity(0.0, min(max(self.settings.rotate_in_place_gain * angle, -limit), limit))


def arc_points(curvatures: F64, arc_lengths: F64) -> tuple[F64, F64]:
    """Returns points (arcs, S, 2), metres, and headings (arcs, S), radians, of arcs that begin at the robot along its x axis, robot frame.

    Args:
        curvatures: (arcs,), 1/m, positive to the left.
        arc_lengths: (S,), metres.
    """
    turn = curvatures[:, None] * arc_lengths
    # sin(a)/a and (1 - cos(a))/a, which are smooth through 0.
    half = 0.5 * turn
    chord = np.sinc(half / math.pi) * arc_lengths
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=-1), turn
