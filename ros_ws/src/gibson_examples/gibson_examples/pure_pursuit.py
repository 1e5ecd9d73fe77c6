"""Regulated pure pursuit for a robot that turns in place. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, Pose2D, wrap_angle
from gibson_examples.planner import SPACING


@dataclass(frozen=True, slots=True)
class Velocity:
    """Commanded velocity of the base, in its own frame."""

    linear: float
    """m/s, forward."""
    angular: float
    """rad/s, counter-clockwise."""


STOP = Velocity(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PursuitSettings:
    """Speeds, and the distances that regulate them."""

    max_linear: float = 0.45
    """m/s."""
    max_angular: float = 1.2
    """rad/s."""
    min_linear: float = 0.06
    """m/s; keeps the robot from slowing down for ever before the goal."""
    acceleration: float = 0.6
    """Largest increase of the speed, m/s^2."""
    approach_s: float = 0.8
    """Time constant of the approach, seconds: the speed near the end is the remaining distance divided by it. Late commands do little harm."""
    lookahead_s: float = 0.9
    """Lookahead time, seconds."""
    min_lookahead: float = 0.22
    """Smallest lookahead distance, metres."""
    turn_from: float = math.radians(60.0)
    """Heading error from which the robot turns in place, radians."""
    turn_until: float = math.radians(10.0)
    """Heading error down to which it turns in place, radians."""
    turn_gain: float = 2.0
    """Yaw rate per heading error, 1/s."""
    max_lateral_acceleration: float = 0.4
    """m/s^2; limits the speed in bends."""
    slow_within: float = 0.3
    """Clearance from the robot's rim below which it slows down, metres."""
    slowest_share: float = 0.35
    """Factor of the speed at clearance 0."""

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "acceleration", "min_lookahead", "turn_gain", "slow_within"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingError(f"{name} is {getattr(self, name):g}, must be a finite number above 0")


class PurePursuit:
    """Follows one path: aims at a point ahead on it, slows down in bends, near obstacles and near the end, turns in place to start."""

    def __init__(self, path: F64, settings: PursuitSettings | None = None, speed: float = 0.0) -> None:
        """Starts on a path (N, 2), metres, N >= 2, with points about ``SPACING`` apart, at the robot's present speed, m/s."""
        self.path = path
        self._settings = settings or PursuitSettings()
        self._at = 0
        self._speed = max(speed, 0.0)
        self._turning = False

    @property
    def ahead(self) -> F64:
        """The part of the path that is not behind the robot, (N, 2)."""
        return self.path[self._at :]

    @property
    def speed(self) -> float:
        """Last commanded forward speed, m/s."""
        return self._speed

    def deviation(self, pose: Pose2D) -> float:
        """Returns the distance of the robot from its position on the path, metres."""
        return math.hypot(*(self.path[self._at] - (pose.x, pose.y)))

    def command(self, pose: Pose2D, clearance: float, dt: float) -> Velocity:
        """Returns the next velocity.

        Args:
            pose: the robot's, in the frame of the path.
            clearance: metres from the robot's rim to the nearest obstacle.
            dt: seconds since the last command.
        """
        s = self._settings
        self._advance(pose)
        aim = self._aim(max(s.min_lookahead, self._speed * s.lookahead_s))
        dx, dy = float(aim[0]) - pose.x, float(aim[1]) - pose.y
        error, distance = wrap_angle(math.atan2(dy, dx) - pose.yaw), max(math.hypot(dx, dy), 0.02)
        self._turning = abs(error) > (s.turn_until if self._turning else s.turn_from)
        if self._turning:
            self._speed = 0.0
            return Velocity(0.0, _limit(s.turn_gain * error, s.max_angular))
        curvature = 2.0 * math.sin(error) / distance
        self._speed = min(self._regulated(curvature, clearance, pose), self._speed + s.acceleration * dt)
        return Velocity(self._speed, _limit(self._speed * curvature, s.max_angular))

    def turn_to(self, yaw: float, pose: Pose2D) -> Velocity:
        """Returns the command that turns in place towards a heading, radians."""
        self._speed = 0.0
        return Velocity(0.0, _limit(self._settings.turn_gain * wrap_angle(yaw - pose.yaw), self._settings.max_angular))

    def limit(self, linear: float) -> None:
        """Records that the caller has limited the speed to ``linear``, m/s."""
        self._speed = min(self._speed, max(linear, 0.0))

    def _regulated(self, curvature: float, clearance: float, pose: Pose2D) -> float:
        """Returns the speed that bends, obstacles and the end of the path allow, m/s."""
        s = self._settings
        speed = s.max_linear
        if abs(curvature) > 1e-6:
            # Half of the yaw rate stays in reserve for corrections.
            speed = min(speed, math.sqrt(s.max_lateral_acceleration / abs(curvature)), 0.5 * s.max_angular / abs(curvature))
        near = min(max(clearance / s.slow_within, 0.0), 1.0)
        speed *= s.slowest_share + (1.0 - s.slowest_share) * near
        remaining = math.hypot(*(self.path[-1] - (pose.x, pose.y)))
        return max(min(speed, remaining / s.approach_s), s.min_linear)

    def _advance(self, pose: Pose2D) -> None:
        """Moves the position on the path to the nearest point of the next 1.5 metres."""
        window = self.path[self._at : self._at + round(1.5 / SPACING)]
        offsets = window - (pose.x, pose.y)
        self._at += int(np.argmin((offsets * offsets).sum(axis=1)))

    def _aim(self, distance: float) -> F64:
        """Returns the point of the path ``distance`` metres ahead; at most its end."""
        return np.asarray(self.path[min(self._at + max(1, round(distance / SPACING)), len(self.path) - 1)])


def arc(pose: Pose2D, velocity: Velocity, seconds: float, count: int) -> F64:
    """Returns ``count`` points (N, 2) of the arc that a constant velocity drives in ``seconds``, without its start."""
    t = np.linspace(seconds / count, seconds, count)
    half = velocity.angular * t / 2
    chord = velocity.linear * t * np.sinc(half / math.pi)
    return np.column_stack([pose.x + chord * np.cos(pose.yaw + half), pose.y + chord * np.sin(pose.yaw + half)])


def _limit(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
