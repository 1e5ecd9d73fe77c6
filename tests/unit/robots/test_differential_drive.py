"""Wheels and body of a differential drive and of skid steer; wheels of 0.05 m radius, 0.4 m apart."""

from __future__ import annotations

import math

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.drives import PlanarVelocity, active_command, make_drive
from gibson_sim.robots.drives.base import DeadReckoning
from gibson_sim.robots.drives.differential import body_velocity, limit_velocity, wheel_speeds
from gibson_sim.types import Odometry, VelocityCommand

DRIVE = DifferentialSpec(
    left_joints=("l",), right_joints=("r",), wheel_radius=0.05, wheel_separation=0.4, max_linear=0.5, max_angular=2.0,
    max_linear_acceleration=1.0, max_angular_acceleration=4.0,
)  # fmt: skip


def moved(*turns: tuple[float, float], dt: float = 1.0) -> Odometry:
    """Returns the odometry after wheels (left, right) rolled forward by these angles, ``dt`` seconds each."""
    drive = make_drive(DRIVE)
    for increments in turns:
        drive.advance(*drive.travel(increments, ()), dt)
    return drive.odometry


def test_forward_turns_both_wheels_equally() -> None:
    assert wheel_speeds(0.5, 0.0, DRIVE) == pytest.approx((10.0, 10.0))


def test_left_turn_rolls_the_left_wheel_back_and_the_right_one_forward() -> None:
    # 1 rad/s at 0.2 m is 0.2 m/s, over 0.05 m radius 4 rad/s.
    assert wheel_speeds(0.0, 1.0, DRIVE) == pytest.approx((-4.0, 4.0))


def test_faster_right_wheel_turns_the_body_left() -> None:
    assert body_velocity(2.0, 6.0, DRIVE) == pytest.approx((0.2, 0.0, 0.5))


def test_body_velocity_undoes_wheel_speeds() -> None:
    assert body_velocity(*wheel_speeds(0.3, -0.7, DRIVE), DRIVE) == pytest.approx((0.3, 0.0, -0.7))


def test_speed_rises_by_acceleration_times_time() -> None:
    assert limit_velocity(PlanarVelocity(0.1), PlanarVelocity(0.5, 0.0, 2.0), DRIVE, 0.1) == pytest.approx((0.2, 0.0, 0.4))


def test_braking_obeys_the_same_limit() -> None:
    assert limit_velocity(PlanarVelocity(0.3, 0.0, -1.0), PlanarVelocity(), DRIVE, 0.1) == pytest.approx((0.2, 0.0, -0.6))


def test_requested_speed_is_limited_to_the_maximum() -> None:
    assert limit_velocity(PlanarVelocity(0.49, 0.0, -1.99), PlanarVelocity(9.0, 0.0, -9.0), DRIVE, 1.0) == (0.5, 0.0, -2.0)


def test_limited_speed_arrives_exactly_at_zero() -> None:
    assert limit_velocity(PlanarVelocity(0.003, 0.0, -0.01), PlanarVelocity(), DRIVE, 0.01) == (0.0, 0.0, 0.0)


def test_limiting_does_not_alter_the_command() -> None:
    wanted = PlanarVelocity(9.0, 9.0, 9.0)
    limit_velocity(PlanarVelocity(), wanted, DRIVE, 0.1)
    assert wanted == (9.0, 9.0, 9.0)


def test_wheels_that_cannot_roll_sideways_do_not_try() -> None:
    assert limit_velocity(PlanarVelocity(), PlanarVelocity(0.0, 0.5, 0.0), DRIVE, 1.0) == (0.0, 0.0, 0.0)


def test_fresh_command_is_obeyed_to_its_last_nanosecond() -> None:
    command = VelocityCommand((0.2, 0.1, 9.0), (9.0, 9.0, 0.3), stamp_ns=100)
    assert active_command(command, 600, 500) == (0.2, 0.1, 0.3)


def test_stale_command_is_zero() -> None:
    command = VelocityCommand((0.2, 0.0, 0.0), (0.0, 0.0, 0.3), stamp_ns=100)
    assert active_command(command, 601, 500) == (0.0, 0.0, 0.0)


