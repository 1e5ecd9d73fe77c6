"""Wheel odometry of one robot: what its encoders count, what it makes of that, and how far that may be off. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.robots.drives import Drive
from gibson_sim.robots.odometry_errors import OdometryCovariance, OdometryErrors, Planar
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.robots.wheel_noise import OdometryNoise
from gibson_sim.types import Odometry


class WheelOdometry:
    """Sums what the wheels of a drive turn, with the errors of its robot."""

    def __init__(self, drive: Drive, spec: WheelOdometrySpec, name: str, seed: int = 0) -> None:
        """Starts at the origin of the odom frame.

        Args:
            drive: Its kinematics.
            spec: What is wrong with the odometry.
            name: Of the robot.
            seed: Of the simulation.
        """
        self._drive = drive
        self._is_left = [wheel.is_left for wheel in drive.wheels]
        noise = OdometryNoise(spec, name, seed, left=self._is_left)
        self._noise = None if noise.exact else noise
        self._by_sides = {spec.left_radius_factor, spec.right_radius_factor} != {1.0}
        ticks: list[Planar] = []
        if spec.encoder_ticks:
            tick, straight = 2.0 * math.pi / spec.encoder_ticks, [0.0] * len(drive.steering)
            wheels = range(len(drive.wheels))
            ticks = [drive.travel([tick if i == wheel else 0.0 for i in wheels], straight) for wheel in wheels]
        self._errors = OdometryErrors(spec, drive.response.slip, drive.response.turn_slip, ticks, steered=bool(drive.steering))

    @property
    def odometry(self) -> Odometry:
        """Where the wheels say that the base is."""
        return self._drive.odometry

    def covariance(self) -> OdometryCovariance:
        """Returns how well ``odometry`` is known."""
        return self._errors.covariance()

    def add(self, increments: Sequence[float], steering: Sequence[float], stamp_ns: int, dt: float) -> None:
        """Adds one step.

        Args:
            increments: Radians that each of the drive's wheels rolled forward.
            steering: Radians at which each of its steering joints stands, positive to the left.
            stamp_ns: Decides the noise.
            dt: Seconds that the step took, above 0.
        """
        drive, noise = self._drive, self._noise
        if noise is None:
            motion = drive.travel(increments, steering)
        else:
            increments = noise.wheels(increments)
            motion = noise.motion(stamp_ns, *drive.travel(increments, steering))
        by_left_wheels = (0.0, 0.0, 0.0)
        if self._by_sides:
            on_left = [turn if is_left else 0.0 for turn, is_left in zip(increments, self._is_left, strict=True)]
            by_left_wheels = drive.travel(on_left, steering)
        drive.advance(*motion, dt)
        self._errors.add(*motion, by_left_wheels, dt)
