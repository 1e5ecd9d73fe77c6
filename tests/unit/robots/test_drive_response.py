"""Delay and slip of drives: wheels of 0.05 m, 0.4 m apart."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, OmniSpec, OmniWheel
from gibson_sim.robots.drives import PlanarVelocity, make_drive
from gibson_sim.robots.drives.base import CommandDelay

DRIVE = DifferentialSpec(left_joints=("l",), right_joints=("r",), wheel_radius=0.05, wheel_separation=0.4)
SKID = replace(DRIVE, kind="skid_steer")
CAR = AckermannSpec(
    left_joint="l", right_joint="r", left_steering_joint="pl", right_steering_joint="pr", wheel_radius=0.05, wheelbase=0.4,
    wheel_separation=0.3, steering_separation=0.3, max_steering=0.6,
)  # fmt: skip
OMNI = OmniSpec(
    wheels=tuple(OmniWheel(str(i), xy, heading) for i, (xy, heading) in enumerate([((0.2, 0.0), 1.57), ((-0.1, 0.17), 3.67), ((-0.1, -0.17), 5.76)])),
    wheel_radius=0.05,
)  # fmt: skip
DT = 0.01
FORWARD = PlanarVelocity(0.5)


def test_delay_passes_commands_on_after_its_time() -> None:
    delay = CommandDelay(0.03)
    out = [delay.delayed(PlanarVelocity(float(i)), DT).linear for i in range(1, 7)]
    assert out == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]


def test_no_delay_passes_commands_on_at_once() -> None:
    assert CommandDelay(0.0).delayed(FORWARD, DT) is FORWARD


@pytest.mark.parametrize("spec", [DRIVE, SKID, CAR, OMNI])
def test_delayed_drive_does_the_same_later(spec: DifferentialSpec | AckermannSpec | OmniSpec) -> None:
    prompt, late = make_drive(spec), make_drive(replace(spec, command_delay=0.05))
    wanted = PlanarVelocity(0.4, 0.0, 0.5)
    first = [prompt.targets(wanted, DT) for _ in range(20)]
    second = [late.targets(wanted, DT) for _ in range(25)]
    assert second[5:] == first


def test_wheels_that_push_the_base_turn_less_by_the_slip() -> None:
    drive = make_drive(replace(DRIVE, slip=0.1, turn_slip=0.2, max_linear_acceleration=1e3, max_angular_acceleration=1e3))
    assert drive.targets(PlanarVelocity(0.5), DT).speeds == pytest.approx((9.0, 9.0))
    # 1 rad/s at 0.2 m is 4 rad/s of the wheels; four fifths remain.
    assert drive.targets(PlanarVelocity(0.0, 0.0, 1.0), DT).speeds == pytest.approx((-3.2, 3.2))


def test_encoders_see_what_the_wheels_would_have_turned() -> None:
    drive = make_drive(replace(DRIVE, slip=0.1, turn_slip=0.2, max_linear_acceleration=1e3, max_angular_acceleration=1e3))
    speeds = drive.targets(PlanarVelocity(0.5, 0.0, 1.0), DT).speeds
    assert drive.travel(drive.encoder_turns(speeds), ()) == pytest.approx((0.5, 0.0, 1.0))


def test_a_car_loses_way_but_not_its_path() -> None:
    car = make_drive(replace(CAR, slip=0.1, max_linear_acceleration=1e3))
    speeds = car.targets(FORWARD, DT).speeds
    assert speeds == pytest.approx((9.0, 9.0))
    assert car.encoder_turns(speeds) == pytest.approx((10.0, 10.0))


@pytest.mark.parametrize("spec", [SKID, OMNI])
def test_a_base_on_a_servo_goes_less_while_its_wheels_turn_in_full(spec: DifferentialSpec | OmniSpec) -> None:
    drive, exact = make_drive(replace(spec, slip=0.1, turn_slip=0.2)), make_drive(spec)
    wanted = PlanarVelocity(0.4, 0.0, 0.5)
    for _ in range(100):
        speeds, expected = drive.targets(wanted, DT).speeds, exact.targets(wanted, DT).speeds
    assert speeds == expected
    assert drive.base_velocity == pytest.approx((0.36, 0.0, 0.4))


def test_a_drive_without_slip_follows_its_commands() -> None:
    drive = make_drive(DRIVE)
    drive.targets(FORWARD, DT)
    assert drive.base_velocity == drive.velocity
    assert drive.encoder_turns((0.1, 0.2)) == (0.1, 0.2)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"command_delay": -0.1}, "command_delay is -0.1 s, must be 0 to 10"),
        ({"command_delay": 50.0}, "given in milliseconds"),
        ({"slip": 1.0}, "slip is 1.0, must be -0.5 to 0.9"),
        ({"turn_slip": float("nan")}, "turn_slip is nan"),
    ],
)
def test_impossible_responses_are_refused(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        replace(DRIVE, **wrong)
