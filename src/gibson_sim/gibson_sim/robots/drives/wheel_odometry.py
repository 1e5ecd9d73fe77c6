"""Wheel odometry of one robot: dead reckoning from encoder counts, with errors, and its covariance. Pure.

``OdometryNoise`` models the errors (encoder ticks, wrong radii and separation, random slip); ``odometry_errors`` computes the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.robots.drives import Drive
from gibson_sim.robots.drives.odometry_errors import OdometryCovariance, OdometryErrors, Planar
from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import TURN, WheelOdometrySpec
from gibson_sim.types import Odometry


class WheelOdometry:
    """Dead reckoning from the wheel rotations of a drive, with odometry errors."""

    def __init__(self, drive: Drive, spec: WheelOdometrySpec, name: str, seed: int = 0) -> None:
        """Starts at the origin of the odom frame.

        Args:
            drive: Kinematics of the drive.
            spec: Errors of the odometry.
            name: Name of the robot.
            seed: Seed of the simulation.
        """
        self._drive = drive
        self._is_left = drive.encoders_left
        noise = OdometryNoise(spec, name, seed, left=self._is_left)
        self._noise = None if noise.exact else noise
        self._sides_differ = {spec.left_radius_factor, spec.right_radius_factor} != {1.0}
        ticks: list[Planar] = []
        if spec.encoder_ticks:
            tick, straight = TURN / spec.encoder_ticks, [0.0] * len(drive.steering)
            wheels = range(len(self._is_left))
            ticks = [drive.travel([tick if i == wheel else 0.0 for i in wheels], straight) for wheel in wheels]
        self._errors = OdometryErrors(spec, drive.response.slip, drive.response.turn_slip, ticks, steered=bool(drive.steering))

    @property
    def odometry(self) -> Odometry:
        """Pose and velocity of the base by the wheels."""
        return self._drive.odometry

    def covariance(self) -> OdometryCovariance:
        """Returns the covariance of ``odometry``."""
        return self._errors.covariance()

    def add(self, increments: Sequence[float], steering: Sequence[float], stamp_ns: int, dt: float) -> None:
        """Adds one step.

        Args:
            increments: Rotation of each of the drive's wheels, radians, forward positive.
            steering: Angle of each of its steering joints, radians, positive to the left.
            stamp_ns: Time, ns, which determines the noise.
            dt: Length of the step, s, above 0.
        """
        drive, noise = self._drive, self._noise
        if noise is None:
            motion = drive.travel(increments, steering)
        else:
            increments = noise.wheels(increments)
            motion = noise.motion(stamp_ns, *drive.travel(increments, steering))
        by_left_wheels = (0.0, 0.0, 0.0)
        if self._sides_differ:
            on_left = [turn if is_left else 0.0 for turn, is_left in zip(increments, self._is_left, strict=True)]
            by_left_wheels = drive.travel(on_left, steering)
        drive.advance(*motion, dt)
        self._errors.add(*motion, by_left_wheels, dt)


class OdometryNoise:
    """Errors of one robot's odometry; slip is determined by the seeds, the robot's name and the stamp."""

    def __init__(self, spec: WheelOdometrySpec, name: str, seed: int = 0, left: Sequence[bool] = (True, False)) -> None:
        """Starts with all encoders at 0.

        Args:
            spec: The errors.
            name: Name of the robot, so that equal robots slip differently.
            seed: Seed of the simulation.
            left: For each wheel, in the order of ``increments``, whether it is on the robot's left.
        """
        self._spec = spec
        noise = NoiseSource(f"{name}/wheel_odometry", seed, spec.seed)
        self._by_distance = _Slip(noise, 0, spec.alpha2, spec.alpha3)
        self._by_angle = _Slip(noise, 1, spec.alpha1, spec.alpha4)
        self._factors = tuple(spec.left_radius_factor if is_left else spec.right_radius_factor for is_left in left)
        self._slips = any((spec.alpha1, spec.alpha2, spec.alpha3, spec.alpha4))
        self.exact = not (self._slips or spec.encoder_ticks or {*self._factors, spec.separation_factor} != {1.0})
        """Whether there are no errors."""
        self.reset()

    def reset(self) -> None:
        """Sets all encoders to 0, and resets the slip."""
        self._angles = [0.0] * len(self._factors)
        self._ticks = [0] * len(self._factors)
        self._by_distance.reset()
        self._by_angle.reset()

    def wheels(self, increments: Sequence[float]) -> tuple[float, ...]:
        """Returns the rotations of the wheels, radians, quantised by their encoders and scaled by wrong radii.

        Args:
            increments: Rotation of each wheel joint since the last call, radians.
        """
        ticks = self._spec.encoder_ticks
        if not ticks:
            return tuple(increment * factor for increment, factor in zip(increments, self._factors, strict=True))
        out = []
        for i, (increment, factor) in enumerate(zip(increments, self._factors, strict=True)):
            self._angles[i] += increment
            count = math.floor(self._angles[i] * ticks / TURN)
            out.append((count - self._ticks[i]) * TURN / ticks * factor)
            self._ticks[i] = count
        return tuple(out)

    def motion(self, stamp_ns: int, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Returns a motion of the base (forward m, left m, rotation rad) with its slip and the error of a wrong separation.

        An error is a constant fraction of the motion for 1 m or 1 rad; then it is sampled again.

        Args:
            stamp_ns: Time at the end of the step, ns, which determines a new error.
            forward: Forward motion, metres, much less than 1.
            left: Motion to the left, metres, much less than 1.
            turn: Rotation, radians, counter-clockwise, far less than 1.
        """
        turn /= self._spec.separation_factor
        if not self._slips:
            return forward, left, turn
        distance, angle = math.hypot(forward, left), abs(turn)
        turn_by_distance, slip_by_distance = self._by_distance.advance(stamp_ns, distance)
        turn_by_angle, slip_by_angle = self._by_angle.advance(stamp_ns, angle)
        slip = slip_by_distance * distance + slip_by_angle * angle
        # In the direction of motion; forward if the base turns in place.
        x, y = (forward / distance, left / distance) if distance > 0.0 else (1.0, 0.0)
        return forward + slip * x, left + slip * y, turn + turn_by_distance * distance + turn_by_angle * angle


class _Slip:
    """Two errors as fractions of a motion, of rotation and of translation, each constant over one unit of the motion."""

    def __init__(self, noise: NoiseSource, purpose: int, turn_variance: float, slip_variance: float) -> None:
        self._noise, self._purpose = noise, purpose
        self._std_devs = (math.sqrt(turn_variance), math.sqrt(slip_variance))
        self.reset()

    def reset(self) -> None:
        self._left = 0.0
        self._errors = (0.0, 0.0)

    def advance(self, stamp_ns: int, amount: float) -> tuple[float, float]:
        """Returns (error of rotation, error of translation) per unit of a motion of ``amount`` units."""
        if amount > 0.0 and self._left <= 0.0:
            turn, slip = self._noise.at(stamp_ns, self._purpose).standard_normal(2).tolist()
            self._errors = (turn * self._std_devs[0], slip * self._std_devs[1])
            self._left = 1.0
        self._left -= amount
        return self._errors
