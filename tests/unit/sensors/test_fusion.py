"""The published covariances are useful: a filter that uses them is better than wheels or gyroscope alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.sensor_specs import ImuSpec, WheelOdometrySpec
from gibson_sim.sensors.imu import Imu
from gibson_sim.types import SceneState
from support.ekf import PlanarEkf
from support.odometry import DT, TOUR, PureRobot, another_of_this_make

RUNS = 20


@dataclass
class Parts:
    drive: DifferentialSpec
    wheels: WheelOdometrySpec
    imu: ImuSpec


@pytest.fixture(scope="module")
def real(root: Path) -> Parts:
    robot = load_robot(root / "config/robots/gibson_bot_real")
    assert isinstance(robot.drive, DifferentialSpec)
    (imu,) = robot.sensors.imus
    return Parts(robot.drive, robot.sensors.wheel_odometry, replace(imu, rate_hz=1.0 / DT))


def drive(parts: Parts, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the errors of yaw (rad) and position (m) after 34 s, with wheels alone, gyroscope alone, and both in a filter.

    The position of "gyroscope alone" integrates the speed of the wheels along its yaw.
    """
    rng = np.random.default_rng(seed)
    robot = PureRobot(parts.drive, another_of_this_make(parts.wheels, rng), parts.wheels, seed)
    imu = Imu(parts.imu, (0.0, 0.0, -9.81), seed)
    x = y = yaw = 0.0
    ekf: PlanarEkf | None = None
    for linear, angular, seconds in TOUR:
        for _ in range(round(seconds / DT)):
            robot.step(linear, angular)
            quat = np.array([[0.0, 0.0, math.sin(robot.yaw / 2), math.cos(robot.yaw / 2)]])
            twist = np.array([[linear * math.cos(robot.yaw), linear * math.sin(robot.yaw), 0.0, 0.0, 0.0, angular]])
            reading = imu.measure(SceneState(robot.stamp_ns, 1, 1, (parts.imu.link,), np.zeros((1, 3)), quat, twist))
            odometry, rate = robot.odometry.odometry, float(reading.angular_velocity[2])
            yaw += rate * DT
            x, y = x + odometry.linear * DT * math.cos(yaw), y + odometry.linear * DT * math.sin(yaw)
            ekf = ekf or PlanarEkf(reading.angular_variance)
            ekf.predict(DT)
            ekf.wheels(odometry.linear, odometry.angular, robot.covariance.covariance().twist)
            ekf.gyroscope(rate, reading.angular_variance)
    assert ekf is not None
    odometry = robot.odometry.odometry
    poses = [(odometry.x, odometry.y, odometry.yaw), (x, y, yaw), tuple(ekf.state[:3].tolist())]
    turned = np.array([math.remainder(yaw - robot.yaw, 2 * math.pi) for _, _, yaw in poses])
    return turned, np.array([math.hypot(x - robot.x, y - robot.y) for x, y, _ in poses])


def test_filter_of_wheels_and_gyroscope_is_clearly_better_than_either(real: Parts) -> None:
    turned, away = (
        np.sqrt(np.mean(np.square(errors), axis=0)) for errors in zip(*(drive(real, s) for s in range(RUNS)), strict=True)
    )
    wheels, gyroscope, both = turned.tolist()
    assert both < 0.6 * min(wheels, gyroscope), np.degrees(turned)
    wheels, gyroscope, both = away.tolist()
    assert both < min(0.5 * wheels, gyroscope), away
    # The wheels must have realistic errors, or the comparison shows nothing.
    assert math.degrees(turned[0]) > 3.0