def test_no_command_is_zero() -> None:
    assert active_command(None, 0, 500) == (0.0, 0.0, 0.0)


def test_odometry_of_a_straight_line() -> None:
    got = moved((10.0, 10.0), dt=2.0)
    assert (got.x, got.y, got.yaw, got.linear, got.angular) == pytest.approx((0.5, 0.0, 0.0, 0.25, 0.0))


def test_odometry_of_a_quarter_circle_in_one_update_is_exact() -> None:
    # A left turn of 90 degrees about a point 1 m to the left: the wheels run on radii 0.8 and 1.2 m.
    got = moved((0.8 * math.pi / 2 / 0.05, 1.2 * math.pi / 2 / 0.05))
    assert (got.x, got.y, got.yaw) == pytest.approx((1.0, 1.0, math.pi / 2))


def test_odometry_turns_before_it_goes_on() -> None:
    quarter = math.pi / 2 * 0.2 / 0.05
    got = moved((-quarter, quarter), (20.0, 20.0))
    assert (got.x, got.y, got.yaw) == pytest.approx((0.0, 1.0, math.pi / 2), abs=1e-12)


def test_odometry_yaw_stays_within_half_a_turn() -> None:
    got = moved(*[(-math.pi / 2 * 4, math.pi / 2 * 4)] * 3)
    assert got.yaw == pytest.approx(-math.pi / 2)


def test_dead_reckoning_of_a_sideways_quarter_circle_is_exact() -> None:
    # The base moves to its left while it turns left: about a point 1 m behind it, from (0, 0) to (-1, 1).
    path = DeadReckoning()
    path.add(0.0, math.pi / 2, math.pi / 2, 0.5)
    got = path.odometry
    assert (got.x, got.y, got.yaw) == pytest.approx((-1.0, 1.0, math.pi / 2))
    assert (got.linear, got.lateral, got.angular) == pytest.approx((0.0, math.pi, math.pi))


SKID = DifferentialSpec(
    kind="skid_steer", left_joints=("l1", "l2"), right_joints=("r1", "r2"), wheel_radius=0.05, wheel_separation=0.4,
    max_linear=0.5, max_angular=2.0, max_linear_acceleration=100.0, max_angular_acceleration=100.0,
)  # fmt: skip


def test_wheels_of_one_side_turn_alike() -> None:
    drive = make_drive(SKID)
    targets = drive.targets(PlanarVelocity(0.5, 0.0, 1.0), 1.0)
    # 0.5 -+ 0.2 m/s over 0.05 m
    assert dict(zip([joint.name for joint in drive.wheels], targets.speeds, strict=True)) == pytest.approx(
        {"l1": 6.0, "l2": 6.0, "r1": 14.0, "r2": 14.0}
    )


def test_skid_odometry_takes_the_mean_of_each_side() -> None:
    drive = make_drive(SKID)
    turned = {"l1": 1.0, "l2": 3.0, "r1": 7.0, "r2": 5.0}
    # Sides: 2 and 6 rad; 0.05 m (2 + 6) / 2, and 0.05 m (6 - 2) / 0.4 m
    assert drive.travel([turned[joint.name] for joint in drive.wheels], ()) == pytest.approx((0.2, 0.0, 0.5))


def test_only_skid_steer_moves_the_base_by_a_servo() -> None:
    assert make_drive(SKID).servo is not None
    assert make_drive(DRIVE).servo is None


def test_uneven_numbers_of_wheels_are_refused() -> None:
    with pytest.raises(ConfigError, match="2 left and 1 right"):
        DifferentialSpec(left_joints=("a", "b"), right_joints=("c",), wheel_radius=0.05, wheel_separation=0.4)


def test_joint_with_two_tasks_is_refused() -> None:
    with pytest.raises(ConfigError, match="'a' is named twice"):
        DifferentialSpec(left_joints=("a",), right_joints=("a",), wheel_radius=0.05, wheel_separation=0.4)
