"""Drives that move a base in all directions: mecanum and omni wheels in any arrangement, and a base without wheels. Pure, SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gibson_sim.robots.drive_spec import OmniSpec, PlanarSpec
from gibson_sim.robots.drives.base import (
    BaseServo,
    Drive,
    DriveJoint,
    DriveTargets,
    PlanarVelocity,
    Response,
    limit_velocity_change,
)


class OmniDrive(Drive):
    """Omnidirectional drive; odometry is the least-squares fit to all wheels."""

    def __init__(self, spec: OmniSpec) -> None:
        lever_arm = sum(math.hypot(*wheel.position) for wheel in spec.wheels) / len(spec.wheels)
        joints = [DriveJoint(wheel.joint, is_left=wheel.position[1] > 0.0) for wheel in spec.wheels]
        response = Response(spec.command_delay, spec.slip, spec.turn_slip)
        super().__init__(joints, spec.max_wheel_torque, servo=BaseServo(spec.traction, lever_arm), response=response)
        self._spec = spec
        matrix = spec.wheel_matrix()
        self._wheels_from_body = [tuple(row) for row in matrix.tolist()]
        self._body_from_wheels = [tuple(row) for row in np.linalg.pinv(matrix).tolist()]

    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        self.velocity = _limited(self.velocity, commanded, self._spec, dt)
        return DriveTargets(self.wheel_speeds(self.velocity))

    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns the motion of the base by the wheels: forward, left (m), rotation (rad)."""
        return self.body_velocity(increments)

    def wheel_speeds(self, velocity: PlanarVelocity) -> tuple[float, ...]:
        """Returns the joint speeds, rad/s, for a velocity of the base."""
        x, y, yaw = velocity
        return tuple(a * x + b * y + c * yaw for a, b, c in self._wheels_from_body)

    def body_velocity(self, speeds: Sequence[float]) -> PlanarVelocity:
        """Returns the base velocity for joint speeds, rad/s: the least-squares fit for more than three wheels."""
        x, y, yaw = (sum(a * b for a, b in zip(row, speeds, strict=True)) for row in self._body_from_wheels)
        return PlanarVelocity(x, y, yaw)


class PlanarDrive(Drive):
    """Moves the base in all directions without wheels; odometry is the motion that the base makes."""

    def __init__(self, spec: PlanarSpec) -> None:
        response = Response(spec.command_delay, spec.slip, spec.turn_slip)
        super().__init__((), 0.0, servo=BaseServo(spec.traction, 0.0), response=response)
        self._spec = spec

    @property
    def encoders_left(self) -> tuple[bool, ...]:
        """Forward, left and rotation are measured, on no side."""
        return (True, True, True)

    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        self.velocity = _limited(self.velocity, commanded, self._spec, dt)
        return DriveTargets(tuple(self.velocity))

    def encoder_turns(self, increments: Sequence[float]) -> Sequence[float]:
        """Returns the motion that odometry measures: forward, left (m), rotation (rad), including slip."""
        forward, left, turn = increments
        return forward / self._grip, left / self._grip, turn / self._turn_grip

    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns the motion of the base: forward, left (m), rotation (rad), which are the increments themselves."""
        forward, left, turn = increments
        return forward, left, turn


def _limited(now: PlanarVelocity, commanded: PlanarVelocity, limits: OmniSpec | PlanarSpec, dt: float) -> PlanarVelocity:
    """Returns the velocity after ``dt`` seconds, as near to ``commanded`` as the limits allow."""
    return PlanarVelocity(
        limit_velocity_change(now.linear, commanded.linear, limits.max_linear, limits.max_linear_acceleration * dt),
        limit_velocity_change(now.lateral, commanded.lateral, limits.max_lateral, limits.max_lateral_acceleration * dt),
        limit_velocity_change(now.angular, commanded.angular, limits.max_angular, limits.max_angular_acceleration * dt),
    )
