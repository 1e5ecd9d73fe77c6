"""Wheels and body of a differential drive; wheels of 0.05 m radius, 0.4 m apart."""

from __future__ import annotations

import math

import pytest

from gibson_sim.robots.differential_drive import (
    PlanarVelocity,
    WheelOdometry,
    active_command,
    body_velocity,
    limit_velocity,
    wheel_speeds,
)
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.types import VelocityCommand

DRIVE = DriveSpec(
    "l", "r", wheel_radius=0.05, wheel_separation=0.4, max_linear=0.5, max_angular=2.0,
    max_linear_acceleration=1.0, max_angular_acceleration=4.0,
)  # fmt: skip


def test_forward_turns_both_wheels_equally() -> None:
    assert wheel_speeds(0.5, 0.0, DRIVE) == pytest.approx((10.0, 10.0))


def test_left_turn_rolls_the_left_wheel_back_and_the_right_one_forward() -> None:
    # 1 rad/s at 0.2 m is 0.2 m/s, over 0.05 m radius 4 rad/s.
    assert wheel_speeds(0.0, 1.0, DRIVE) == pytest.approx((-4.0, 4.0))


def test_faster_right_wheel_turns_the_body_left() -> None:
    assert body_velocity(2.0, 6.0, DRIVE) == pytest.approx((0.2, 0.5))


def test_body_velocity_undoes_wheel_speeds() -> None:
    assert body_velocity(*wheel_speeds(0.3, -0.7, DRIVE), DRIVE) == pytest.approx((0.3, -0.7))


def test_speed_rises_by_acceleration_times_time() -> None:
    assert limit_velocity(PlanarVelocity(0.1, 0.0), PlanarVelocity(0.5, 2.0), DRIVE, 0.1) == pytest.approx((0.2, 0.4))


def test_braking_obeys_the_same_limit() -> None:
    assert limit_velocity(PlanarVelocity(0.3, -1.0), PlanarVelocity(), DRIVE, 0.1) == pytest.approx((0.2, -0.6))


def test_wanted_speed_is_cut_to_the_maximum() -> None:
    assert limit_velocity(PlanarVelocity(0.49, -1.99), PlanarVelocity(9.0, -9.0), DRIVE, 1.0) == (0.5, -2.0)


def test_limited_speed_arrives_exactly_at_zero() -> None:
    assert limit_velocity(PlanarVelocity(0.003, -0.01), PlanarVelocity(), DRIVE, 0.01) == (0.0, 0.0)


def test_limiting_does_not_alter_the_command() -> None:
    wanted = PlanarVelocity(9.0, 9.0)
    limit_velocity(PlanarVelocity(), wanted, DRIVE, 0.1)
    assert wanted == (9.0, 9.0)


def test_fresh_command_is_obeyed_to_its_last_nanosecond() -> None:
    command = VelocityCommand((0.2, 9.0, 9.0), (9.0, 9.0, 0.3), stamp_ns=100)
    assert active_command(command, 600, 500) == (0.2, 0.3)


def test_stale_command_is_zero() -> None:
    command = VelocityCommand((0.2, 0.0, 0.0), (0.0, 0.0, 0.3), stamp_ns=100)
    assert active_command(command, 601, 500) == (0.0, 0.0)


def test_no_command_is_zero() -> None:
    assert active_command(None, 0, 500) == (0.0, 0.0)


def test_odometry_of_a_straight_line() -> None:
    odometry = WheelOdometry(DRIVE)
    odometry.update(10.0, 10.0, 2.0)
    got = odometry.odometry
    assert (got.x, got.y, got.yaw, got.linear, got.angular) == pytest.approx((0.5, 0.0, 0.0, 0.25, 0.0))


def test_odometry_of_a_quarter_circle_in_one_update_is_exact() -> None:
    # A left turn of 90 degrees about a point 1 m to the left: the wheels run on radii 0.8 and 1.2 m.
    odometry = WheelOdometry(DRIVE)
    odometry.update(0.8 * math.pi / 2 / 0.05, 1.2 * math.pi / 2 / 0.05, 1.0)
    got = odometry.odometry
    assert (got.x, got.y, got.yaw) == pytest.approx((1.0, 1.0, math.pi / 2))


def test_odometry_turns_before_it_goes_on() -> None:
    odometry = WheelOdometry(DRIVE)
    quarter = math.pi / 2 * 0.2 / 0.05
    odometry.update(-quarter, quarter, 1.0)
    odometry.update(20.0, 20.0, 1.0)
    got = odometry.odometry
    assert (got.x, got.y, got.yaw) == pytest.approx((0.0, 1.0, math.pi / 2), abs=1e-12)


def test_odometry_yaw_stays_within_half_a_turn() -> None:
    odometry = WheelOdometry(DRIVE)
    for _ in range(3):
        odometry.update(-math.pi / 2 * 4, math.pi / 2 * 4, 1.0)
    assert odometry.odometry.yaw == pytest.approx(-math.pi / 2)
