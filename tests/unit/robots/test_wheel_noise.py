"""Errors of wheel odometry: encoders, wrong dimensions, slip."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.robots.drives.wheel_odometry import OdometryNoise
from gibson_sim.robots.sensor_specs import WheelOdometrySpec

TICK = 2 * math.pi / 4096


def slipped(spec: WheelOdometrySpec, forward: float, turn: float, steps: int, runs: int = 300) -> np.ndarray:
    """Returns (runs, 3): the sums of a motion in equal steps, for different seeds."""
    out = np.zeros((runs, 3))
    for seed in range(runs):
        noise = OdometryNoise(spec, "r", seed)
        out[seed] = sum(np.array(noise.motion(i + 1, forward / steps, 0.0, turn / steps)) for i in range(steps))
    return out


def test_without_errors_nothing_changes() -> None:
    noise = OdometryNoise(WheelOdometrySpec(), "r")
    assert noise.exact
    assert noise.wheels((0.123456789, -0.2)) == (0.123456789, -0.2)
    assert noise.motion(1, 0.1, -0.2, 0.3) == (0.1, -0.2, 0.3)


@pytest.mark.parametrize(
    "error",
    [{"encoder_ticks": 4096}, {"left_radius_factor": 1.01}, {"separation_factor": 0.99}, {"alpha2": 0.1}, {"alpha3": 0.1}],
)
def test_any_error_makes_it_inexact(error: dict[str, float]) -> None:
    assert not OdometryNoise(WheelOdometrySpec(**error), "r").exact  # type: ignore[arg-type]


def test_encoder_is_never_more_than_one_tick_behind() -> None:
    noise = OdometryNoise(WheelOdometrySpec(encoder_ticks=4096), "r")
    true, counted = np.zeros(2), np.zeros(2)
    for increment in np.random.default_rng(1).uniform(-0.01, 0.012, (5000, 2)):
        true += increment
        counted += noise.wheels(increment.tolist())
        assert (true - counted >= -1e-9).all()
        assert (true - counted < TICK + 1e-9).all()


def test_encoder_counts_whole_ticks() -> None:
    noise = OdometryNoise(WheelOdometrySpec(encoder_ticks=4096), "r")
    got = [noise.wheels((0.4 * TICK, -0.4 * TICK)) for _ in range(5)]
    # Forward the third step completes the first tick, the fifth the second; backward the first step already leaves tick 0.
    assert [left / TICK for left, _ in got] == pytest.approx([0, 0, 1, 0, 1])
    assert [right / TICK for _, right in got] == pytest.approx([-1, 0, -1, 0, 0])


def test_after_a_reset_the_encoder_begins_at_0() -> None:
    noise = OdometryNoise(WheelOdometrySpec(encoder_ticks=4096), "r")
    noise.wheels((0.9 * TICK, 0.9 * TICK))
    noise.reset()
    assert noise.wheels((0.9 * TICK, 0.9 * TICK)) == (0.0, 0.0)


def test_wheel_that_is_taken_to_be_larger_seems_to_roll_farther() -> None:
    noise = OdometryNoise(
        WheelOdometrySpec(left_radius_factor=1.02, right_radius_factor=0.99), "r", left=(True, True, False, False)
    )
    assert noise.wheels((1.0, 1.0, 1.0, 1.0)) == pytest.approx((1.02, 1.02, 0.99, 0.99))


def test_separation_that_is_taken_to_be_larger_makes_turns_seem_smaller() -> None:
    assert OdometryNoise(WheelOdometrySpec(separation_factor=1.25), "r").motion(1, 0.5, 0.0, 1.0) == pytest.approx(
        (0.5, 0.0, 0.8)
    )


@pytest.mark.parametrize("steps", [16, 256])
def test_slip_of_a_translation_does_not_depend_on_the_steps(steps: int) -> None:
    # 4 m: the variances are 4 alpha3 m^2 and 4 alpha2 rad^2; 300 runs estimate a standard deviation to 4 %.
    got = slipped(WheelOdometrySpec(alpha2=1e-4, alpha3=9e-4), 4.0, 0.0, steps)
    assert got[:, 0].std() == pytest.approx(2 * 0.03, rel=0.15)
    assert got[:, 2].std() == pytest.approx(2 * 0.01, rel=0.15)
    assert got[:, 0].mean() == pytest.approx(4.0, abs=4 * 0.06 / 17)


@pytest.mark.parametrize("steps", [16, 256])
def test_slip_of_a_rotation_does_not_depend_on_the_steps(steps: int) -> None:
    # -4 rad: the variances are 4 alpha1 rad^2 and 4 alpha4 m^2.
    got = slipped(WheelOdometrySpec(alpha1=1e-4, alpha4=9e-4), 0.0, -4.0, steps)
    assert got[:, 2].std() == pytest.approx(2 * 0.01, rel=0.15)
    assert got[:, 0].std() == pytest.approx(2 * 0.03, rel=0.15)


def test_slip_is_the_same_part_of_the_motion_for_a_metre() -> None:
    noise = OdometryNoise(WheelOdometrySpec(alpha3=0.01), "r")
    parts = [noise.motion(i + 1, 0.125, 0.0, 0.0)[0] / 0.125 for i in range(24)]
    assert [parts.count(part) for part in dict.fromkeys(parts)] == [8, 8, 8]


def test_slip_of_turning_and_driving_are_apart() -> None:
    # A turn in place must not use up the metre.
    spec = WheelOdometrySpec(alpha3=0.01)
    one, other = OdometryNoise(spec, "r"), OdometryNoise(spec, "r")
    one.motion(1, 0.5, 0.0, 0.0)
    other.motion(1, 0.5, 0.0, 0.0)
    other.motion(2, 0.0, 0.0, 0.75)
    assert one.motion(3, 0.25, 0.0, 0.0)[0] == other.motion(3, 0.25, 0.0, 0.0)[0]


def test_after_a_reset_the_same_slip_comes_again() -> None:
    noise = OdometryNoise(WheelOdometrySpec(alpha3=0.01, alpha1=0.01), "r")
    first = [noise.motion(i, 0.25, 0.0, 0.25) for i in range(1, 7)]
    noise.reset()
    assert [noise.motion(i, 0.25, 0.0, 0.25) for i in range(1, 7)] == first


def test_slip_is_along_the_motion() -> None:
    forward, left, _ = OdometryNoise(WheelOdometrySpec(alpha3=0.01), "r").motion(5, 0.3, -0.4, 0.0)
    assert left / forward == pytest.approx(-0.4 / 0.3)
    assert math.hypot(forward, left) != pytest.approx(0.5, abs=1e-6)


def test_robot_that_stands_does_not_slip() -> None:
    noise = OdometryNoise(WheelOdometrySpec(alpha1=0.1, alpha2=0.1, alpha3=0.1, alpha4=0.1), "r")
    assert noise.motion(5, 0.0, 0.0, 0.0) == (0.0, 0.0, 0.0)


def test_slip_depends_on_seeds_name_and_stamp() -> None:
    def slip(name: str, seed: int, stamp_ns: int) -> float:
        return OdometryNoise(WheelOdometrySpec(alpha3=0.01, seed=2), name, seed).motion(stamp_ns, 0.1, 0.0, 0.0)[0]

    assert slip("r", 1, 2) == slip("r", 1, 2)
    assert len({slip("r", 1, 2), slip("r", 1, 3), slip("s", 1, 2), slip("r", 3, 2)}) == 4
