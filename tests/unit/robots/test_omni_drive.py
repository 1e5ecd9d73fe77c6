"""Mecanum and omni wheels of 0.05 m radius."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.drive_spec import OmniSpec, OmniWheel
from gibson_sim.robots.drives import PlanarVelocity
from gibson_sim.robots.drives.omni import OmniDrive

Q = math.radians(45.0)


def spec(wheels: Sequence[OmniWheel], **changes: float) -> OmniSpec:
    """Returns a drive without acceleration limits, but for ``changes``."""
    limits = {
        "max_linear": 1.0, "max_lateral": 1.0, "max_angular": 5.0,
        "max_linear_acceleration": 1e6, "max_lateral_acceleration": 1e6, "max_angular_acceleration": 1e6,
    }  # fmt: skip
    return OmniSpec(wheels=tuple(wheels), wheel_radius=0.05, **{**limits, **changes})


MECANUM = spec([
    OmniWheel("front_left", (0.15, 0.25), 0.0, -Q), OmniWheel("front_right", (0.15, -0.25), 0.0, Q),
    OmniWheel("rear_left", (-0.15, 0.25), 0.0, Q), OmniWheel("rear_right", (-0.15, -0.25), 0.0, -Q),
])  # fmt: skip
"""Axles 0.3 m apart, wheels 0.5 m apart."""


def around(number: int, radius: float = 0.2) -> list[OmniWheel]:
    """Returns omni wheels on a circle, the first straight ahead, that all turn the base to the left."""
    angles = [2.0 * math.pi * i / number for i in range(number)]
    return [OmniWheel(f"w{i}", (radius * math.cos(a), radius * math.sin(a)), a + math.pi / 2) for i, a in enumerate(angles)]


def test_mecanum_forward_turns_all_wheels_alike() -> None:
    assert OmniDrive(MECANUM).wheel_speeds(PlanarVelocity(0.5)) == pytest.approx((10.0, 10.0, 10.0, 10.0))


def test_mecanum_left_turns_front_right_and_rear_left_forward() -> None:
    assert OmniDrive(MECANUM).wheel_speeds(PlanarVelocity(0.0, 0.5)) == pytest.approx((-10.0, 10.0, 10.0, -10.0))


def test_mecanum_turns_about_the_sum_of_half_track_and_half_wheelbase() -> None:
    # 1 rad/s (0.15 + 0.25) m / 0.05 m
    assert OmniDrive(MECANUM).wheel_speeds(PlanarVelocity(0.0, 0.0, 1.0)) == pytest.approx((-8.0, 8.0, -8.0, 8.0))


def test_three_omni_wheels_turn_alike_about_the_middle() -> None:
    # 1 rad/s 0.2 m / 0.05 m
    assert OmniDrive(spec(around(3))).wheel_speeds(PlanarVelocity(0.0, 0.0, 1.0)) == pytest.approx((4.0, 4.0, 4.0))


def test_three_omni_wheels_forward() -> None:
    # The front wheel rolls to the left; the others roll at 210 and 330 degrees, so along x by cos of that, +-sqrt(3)/2.
    side = 0.5 * math.sqrt(3) / 2 / 0.05
    assert OmniDrive(spec(around(3))).wheel_speeds(PlanarVelocity(0.5)) == pytest.approx((0.0, -side, side), abs=1e-12)


def test_joint_with_its_axis_to_the_right_turns_backward() -> None:
    wheels = [*MECANUM.wheels[:3], OmniWheel("rear_right", (-0.15, -0.25), math.pi, -Q)]
    assert OmniDrive(spec(wheels)).wheel_speeds(PlanarVelocity(0.5)) == pytest.approx((10.0, 10.0, 10.0, -10.0))


@pytest.mark.parametrize("drive", [MECANUM, spec(around(3)), spec(around(4))], ids=["mecanum", "three", "four"])
def test_body_velocity_undoes_wheel_speeds(drive: OmniSpec) -> None:
    one = OmniDrive(drive)
    assert one.body_velocity(one.wheel_speeds(PlanarVelocity(0.3, -0.2, 0.7))) == pytest.approx((0.3, -0.2, 0.7))


def test_wheels_that_disagree_give_the_best_fit() -> None:
    # x = r (a + b + c + d) / 4; y = r (-a + b + c - d) / 4; yaw = r (-a + b - c + d) / (4 * 0.4 m)
    got = OmniDrive(MECANUM).body_velocity((4.0, 0.0, 0.0, 0.0))
    assert got == pytest.approx((0.05, -0.05, -0.125))


def test_each_direction_has_its_own_limits() -> None:
    drive = OmniDrive(spec(
        MECANUM.wheels, max_linear=0.5, max_lateral=0.3, max_angular=2.0,
        max_linear_acceleration=1.0, max_lateral_acceleration=2.0, max_angular_acceleration=4.0,
    ))  # fmt: skip
    drive.targets(PlanarVelocity(9.0, 9.0, 9.0), 0.1)
    assert drive.velocity == pytest.approx((0.1, 0.2, 0.4))
    drive.targets(PlanarVelocity(9.0, 9.0, 9.0), 10.0)
    assert drive.velocity == (0.5, 0.3, 2.0)


def test_odometry_knows_sideways() -> None:
    drive = OmniDrive(MECANUM)
    drive.advance(*drive.travel((-10.0, 10.0, 10.0, -10.0), ()), 2.0)
    got = drive.odometry
    assert (got.x, got.y, got.yaw, got.linear, got.lateral) == pytest.approx((0.0, 0.5, 0.0, 0.0, 0.25), abs=1e-12)


def test_wheels_without_rollers_across_cannot_go_sideways() -> None:
    # Omni wheels that all roll along x.
    with pytest.raises(ConfigError, match="all directions"):
        spec([OmniWheel(f"w{i}", (0.1 * i, 0.2 * (-1) ** i), 0.0) for i in range(4)])


def test_rollers_along_the_axle_are_refused() -> None:
    with pytest.raises(ConfigError, match="90 degrees"):
        spec([*MECANUM.wheels[:3], OmniWheel("rear_right", (-0.15, -0.25), 0.0, math.pi / 2)])
