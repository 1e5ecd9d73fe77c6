"""Robots whose wheels do exactly what they are told, so that whatever is wrong with odometry comes of the errors in their file."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.drives import make_drive
from gibson_sim.robots.drives.differential import wheel_speeds
from gibson_sim.robots.drives.wheel_odometry import WheelOdometry
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.types import NS_PER_S

F64 = NDArray[np.float64]
DT = 1.0 / 30.0
"""Seconds of a step."""
TOUR: tuple[tuple[float, float, float], ...] = (
    (0.0, 0.0, 1.0), (0.4, 0.0, 5.0), (0.3, 0.7, 4.0), (0.0, -1.2, 2.0), (0.4, 0.0, 6.0), (0.0, 0.0, 1.0), (0.3, -0.6, 8.0), (0.4, 0.5, 7.0),
)  # fmt: skip
"""34 s of driving: (m/s, rad/s, seconds)."""


class PureRobot:
    """A differential drive on an ideal floor: the truth, and what its odometry makes of it."""

    def __init__(
        self, drive: DifferentialSpec, errors: WheelOdometrySpec, believed: WheelOdometrySpec | None = None, seed: int = 0
    ) -> None:
        """Starts at the origin.

        Args:
            drive: Its kinematics.
            errors: What is wrong with its odometry.
            believed: What its file says of that; None = the same.
            seed: Of the slip.
        """
        self._spec = drive
        self.odometry = WheelOdometry(make_drive(drive), errors, "robot", seed)
        self.covariance = self.odometry if believed is None else WheelOdometry(make_drive(drive), believed, "robot", seed)
        self._others = [self.odometry] if self.covariance is self.odometry else [self.odometry, self.covariance]
        self.x = self.y = self.yaw = 0.0
        self.velocity = (0.0, 0.0)
        self.stamp_ns = 0

    def step(self, linear: float, angular: float) -> None:
        """Drives on for ``DT`` seconds at m/s and rad/s."""
        self.stamp_ns += round(DT * NS_PER_S)
        increments = [speed * DT for speed in wheel_speeds(linear, angular, self._spec)]
        for one in self._others:
            one.add(increments, (), self.stamp_ns, DT)
        middle = self.yaw + angular * DT / 2
        self.x += linear * DT * math.cos(middle)
        self.y += linear * DT * math.sin(middle)
        self.yaw += angular * DT
        self.velocity = linear, angular

    def pose_error(self) -> F64:
        """Returns odometry minus truth: x, y (m), yaw (rad)."""
        odometry = self.odometry.odometry
        turned = math.remainder(odometry.yaw - self.yaw, 2 * math.pi)
        return np.array([odometry.x - self.x, odometry.y - self.y, turned])

    def twist_error(self) -> F64:
        """Returns the same of forward speed, speed to the left and yaw rate."""
        odometry, (linear, angular) = self.odometry.odometry, self.velocity
        return np.array([odometry.linear - linear, odometry.lateral, odometry.angular - angular])


def another_of_this_make(spec: WheelOdometrySpec, rng: np.random.Generator) -> WheelOdometrySpec:
    """Returns a robot whose dimensions are wrong by as much as those of ``spec``, at random."""
    keys = ("left_radius_factor", "right_radius_factor", "separation_factor")
    return replace(spec, **{key: 1.0 + (getattr(spec, key) - 1.0) * float(rng.standard_normal()) for key in keys})


def nees(error: F64, covariance: tuple[float, ...]) -> float:
    """Returns the normalised estimation error squared, error^T covariance^-1 error."""
    return float(error @ np.linalg.solve(np.array(covariance).reshape(3, 3), error))
