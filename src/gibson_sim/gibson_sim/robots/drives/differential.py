"""Kinematics of differential drive and skid steer. Pure arithmetic, SI units.

Wheel speeds are positive if the wheel rolls forward, regardless of the sign of the joint axis in the URDF.
"""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.drives.base import (
    BaseServo,
    Drive,
    DriveJoint,
    DriveTargets,
    PlanarVelocity,
    Response,
    limit_velocity_change,
)


def wheel_speeds(linear: float, angular: float, drive: DifferentialSpec) -> tuple[float, float]:
    """Returns the speeds (left, right), rad/s, that move the base at ``linear`` (m/s) and ``angular`` (rad/s)."""
    half = drive.wheel_separation / 2
    return (linear - angular * half) / drive.wheel_radius, (linear + angular * half) / drive.wheel_radius


def body_velocity(left: float, right: float, drive: DifferentialSpec) -> PlanarVelocity:
    """Returns the base's velocity for wheels that roll without slip at ``left`` and ``right``, rad/s."""
    return PlanarVelocity(
        linear=drive.wheel_radius * (left + right) / 2,
        angular=drive.wheel_radius * (right - left) / drive.wheel_separation,
    )


def limit_velocity(current: PlanarVelocity, commanded: PlanarVelocity, limits: DifferentialSpec, dt: float) -> PlanarVelocity:
    """Returns the velocity to command next: towards ``commanded`` from ``current``, within the drive's speeds and accelerations.

    Args:
        current: Velocity commanded in the previous step.
        commanded: Commanded velocity; its ``lateral`` is ignored, since these wheels do not roll sideways.
        limits: Speeds and accelerations.
        dt: Time between the two, s.
    """
    linear = limit_velocity_change(current.linear, commanded.linear, limits.max_linear, limits.max_linear_acceleration * dt)
    angular = limit_velocity_change(current.angular, commanded.angular, limits.max_angular, limits.max_angular_acceleration * dt)
    return PlanarVelocity(linear, 0.0, angular)


class DifferentialDrive(Drive):
    """Differential drive or skid steer. Wheels are ordered left, right, left, ...; odometry uses the mean of each side."""

    def __init__(self, spec: DifferentialSpec) -> None:
        ones = (1.0,) * len(spec.left_joints)
        left = [DriveJoint(*item, True) for item in zip(spec.left_joints, spec.left_signs or ones, strict=True)]
        right = [DriveJoint(*item, False) for item in zip(spec.right_joints, spec.right_signs or ones, strict=True)]
        servo = BaseServo(spec.traction, spec.wheel_separation / 2) if spec.kind == "skid_steer" else None
        joints = [joint for pair in zip(left, right, strict=True) for joint in pair]
        response = Response(spec.command_delay, spec.slip, spec.turn_slip)
        super().__init__(joints, spec.max_wheel_torque, servo=servo, response=response)
        self._spec = spec

    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        self.velocity = limit_velocity(self.velocity, commanded, self._spec, dt)
        linear, _, angular = self._rolled
        left, right = wheel_speeds(linear, angular, self._spec)
        return DriveTargets((left, right) * len(self._spec.left_joints))

    def encoder_turns(self, increments: Sequence[float]) -> Sequence[float]:
        """Returns the rotations that the encoders measure: the mean of both sides corrected for ``slip``, their difference for ``turn_slip``."""
        if self.servo or self._grip == self._turn_grip == 1.0:
            return increments
        measured: list[float] = []
        for left, right in zip(increments[::2], increments[1::2], strict=True):
            mean, half = (left + right) / 2 / self._grip, (right - left) / 2 / self._turn_grip
            measured += (mean - half, mean + half)
        return measured

    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns the motion of the base by the wheels: forward, left (m), rotation (rad)."""
        wheels = len(self._spec.left_joints)
        linear, _, angular = body_velocity(sum(increments[::2]) / wheels, sum(increments[1::2]) / wheels, self._spec)
        return linear, 0.0, angular
