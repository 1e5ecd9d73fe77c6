"""Kinematics of a car: two driven rear wheels, two steered front wheels. Pure arithmetic, SI units.

A command is a forward speed and a yaw rate (as in a Twist for ros2_controllers' ackermann_steering_controller); their quotient is
the curvature of the path of the rear axle's centre. Curvatures are 1/m, positive to the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.robots.drive_spec import AckermannSpec
from gibson_sim.robots.drives.base import Drive, DriveJoint, DriveTargets, PlanarVelocity, Response, limit_velocity_change


def steering_angles(curvature: float, car: AckermannSpec) -> tuple[float, float]:
    """Returns the angles (left, right) of the front wheels, radians, positive to the left, whose axes intersect at the centre of the turn."""
    half = curvature * car.steering_separation / 2
    return math.atan2(car.wheelbase * curvature, 1.0 - half), math.atan2(car.wheelbase * curvature, 1.0 + half)


def curvature_from_steering(left: float, right: float, car: AckermannSpec) -> float:
    """Returns the curvature for the angles of the front wheels (radians): the mean of both if they disagree."""
    half = car.steering_separation / 2
    a, b = math.tan(left), math.tan(right)
    return (a / (car.wheelbase + a * half) + b / (car.wheelbase - b * half)) / 2


def rear_speeds(linear: float, curvature: float, car: AckermannSpec) -> tuple[float, float]:
    """Returns the speeds (left, right) of the rear wheels, rad/s, forward positive, for ``linear`` (m/s) on a curved path."""
    half = curvature * car.wheel_separation / 2
    return linear * (1.0 - half) / car.wheel_radius, linear * (1.0 + half) / car.wheel_radius


def feasible_motion(commanded: PlanarVelocity, car: AckermannSpec) -> tuple[float, float | None]:
    """Returns (speed m/s, curvature 1/m) within the car's limits; curvature None = keep the steering.

    The commanded curvature has priority: the speed is reduced if it is too high for it, and the curvature is clamped to its maximum.
    A yaw rate without a speed steers to the limit without driving, because a car cannot turn in place.
    """
    speed, yaw_rate = commanded.linear, commanded.angular
    if speed == 0.0:
        return 0.0, math.copysign(car.max_curvature, yaw_rate) if yaw_rate else None
    curvature = min(max(yaw_rate / speed, -car.max_curvature), car.max_curvature)
    fastest = min(car.max_linear, car.max_angular / abs(curvature)) if curvature else car.max_linear
    return min(max(speed, -fastest), fastest), curvature


class AckermannDrive(Drive):
    """Ackermann drive with a limited steering rate; odometry uses the mean of the rear wheels and the angles of the front wheels."""

    def __init__(self, spec: AckermannSpec) -> None:
        super().__init__(
            (DriveJoint(spec.left_joint, spec.left_sign), DriveJoint(spec.right_joint, spec.right_sign, False)),
            spec.max_wheel_torque,
            (
                DriveJoint(spec.left_steering_joint, spec.left_steering_sign),
                DriveJoint(spec.right_steering_joint, spec.right_steering_sign, False),
            ),
            spec.max_steering_torque,
            response=Response(spec.command_delay, spec.slip, spec.slip),
        )
        self._spec = spec
        self._steering = 0.0
        """Angle of a virtual front wheel in the middle, radians, to which the rate limit applies."""

    def _follow(self, commanded: PlanarVelocity, dt: float) -> DriveTargets:
        car = self._spec
        speed, curvature = feasible_motion(commanded, car)
        if curvature is not None:
            steering = math.atan(curvature * car.wheelbase)
            self._steering = limit_velocity_change(self._steering, steering, math.pi / 2, car.max_steering_rate * dt)
        linear = limit_velocity_change(self.velocity.linear, speed, car.max_linear, car.max_linear_acceleration * dt)
        now = math.tan(self._steering) / car.wheelbase
        self.velocity = PlanarVelocity(*self._arc(linear, now))
        return DriveTargets(rear_speeds(self._rolled.linear, now, car), steering_angles(now, car))

    def encoder_turns(self, increments: Sequence[float]) -> Sequence[float]:
        """Returns the rotations that the encoders measure, corrected for ``slip``."""
        return increments if self._grip == 1.0 else [increment / self._grip for increment in increments]

    def travel(self, increments: Sequence[float], angles: Sequence[float]) -> tuple[float, float, float]:
        """Returns the motion of the base by the wheels: forward, left (m), rotation (rad)."""
        car = self._spec
        forward = car.wheel_radius * (increments[0] + increments[1]) / 2
        return self._arc(forward, curvature_from_steering(angles[0], angles[1], car))

    def _arc(self, forward: float, curvature: float) -> tuple[float, float, float]:
        """Returns the motion of the base, (x, y, yaw), for that of the rear axle's centre, which does not move sideways."""
        turn = forward * curvature
        return forward, -self._spec.rear_axle_x * turn, turn
