"""Wheel odometry of one robot: what its encoders count, what it makes of that, and how far that may be off. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.robots.drives import Drive
from gibson_sim.robots.drives.odometry_errors import OdometryCovariance, OdometryErrors, Planar
from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.types import Odometry

_TURN = 2.0 * math.pi


class OdometryNoise:
    """The errors of one robot's odometry; the seeds, the robot's name and the stamp decide how it slips."""

    def __init__(self, spec: WheelOdometrySpec, name: str, seed: int = 0, left: Sequence[bool] = (True, False)) -> None:
        """Starts with all encoders at 0.

        Args:
            spec: What is wrong.
            name: Of the robot, so that two of a kind slip differently.
            seed: Of the simulation.
            left: For each wheel, in the order of ``increments``, whether it is on the robot's left.
        """
        self._spec = spec
        noise = NoiseSource(f"{name}/wheel_odometry", seed, spec.seed)
        self._by_distance = _Slip(noise, 0, spec.alpha2, spec.alpha3)
        self._by_angle = _Slip(noise, 1, spec.alpha1, spec.alpha4)
        self._factors = tuple(spec.left_radius_factor if is_left else spec.right_radius_factor for is_left in left)
        self._slips = any((spec.alpha1, spec.alpha2, spec.alpha3, spec.alpha4))
        self.exact = not (self._slips or spec.encoder_ticks or {*self._factors, spec.separation_factor} != {1.0})
        """Whether nothing is wrong, so that there is no need to ask."""
        self.reset()

    def reset(self) -> None:
        """Puts all encoders back to 0, and forgets the slip."""
        self._angles = [0.0] * len(self._factors)
        self._ticks = [0] * len(self._factors)
        self._by_distance.reset()
        self._by_angle.reset()

    def wheels(self, increments: Sequence[float]) -> tuple[float, ...]:
        """Returns the turns of the wheels, radians, as their encoders count them and wrong radii scale them.

        Args:
            increments: Radians that the joint of each wheel turned since the last call.
        """
        ticks = self._spec.encoder_ticks
        if not ticks:
            return tuple(increment * factor for increment, factor in zip(increments, self._factors, strict=True))
        out = []
        for i, (increment, factor) in enumerate(zip(increments, self._factors, strict=True)):
            self._angles[i] += increment
            count = math.floor(self._angles[i] * ticks / _TURN)
            out.append((count - self._ticks[i]) * _TURN / ticks * factor)
            self._ticks[i] = count
        return tuple(out)

    def motion(self, stamp_ns: int, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Returns a motion of the base (forward m, left m, turn rad) with its slip and the error of a wrong separation.

        A wheel slips evenly for a while: an error, in parts of the motion, lasts for 1 m or 1 rad, then another one comes.

        Args:
            stamp_ns: Of the end of the step; that of its first step decides a new error.
            forward: Metres, far less than 1.
            left: Metres, far less than 1.
            turn: Radians, counter-clockwise, far less than 1.
        """
        turn /= self._spec.separation_factor
        if not self._slips:
            return forward, left, turn
        distance, angle = math.hypot(forward, left), abs(turn)
        turn_by_distance, slip_by_distance = self._by_distance.advance(stamp_ns, distance)
        turn_by_angle, slip_by_angle = self._by_angle.advance(stamp_ns, angle)
        slip = slip_by_distance * distance + slip_by_angle * angle
        # Along the motion; forward where the base turns in place.
        x, y = (forward / distance, left / distance) if distance > 0.0 else (1.0, 0.0)
        return forward + slip * x, left + slip * y, turn + turn_by_distance * distance + turn_by_angle * angle


class _Slip:
    """Two errors in parts of a motion, that of the turn and that of the translation, each constant over one unit of the motion."""

    def __init__(self, noise: NoiseSource, purpose: int, turn_variance: float, slip_variance: float) -> None:
        self._noise, self._purpose = noise, purpose
        self._deviations = (math.sqrt(turn_variance), math.sqrt(slip_variance))
        self.reset()

    def reset(self) -> None:
        self._left = 0.0
        self._errors = (0.0, 0.0)

    def advance(self, stamp_ns: int, amount: float) -> tuple[float, float]:
        """Returns (error of the turn, error of the translation) for each unit of a motion of ``amount`` units."""
        if amount > 0.0 and self._left <= 0.0:
            turn, slip = self._noise.at(stamp_ns, self._purpose).standard_normal(2).tolist()
            self._errors = (turn * self._deviations[0], slip * self._deviations[1])
            self._left = 1.0
        self._left -= amount
        return self._errors


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
