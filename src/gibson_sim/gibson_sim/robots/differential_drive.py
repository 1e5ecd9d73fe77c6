"""Kinematics of two driven wheels on one axle: pure arithmetic, SI units.

Wheel speeds are positive when the wheel rolls forward, whatever the sign of its joint's axis in the URDF.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from gibson_sim.geometry.transforms import wrap_angle
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.types import Odometry, VelocityCommand


class PlanarVelocity(NamedTuple):
    """Velocity of the base in its own frame."""

    linear: float = 0.0
    """Forward, m/s."""
    angular: float = 0.0
    """Counter-clockwise, rad/s."""


def wheel_speeds(linear: float, angular: float, drive: DriveSpec) -> tuple[float, float]:
    """Returns the speeds (left, right), rad/s, that move the base at ``linear`` (m/s) and ``angular`` (rad/s)."""
    half = drive.wheel_separation / 2
    return (linear - angular * half) / drive.wheel_radius, (linear + angular * half) / drive.wheel_radius


def body_velocity(left: float, right: float, drive: DriveSpec) -> PlanarVelocity:
    """Returns the base's velocity for wheels that roll without slip at ``left`` and ``right``, rad/s."""
    return PlanarVelocity(
        drive.wheel_radius * (left + right) / 2,
        drive.wheel_radius * (right - left) / drive.wheel_separation,
    )


def limit_velocity(current: PlanarVelocity, wanted: PlanarVelocity, limits: DriveSpec, dt: float) -> PlanarVelocity:
    """Returns the velocity to command next: towards ``wanted`` from ``current``, within the drive's speeds and accelerations.

    Args:
        current: Velocity commanded in the step before.
        wanted: Velocity asked for; not altered.
        limits: Speeds and accelerations.
        dt: Seconds between the two.
    """
    return PlanarVelocity(
        _approach(current.linear, wanted.linear, limits.max_linear, limits.max_linear_acceleration * dt),
        _approach(current.angular, wanted.angular, limits.max_angular, limits.max_angular_acceleration * dt),
    )


def active_command(command: VelocityCommand | None, now_ns: int, timeout_ns: int) -> PlanarVelocity:
    """Returns what to obey at ``now_ns``: the command's velocity, or zero where it is None or older than ``timeout_ns``."""
    if command is None or now_ns - command.stamp_ns > timeout_ns:
        return PlanarVelocity()
    return PlanarVelocity(command.linear[0], command.angular[2])


class WheelOdometry:
    """Dead reckoning from wheel angles: a wheel that slips deceives it, as on a real robot."""

    def __init__(self, drive: DriveSpec) -> None:
        self._drive = drive
        self.reset()

    def reset(self) -> None:
        """Puts the base at the origin of the odom frame, at rest."""
        self._x = self._y = self._yaw = 0.0
        self._velocity = PlanarVelocity()

    def update(self, left_increment: float, right_increment: float, dt: float) -> None:
        """Adds one circular arc.

        Args:
            left_increment: Radians that the left wheel rolled forward.
            right_increment: Radians that the right wheel rolled forward.
            dt: Seconds that it took, above 0.
        """
        arc, turn = body_velocity(left_increment, right_increment, self._drive)
        half = turn / 2
        # The chord of an arc; the series keeps full precision where sin(x)/x would be 0/0.
        chord = arc * (math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6.0)
        self._x += chord * math.cos(self._yaw + half)
        self._y += chord * math.sin(self._yaw + half)
        self._yaw += turn
        self._velocity = PlanarVelocity(arc / dt, turn / dt)

    @property
    def odometry(self) -> Odometry:
        """Where the wheels say that the base is."""
        return Odometry(self._x, self._y, wrap_angle(self._yaw), self._velocity.linear, self._velocity.angular)


def _approach(current: float, wanted: float, limit: float, change: float) -> float:
    """Returns ``wanted`` clipped to +-``limit``, at most ``change`` away from ``current``."""
    target = min(max(wanted, -limit), limit)
    return min(max(target, current - change), current + change)
