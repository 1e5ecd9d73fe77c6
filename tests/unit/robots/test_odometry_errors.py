"""Covariances of wheel odometry: by hand for simple motions, and against the errors of many robots (Bar-Shalom, Li and Kirubarajan 2001, 5.4)."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.drives.odometry_errors import OdometryErrors
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from support.odometry import DT, TOUR, PureRobot, another_of_this_make, nees

RUNS = 50
NONE = (0.0, 0.0, 0.0)
SLIP = WheelOdometrySpec(alpha1=4e-4, alpha2=1e-4, alpha3=4e-4, alpha4=1e-4)


@pytest.fixture(scope="module")
def real(root: Path) -> tuple[DifferentialSpec, WheelOdometrySpec]:
    robot = load_robot(root / "config/robots/gibson_bot_real")
    assert isinstance(robot.drive, DifferentialSpec)
    return robot.drive, robot.sensors.wheel_odometry


def moved(errors: OdometryErrors, forward: float, turn: float, steps: int = 1000) -> np.ndarray:
    """Returns the covariance of the pose after a motion in equal steps, (3, 3)."""
    for _ in range(steps):
        errors.add(forward / steps, 0.0, turn / steps, NONE, DT)
    return np.array(errors.covariance().pose).reshape(3, 3)


def bounds(runs: int, share: float = 0.99) -> tuple[float, float]:
    """Returns the interval of the mean of ``runs`` three-dimensional NEES with a probability of ``share``."""
    low, high = chi2.ppf([(1 - share) / 2, (1 + share) / 2], 3 * runs) / runs
    return float(low), float(high)


def test_slip_of_many_metres_adds_up_as_a_random_walk() -> None:
    # 16 m straight: x by alpha3 a metre. The yaw is a walk of 16 steps: 16 alpha2, and the sum of its moments makes y: sum (k + 1/2)^2 alpha2.
    got = moved(OdometryErrors(SLIP), 16.0, 0.0, 4000)
    assert math.sqrt(got[0, 0]) == pytest.approx(math.hypot(math.sqrt(16 * 4e-4), 0.002 * 16), rel=0.02)
    assert math.sqrt(got[2, 2]) == pytest.approx(math.sqrt(16 * 1e-4), rel=0.02)
    assert got[1, 1] == pytest.approx(1e-4 * sum((k + 0.5) ** 2 for k in range(16)), rel=0.02)
    assert got[1, 2] == pytest.approx(1e-4 * sum(k + 0.5 for k in range(16)), rel=0.02)
    assert got[0, 1] == pytest.approx(0.0, abs=1e-9)


def test_wrong_separation_grows_with_the_turn_and_turns_back_with_it() -> None:
    errors = OdometryErrors(WheelOdometrySpec(separation_factor=1.02))
    assert math.sqrt(moved(errors, 0.0, 10.0)[2, 2]) == pytest.approx(0.2, rel=0.01)
    assert math.sqrt(moved(errors, 0.0, -10.0)[2, 2]) < 0.005


def test_covariance_lies_along_the_axes_of_the_odom_frame() -> None:
    # 90 degrees to the left, then 4 m: an error of the yaw is one of x, an error of the distance one of y.
    errors = OdometryErrors(WheelOdometrySpec(alpha1=1e-2))
    moved(errors, 0.0, math.pi / 2)
    got = moved(errors, 4.0, 0.0)
    assert math.sqrt(got[0, 0]) == pytest.approx(4.0 * math.sqrt(got[2, 2]), rel=0.01)
    assert got[0, 2] < 0.0
    assert math.sqrt(got[1, 1]) < 0.02


def test_encoders_add_no_more_than_a_tick_however_far_it_goes() -> None:
    tick = 0.001
    near, far = (
        moved(OdometryErrors(WheelOdometrySpec(encoder_ticks=100), ticks=[(tick, 0.0, 0.0)]), length, 0.0)[0, 0]
        - moved(OdometryErrors(WheelOdometrySpec()), length, 0.0)[0, 0]
        for length in (0.5, 20.0)
    )
    assert near == pytest.approx(tick**2 / 3)
    assert far == pytest.approx(tick**2 / 3)


def test_speed_variance_of_wheels_without_ticks_falls_with_time() -> None:
    errors = OdometryErrors(WheelOdometrySpec(encoder_ticks=4096), ticks=[(1e-4, 0.0, 0.0)] * 2)
    errors.add(0.01, 0.0, 0.0, NONE, DT)
    variances = [errors.covariance().twist[0]]
    for _ in range(120):
        errors.add(0.0, 0.0, 0.0, NONE, DT)
        variances.append(errors.covariance().twist[0])
    assert variances[0] > variances[2] > variances[30] > variances[120]
    assert variances[120] == pytest.approx(1e-6, rel=0.01)


def test_without_errors_nothing_is_zero_and_all_is_small() -> None:
    errors = OdometryErrors(WheelOdometrySpec())
    for got in (*errors.covariance(), moved(errors, 3.0, 2.0).ravel(), errors.covariance().twist):
        variances = np.array(got).reshape(3, 3).diagonal()
        assert (variances > 0.0).all()
        assert (variances < 0.01**2).all()


def test_reading_odometry_more_often_changes_nothing() -> None:
    one, other = OdometryErrors(SLIP), OdometryErrors(SLIP)
    for _ in range(500):
        for errors in (one, other):
            errors.add(0.0031, 0.0, 0.002, NONE, DT)
        one.covariance()
    assert one.covariance() == other.covariance()


def test_after_a_reset_the_pose_is_known_again() -> None:
    errors = OdometryErrors(SLIP)
    fresh = errors.covariance()
    moved(errors, 5.0, 3.0)
    errors.reset()
    assert errors.covariance() == fresh


def test_odometry_covariance_is_consistent_over_many_robots(real: tuple[DifferentialSpec, WheelOdometrySpec]) -> None:
    """At five times within 34 s, the mean NEES of 50 robots of one make, each with its own dimensions and slip, is within its bounds."""
    drive, believed = real
    rng = np.random.default_rng(7)
    moments = 5
    pose, twist = np.zeros((RUNS, moments)), np.zeros((RUNS, moments))
    for run in range(RUNS):
        robot = PureRobot(drive, another_of_this_make(believed, rng), believed, seed=run)
        steps = [(v, w) for v, w, seconds in TOUR for _ in range(round(seconds / DT))]
        look = np.linspace(0, len(steps), moments + 1).astype(int)[1:] - 1
        for i, step in enumerate(steps):
            robot.step(*step)
            for moment in np.flatnonzero(look == i):
                covariance = robot.covariance.covariance()
                pose[run, moment] = nees(robot.pose_error(), covariance.pose)
                twist[run, moment] = nees(robot.twist_error(), covariance.twist)
    low, high = bounds(RUNS)
    assert (low < pose.mean(axis=0)).all() and (pose.mean(axis=0) < high).all(), (pose.mean(axis=0), twist.mean(axis=0))
    # The engine's share of the errors is not in these robots, nor do their wheels slide sideways: fewer than three dimensions err.
    assert (twist.mean(axis=0) < high).all(), twist.mean(axis=0)
    assert twist.mean() > 1.0


def test_the_robot_of_the_file_itself_is_consistent(real: tuple[DifferentialSpec, WheelOdometrySpec]) -> None:
    """Its dimensions are wrong by exactly one standard deviation; only the slip differs from run to run."""
    drive, spec = real
    got = []
    for run in range(RUNS):
        robot = PureRobot(drive, spec, seed=run)
        for linear, angular, seconds in TOUR:
            for _ in range(round(seconds / DT)):
                robot.step(linear, angular)
        got.append(nees(robot.pose_error(), robot.covariance.covariance().pose))
    low, high = bounds(RUNS)
    assert low < np.mean(got) < high


def test_dimensions_taken_for_exact_would_not_be_consistent(real: tuple[DifferentialSpec, WheelOdometrySpec]) -> None:
    """The test above can fail: without the systematic part the same errors are far out of bounds."""
    drive, spec = real
    blind = replace(spec, left_radius_factor=1.0, right_radius_factor=1.0, separation_factor=1.0)
    got = []
    for run in range(20):
        robot = PureRobot(drive, replace(spec, separation_factor=1.03), blind, seed=run)
        for _ in range(1200):
            robot.step(0.3, 0.8)
        got.append(nees(robot.pose_error(), robot.covariance.covariance().pose))
    assert np.mean(got) > bounds(20)[1]
