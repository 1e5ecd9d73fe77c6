"""Following a path: regulated pure pursuit for a robot that turns in place. Knows no ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, Pose2D, wrap_angle
from gibson_examples.planner import SPACING


@dataclass(frozen=True, slots=True)
class Velocity:
    """What the base is asked to do, in its own frame."""

    linear: float
    """m/s, forward."""
    angular: float
    """rad/s, counter-clockwise."""


STOP = Velocity(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PursuitSettings:
    """How fast, and how closely to the path."""

    max_linear: float = 0.45
    """m/s."""
    max_angular: float = 1.2
    """rad/s."""
    min_linear: float = 0.06
    """m/s: slower than this it would never arrive."""
    acceleration: float = 0.6
    """m/s^2, speeding up."""
    approach_s: float = 0.8
    """Towards the end its speed is the way that is left in so many seconds: a command that takes effect late does little harm."""
    lookahead_s: float = 0.9
    """The point aimed at is so many seconds ahead, ..."""
    min_lookahead: float = 0.22
    """... but at least so many metres."""
    turn_from: float = math.radians(60.0)
    """From this error of the heading on the robot turns in place, ..."""
    turn_until: float = math.radians(10.0)
    """... and until this one. Radians."""
    turn_gain: float = 2.0
    """Yaw rate per error, 1/s."""
    max_lateral_acceleration: float = 0.4
    """m/s^2: bends are taken more slowly."""
    slow_within: float = 0.3
    """Where obstacles are nearer than this to the robot's rim it slows down, metres, ..."""
    slowest_share: float = 0.35
    """... to this share of its speed at the obstacle."""

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "acceleration", "min_lookahead", "turn_gain", "slow_within"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingError(f"{name} is {getattr(self, name):g}, must be a finite number above 0")


class PurePursuit:
    """Follows one path: aims at a point ahead on it; slows in bends, near obstacles and near the end; turns in place to start."""

    def __init__(self, path: F64, settings: PursuitSettings | None = None, speed: float = 0.0) -> None:
        """Takes a path (N, 2), metres, N >= 2, points about ``SPACING`` apart, and the robot's present speed, m/s."""
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
        """The forward speed last asked for, m/s."""
        return self._speed

    def deviation(self, pose: Pose2D) -> float:
        """Returns the distance of the robot from its place on the path, metres."""
        return math.hypot(*(self.path[self._at] - (pose.x, pose.y)))

    def command(self, pose: Pose2D, clearance: float, dt: float) -> Velocity:
        """Returns what to do now.

        Args:
            pose: of the robot, in the frame of the path.
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
        """Notes that somebody else has slowed the robot to so many m/s."""
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
        left = math.hypot(*(self.path[-1] - (pose.x, pose.y)))
        return max(min(speed, left / s.approach_s), s.min_linear)

    def _advance(self, pose: Pose2D) -> None:
        """Moves the place on the path to the nearest point of the next 1.5 metres."""
        window = self.path[self._at : self._at + round(1.5 / SPACING)]
        offsets = window - (pose.x, pose.y)
        self._at += int(np.argmin((offsets * offsets).sum(axis=1)))

    def _aim(self, distance: float) -> F64:
        """Returns the point of the path so many metres on; beyond the end, the end."""
        return np.asarray(self.path[min(self._at + max(1, round(distance / SPACING)), len(self.path) - 1)])


def arc(pose: Pose2D, velocity: Velocity, seconds: float, count: int) -> F64:
    """Returns ``count`` points (N, 2) of the way that a constant velocity takes in so many seconds, without the first."""
    t = np.linspace(seconds / count, seconds, count)
    half = velocity.angular * t / 2
    chord = velocity.linear * t * np.sinc(half / math.pi)
    return np.column_stack([pose.x + chord * np.cos(pose.yaw + half), pose.y + chord * np.sin(pose.yaw + half)])


def _limit(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
