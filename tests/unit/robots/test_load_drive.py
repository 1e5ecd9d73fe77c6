"""The drive section of robot.yaml, on a cart with six joints: wheels of 0.05 m at the corners, two steering joints in front."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.errors import RobotError
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec, OmniSpec
from gibson_sim.robots.load import load_robot

Load = Callable[[str], DriveSpec]


def joint(name: str, kind: str, xyz: str, axis: str, extra: str = "", parent: str = "base") -> str:
    return (
        f'<link name="{name}_link"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{extra}</joint>'
    )


LIMIT = '<limit lower="-0.7" upper="0.5" effort="5" velocity="2"/>'
URDF = (
    '<robot name="cart"><link name="base"/>'
    + joint("fl", "continuous", "0.3 0.2 0.05", "0 1 0")
    + joint("fr", "continuous", "0.3 -0.2 0.05", "0 -1 0")
    + joint("rl", "continuous", "-0.1 0.2 0.05", "0 1 0")
    + joint("rr", "continuous", "-0.1 -0.2 0.05", "0 -1 0")
    + joint("front", "continuous", "0.3 0 0.05", "1 0 0")
    + joint("pin_left", "revolute", "0.3 0.15 0.05", "0 0 1", LIMIT)
    + joint("pin_right", "revolute", "0.3 -0.15 0.05", "0 0 -1", LIMIT)
    + "</robot>"
)
SKID = "type: skid_steer, left_joints: [fl, rl], right_joints: [fr, rr]"
CAR = "type: ackermann, left_joint: rl, right_joint: rr, left_steering_joint: pin_left, right_steering_joint: pin_right"
OMNI = "type: omni, wheels: [{joint: fl, roller_deg: -45}, {joint: rr, roller_deg: -45}, {joint: front}]"


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(drive: str) -> DriveSpec:
        (tmp_path / "cart.urdf").write_text(URDF)
        (tmp_path / "robot.yaml").write_text(f"urdf: cart.urdf\nradius: 0.4\nheight: 0.1\ndrive: {{{drive}}}\n")
        drive_spec = load_robot(tmp_path).drive
        assert drive_spec is not None
        return drive_spec

    return _load


def test_skid_steer_is_measured_in_the_urdf(load: Load) -> None:
    drive = load(SKID)
    assert isinstance(drive, DifferentialSpec)
    assert (drive.kind, drive.wheel_radius, drive.wheel_separation) == ("skid_steer", 0.05, pytest.approx(0.4))
    assert (drive.left_signs, drive.right_signs) == ((1.0, 1.0), (-1.0, -1.0))


def test_separation_factor_widens_what_is_measured(load: Load) -> None:
    drive = load(SKID + ", separation_factor: 1.5")
    assert isinstance(drive, DifferentialSpec)
    assert drive.wheel_separation == pytest.approx(0.6)


def test_separation_may_be_given(load: Load) -> None:
    drive = load(SKID + ", wheel_separation: 0.7")
    assert isinstance(drive, DifferentialSpec)
    assert drive.wheel_separation == pytest.approx(0.7)


def test_omni_wheels_stand_as_in_the_urdf(load: Load) -> None:
    drive = load(OMNI)
    assert isinstance(drive, OmniSpec)
    left, right, front = drive.wheels
    assert (left.joint, left.position, left.roller) == ("fl", pytest.approx((0.3, 0.2)), pytest.approx(-math.pi / 4))
    assert left.heading == pytest.approx(0.0)
    # An axis to the right: a positive turn rolls backward.
    assert abs(right.heading) == pytest.approx(math.pi)
    # An axis forward: a positive turn rolls to the right.
    assert (front.heading, front.roller) == (pytest.approx(-math.pi / 2), 0.0)


def test_sideways_limits_are_those_of_forward_unless_given(load: Load) -> None:
    drive = load(OMNI + ", max_linear: 0.9, max_linear_acceleration: 3, max_lateral_acceleration: 2")
    assert isinstance(drive, OmniSpec)
    assert (drive.max_lateral, drive.max_lateral_acceleration) == (0.9, 2.0)


def test_car_is_measured_in_the_urdf(load: Load) -> None:
    drive = load(CAR)
    assert isinstance(drive, AckermannSpec)
    assert (drive.wheelbase, drive.wheel_separation, drive.steering_separation) == pytest.approx((0.4, 0.4, 0.3))
    assert drive.rear_axle_x == pytest.approx(-0.1)
    assert (drive.left_sign, drive.right_sign, drive.left_steering_sign, drive.right_steering_sign) == (1.0, -1.0, 1.0, -1.0)
    # The nearer of the two ends.
    assert drive.max_steering == pytest.approx(0.5)


def test_steering_angle_is_in_degrees(load: Load) -> None:
    drive = load(CAR + ", max_steering_deg: 20")
    assert isinstance(drive, AckermannSpec)
    assert drive.max_steering == pytest.approx(math.radians(20.0))


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ("type: skid_steer, left_joint: fl, right_joint: fr", "did you mean 'left_joints'"),
        ("type: skid_steer, left_joints: fl, right_joints: [fr]", "left_joints is 'fl', must be a list of joint names"),
        ("type: skid_steer, left_joints: [fl, rl], right_joints: [fr]", "2 left and 1 right wheels"),
        ("type: skid_steer, left_joints: [fr], right_joints: [fl]", "swapped"),
        (SKID + ", separation_factor: 0", "separation_factor is 0, must be above 0"),
        (SKID + ", traction: -1", "traction"),
        ("type: omni, wheels: []", "must be a list of {joint: .., roller_deg: ..}"),
        ("type: omni, wheels: [{joint: fl, roller: 45}]", "wheels[0]: key 'roller' is unknown; did you mean 'roller_deg'"),
        ("type: omni, wheels: [{joint: pin_left}]", "with a level axis"),
        ("type: omni, wheels: [{joint: fl}, {joint: fr}, {joint: rl}]", "all directions"),
        ("type: ackermann, left_joint: rl, right_joint: rr", "left_steering_joint is missing"),
        (CAR.replace("pin_left", "fl"), "cannot steer"),
        (CAR.replace("rl", "nothing"), "no joint 'nothing'"),
        (CAR + ", max_steering_deg: 35", "max_steering_deg is 35, the limits of the joints allow 28.6"),
        (CAR + ", max_angular_acceleration: 1", "key 'max_angular_acceleration' is unknown"),
        (CAR + ", min_turning_radius: -1", "min_turning_radius"),
    ],
)
def test_wrong_drive_is_refused_in_one_line(load: Load, drive: str, words: str) -> None:
    with pytest.raises(RobotError) as error:
        load(drive)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("gibson_bot", "differential"), ("skid_bot", "skid_steer"), ("omni_bot", "omni"), ("ackermann_bot", "ackermann")],
)
def test_our_robots_show_all_kinds(root: Path, name: str, kind: str) -> None:
    drive = load_robot(root / "config/robots" / name).drive
    assert drive is not None
    assert drive.kind == kind
