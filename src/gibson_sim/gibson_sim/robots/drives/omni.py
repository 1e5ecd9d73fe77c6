"""Kinematics of mecanum and omni wheels, in any number and arrangement. Pure arithmetic, SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gibson_sim.robots.drive_spec import OmniSpec
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
        reach = sum(math.hypot(*wheel.position) for wheel in spec.wheels) / len(spec.wheels)
        joints = [DriveJoint(wheel.joint, is_left=wheel.position[1] > 0.0) for wheel in spec.wheels]
        response = Response(spec.command_delay, spec.slip, spec.turn_slip)
        super().__init__(joints, spec.max_wheel_torque, servo=BaseServo(spec.traction, reach), response=response)
        self._spec = spec
        matrix = spec.wheel_matrix()
        self._wheels_from_body = [tuple(row) for row in matrix.tolist()]
        self._body_from_wheels = [tuple(row) for row in np.linalg.pinv(matrix).tolist()]

    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        now, limits = self.velocity, self._spec
        self.velocity = PlanarVelocity(
            limit_velocity_change(now.linear, commanded.linear, limits.max_linear, limits.max_linear_acceleration * dt),
            limit_velocity_change(now.lateral, commanded.lateral, limits.max_lateral, limits.max_lateral_acceleration * dt),
            limit_velocity_change(now.angular, commanded.angular, limits.max_angular, limits.max_angular_acceleration * dt),
        )
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
