"""A car: wheelbase 0.5 m, wheels of 0.1 m radius, 0.4 m apart, steering joints 0.4 m apart."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.drive_spec import AckermannSpec
from gibson_sim.robots.drives import PlanarVelocity
from gibson_sim.robots.drives.ackermann import (
    AckermannDrive,
    curvature_from_steering,
    feasible_motion,
    rear_speeds,
    steering_angles,
)

CAR = AckermannSpec(
    left_joint="l", right_joint="r", left_steering_joint="sl", right_steering_joint="sr",
    wheel_radius=0.1, wheelbase=0.5, wheel_separation=0.4, steering_separation=0.4,
    max_steering=math.atan(0.625), max_linear=2.0, max_angular=1.5, max_linear_acceleration=1e6, max_steering_rate=1e6,
)  # fmt: skip
"""The inner wheel at its limit is 0.5 m behind and 0.8 m beside the centre of the turn, the centre of the rear axle 1 m: curvature 1."""


def test_both_front_axles_point_at_the_centre_of_the_turn() -> None:
    # 1 m to the left of the centre of the rear axle: 0.8 m from the left wheel, 1.2 m from the right one.
    assert steering_angles(1.0, CAR) == pytest.approx((math.atan(0.5 / 0.8), math.atan(0.5 / 1.2)))


def test_right_turn_is_the_mirror_image() -> None:
    left, right = steering_angles(1.0, CAR)
    assert steering_angles(-1.0, CAR) == pytest.approx((-right, -left))


def test_curvature_undoes_steering() -> None:
    assert curvature_from_steering(*steering_angles(-0.7, CAR), CAR) == pytest.approx(-0.7)


def test_outer_rear_wheel_turns_faster() -> None:
    # 1 m/s at 1 m: 0.8 and 1.2 m/s over 0.1 m.
    assert rear_speeds(1.0, 1.0, CAR) == pytest.approx((8.0, 12.0))


def test_yaw_rate_over_speed_is_the_curvature() -> None:
    assert feasible_motion(PlanarVelocity(1.0, 0.0, 0.5), CAR) == pytest.approx((1.0, 0.5))


def test_in_reverse_the_same_yaw_rate_steers_the_other_way() -> None:
    assert feasible_motion(PlanarVelocity(-1.0, 0.0, 0.5), CAR) == pytest.approx((-1.0, -0.5))


def test_turn_is_never_tighter_than_the_inner_wheel_can_steer() -> None:
    assert CAR.max_curvature == pytest.approx(1.0)
    assert feasible_motion(PlanarVelocity(0.5, 0.0, -3.0), CAR) == pytest.approx((0.5, -1.0))


def test_turning_radius_may_be_limited_further() -> None:
    assert replace(CAR, min_turning_radius=2.0).max_curvature == pytest.approx(0.5)
    assert replace(CAR, min_turning_radius=0.5).max_curvature == pytest.approx(1.0)


def test_speed_is_cut_before_the_path() -> None:
    # At curvature 1 the yaw rate of 1.5 rad/s is reached at 1.5 m/s.
    assert feasible_motion(PlanarVelocity(2.0, 0.0, 2.0), CAR) == pytest.approx((1.5, 1.0))
    assert feasible_motion(PlanarVelocity(-9.0, 0.0, 0.0), CAR) == pytest.approx((-2.0, 0.0))


def test_yaw_rate_without_speed_steers_to_the_end_and_stays() -> None:
    assert feasible_motion(PlanarVelocity(0.0, 0.0, -0.1), CAR) == pytest.approx((0.0, -1.0))


def test_tiny_speed_steers_to_the_end() -> None:
    assert feasible_motion(PlanarVelocity(5e-324, 0.0, 1.0), CAR) == (5e-324, pytest.approx(1.0))


def test_stopping_keeps_the_wheels_as_steered() -> None:
    car = AckermannDrive(CAR)
    before = car.targets(PlanarVelocity(1.0, 0.0, 0.5), 1.0)
    after = car.targets(PlanarVelocity(), 1.0)
    assert after.angles == before.angles == pytest.approx(steering_angles(0.5, CAR))
    assert after.speeds == (0.0, 0.0)


def test_steering_turns_at_its_rate() -> None:
    car = AckermannDrive(replace(CAR, max_steering_rate=0.4))
    car.targets(PlanarVelocity(1.0, 0.0, 1.0), 0.5)
    # 0.2 rad after half a second
    assert car.velocity == pytest.approx((1.0, 0.0, math.tan(0.2) / 0.5))


def test_speed_rises_by_acceleration_times_time() -> None:
    car = AckermannDrive(replace(CAR, max_linear_acceleration=0.5))
    car.targets(PlanarVelocity(1.0), 0.1)
    assert car.velocity.linear == pytest.approx(0.05)


def test_sideways_is_not_obeyed() -> None:
    assert AckermannDrive(CAR).targets(PlanarVelocity(0.0, 1.0, 0.0), 1.0).speeds == (0.0, 0.0)


def test_odometry_of_a_quarter_circle() -> None:
    car = AckermannDrive(CAR)
    quarter = math.pi / 2
    car.advance(*car.travel((quarter * 0.8 / 0.1, quarter * 1.2 / 0.1), steering_angles(1.0, CAR)), 1.0)
    got = car.odometry
    assert (got.x, got.y, got.yaw) == pytest.approx((1.0, 1.0, quarter))


def test_base_in_front_of_the_rear_axle_swings_out() -> None:
    # The base is 0.5 m ahead of an axle that goes a quarter circle of 1 m about (-0.5, 1): it ends 1 m right of that centre...
    car = AckermannDrive(replace(CAR, rear_axle_x=-0.5))
    quarter = math.pi / 2
    car.advance(*car.travel((quarter * 0.8 / 0.1, quarter * 1.2 / 0.1), steering_angles(1.0, CAR)), 1.0)
    got = car.odometry
    # ... and 0.5 m ahead, which is now along y.
    assert (got.x, got.y, got.yaw) == pytest.approx((0.5, 1.5, quarter))
    assert got.lateral == pytest.approx(0.5 * quarter)


def test_steering_beyond_80_degrees_is_refused() -> None:
    with pytest.raises(ConfigError, match="85 degrees"):
        replace(CAR, max_steering=math.radians(85.0))
