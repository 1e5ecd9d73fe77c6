"""The drive model is recovered from odometry of the simulator's own model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.bags.comparison.encoder import common_step, fit_ticks
from gibson_sim.bags.comparison.identify import (
    DriveFit,
    commanded_velocities,
    counted_velocities,
    fit_drive,
    limited_velocities,
    with_limits,
)
from gibson_sim.bags.comparison.parameters import CERTAINTY
from gibson_sim.bags.comparison.recorded_drive import Commands, PlanarTrack
from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.robots.drives import PlanarVelocity, make_drive
from gibson_sim.robots.path_tracking import ScriptedDrive
from gibson_sim.robots.sensor_specs import WheelOdometrySpec

HZ = 240
DRIVE = DifferentialSpec(left_joints=("l",), right_joints=("r",), wheel_radius=0.05, wheel_separation=0.4)
SCRIPT = ScriptedDrive(
    ((0.0, 0.0, 1.0), (0.3, 0.0, 1.5), (-0.2, 0.0, 1.5), (0.0, 0.0, 1.0), (0.0, 1.0, 1.5), (0.0, -1.5, 1.5), (0.35, 0.7, 2.0),
     (0.13, -0.4, 2.0), (0.0, 0.0, 1.0))
)  # fmt: skip
SENT = np.arange(0.0, SCRIPT.duration, 0.05)
COMMANDS = Commands(SENT, *np.array([SCRIPT.command(t) for t in SENT.tolist()]).T)


def odometry(
    spec: DifferentialSpec, gains: tuple[float, float] = (1.0, 1.0), ticks: int = 0, commands: Commands = COMMANDS
) -> PlanarTrack:
    """Returns odometry at 60 Hz of a robot with this drive, delay included, whose odometry has the scales ``gains``."""
    t, linear, angular = commanded_velocities(commands, 0.0, SCRIPT.duration, HZ, 0.5)
    linear, angular = limited_velocities(spec, linear, angular, 1.0 / HZ)
    if ticks:
        free = with_limits(spec, 1e9, 1e9)
        linear, angular = counted_velocities(free, WheelOdometrySpec(encoder_ticks=ticks), linear, angular, HZ)
    rows = slice(3, None, 4)
    nothing = np.zeros(len(t[rows]))
    return PlanarTrack(t[rows] + 1.0 / HZ, nothing, nothing, nothing, gains[0] * linear[rows], gains[1] * angular[rows])


def fitted(spec: DifferentialSpec, track: PlanarTrack) -> DriveFit:
    found = fit_drive(spec, COMMANDS, track)
    assert found is not None
    return found


def test_delay_limits_and_gains_are_recovered() -> None:
    real = replace(DRIVE, max_linear_acceleration=0.7, max_angular_acceleration=2.2, command_delay=0.1)
    found = fitted(DRIVE, odometry(real, (0.95, 1.08)))
    assert found.delay.value == pytest.approx(0.1, rel=0.05)
    assert found.linear_acceleration is not None
    assert found.linear_acceleration.value == pytest.approx(0.7, rel=0.02)
    assert found.angular_acceleration is not None
    assert found.angular_acceleration.value == pytest.approx(2.2, rel=0.02)
    assert found.linear_gain is not None
    assert found.linear_gain.value == pytest.approx(0.95, rel=0.01)
    assert found.angular_gain is not None
    assert found.angular_gain.value == pytest.approx(1.08, rel=0.01)


@pytest.mark.parametrize("seed", range(6))
def test_estimates_are_within_their_uncertainty_where_command_times_are_rounded_to_clock_ticks(seed: int) -> None:
    obeyed = SENT + np.random.default_rng(seed).uniform(0.0, 0.02, len(SENT))
    noted = replace(COMMANDS, t=np.floor(obeyed * 100.0) / 100.0)
    found = fit_drive(DRIVE, noted, odometry(DRIVE, commands=replace(COMMANDS, t=obeyed)))
    assert found is not None
    for estimate, true in ((found.linear_acceleration, 1.0), (found.angular_acceleration, 4.0), (found.linear_gain, 1.0)):
        assert estimate is not None
        assert abs(estimate.value - true) < CERTAINTY * estimate.deviation < 0.2 * true


def test_a_single_step_does_not_determine_a_limit() -> None:
    once = Commands(SENT, np.where(SENT < 5.0, 0.0, 0.3), np.zeros(len(SENT)))
    found = fit_drive(DRIVE, once, odometry(DRIVE, commands=once))
    assert found is not None
    assert found.linear_acceleration is None


def test_ticks_of_the_encoder_are_recovered() -> None:
    track = odometry(DRIVE, ticks=1500)
    ticks = fit_ticks(DRIVE, fitted(DRIVE, track), track)
    assert ticks is not None
    assert ticks.value == pytest.approx(1500, rel=0.1)


def test_averaged_odometry_gets_ticks_of_the_same_noise() -> None:
    track = odometry(DRIVE, ticks=1500)
    smooth = replace(
        track,
        linear=np.convolve(track.linear, np.ones(3) / 3, "same"),
        angular=np.convolve(track.angular, np.ones(3) / 3, "same"),
    )
    ticks = fit_ticks(DRIVE, fitted(DRIVE, smooth), smooth)
    assert ticks is not None
    assert 1500 < ticks.value < 6000


def test_common_step_of_multiples_is_found_among_small_errors() -> None:
    rng = np.random.default_rng(1)
    values = 0.37 * rng.integers(1, 12, 400) + 0.01 * rng.standard_normal(400)
    assert common_step(values, 0.01, 10.0) == pytest.approx(0.37, rel=0.01)
    assert common_step(rng.uniform(0.0, 5.0, 400), 0.01, 10.0) is None


def test_exact_odometry_has_no_ticks() -> None:
    track = odometry(DRIVE)
    assert fit_ticks(DRIVE, fitted(DRIVE, track), track) is None


def test_an_instant_drive_has_no_acceleration_limit() -> None:
    track = odometry(replace(DRIVE, max_linear_acceleration=1000.0, max_angular_acceleration=4000.0))
    assert fitted(DRIVE, track).linear_acceleration is None


def test_a_robot_that_never_turns_does_not_determine_turning() -> None:
    straight = Commands(COMMANDS.t, COMMANDS.linear, np.zeros(len(SENT)))
    track = odometry(DRIVE)
    found = fit_drive(DRIVE, straight, replace(track, angular=np.zeros(len(track.t))))
    assert found is not None
    assert found.angular_gain is None
    assert found.angular_acceleration is None


def test_no_commands_determine_nothing() -> None:
    still = Commands(COMMANDS.t, np.zeros(len(SENT)), np.zeros(len(SENT)))
    assert fit_drive(DRIVE, still, odometry(DRIVE)) is None


def test_the_model_equals_the_drive_step_by_step() -> None:
    linear, angular = np.array([0.3] * 40 + [-0.1] * 40), np.array([0.0] * 20 + [1.0] * 60)
    drive, out = make_drive(DRIVE), []
    for a, b in zip(linear.tolist(), angular.tolist(), strict=True):
        drive.targets(PlanarVelocity(a, 0.0, b), 0.01)
        out.append((drive.velocity.linear, drive.velocity.angular))
    assert np.stack(limited_velocities(DRIVE, linear, angular, 0.01), axis=1) == pytest.approx(np.array(out))
