"""Held values, runs of true, rest."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.bags.comparison.imu_noise import imu_noise
from gibson_sim.bags.comparison.recorded_drive import Commands, ImuSamples, PlanarTrack
from gibson_sim.bags.comparison.signals import held, rests, speeds, stretches
from gibson_sim.robots.drives import active_command
from gibson_sim.types import NS_PER_S, VelocityCommand

T = np.arange(0.0, 30.0, 0.01)
MOVES = (T > 10.0) & (T < 20.0)


def imu(gyro_noise: float = 1e-3, bias: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ImuSamples:
    """Returns 30 s of samples at 100 Hz; the robot shakes and turns from 10 s to 20 s."""
    rng = np.random.default_rng(0)
    gyro = gyro_noise * rng.standard_normal((len(T), 3)) + bias
    accel = 0.02 * rng.standard_normal((len(T), 3)) + (0.0, 0.0, 9.81)
    gyro[MOVES, 2] += 0.5
    accel[MOVES] += 0.5 * rng.standard_normal((int(MOVES.sum()), 3))
    return ImuSamples(T, gyro, accel)


def track() -> PlanarTrack:
    speed = np.where(MOVES, 0.3, 0.0)
    return PlanarTrack(T, np.cumsum(speed) * 0.01, 0 * T, 0 * T, speed, 0 * T)


def test_last_value_is_held_until_its_time_out() -> None:
    found = held(np.array([1.0, 2.0]), np.array([5.0, 6.0]), np.array([0.9, 1.0, 1.99, 2.5, 2.51]), 0.5)
    assert found.tolist() == [0.0, 5.0, 0.0, 6.0, 0.0]


def test_holding_equals_a_robots_handling_of_commands() -> None:
    for now in (0.3, 1.0, 1.2, 1.5, 1.6):
        command = VelocityCommand((0.4, 0.0, 0.0), (0.0, 0.0, 0.0), NS_PER_S) if now >= 1.0 else None
        wanted = active_command(command, round(now * NS_PER_S), NS_PER_S // 2).linear
        assert held(np.array([1.0]), np.array([0.4]), np.array([now]), 0.5)[0] == wanted


def test_intervals_are_runs_of_true() -> None:
    assert stretches(np.array([True, True, False, True])) == [(0, 2), (3, 4)]


def test_rest_is_found_by_imu_and_wheels() -> None:
    found = rests(imu(), track())
    assert len(found) == 2
    assert found[0] == pytest.approx((0.5, 9.5), abs=0.4)
    assert found[1] == pytest.approx((20.5, 29.5), abs=0.4)


def test_rest_is_found_by_the_imu_alone() -> None:
    assert [round(b - a) for a, b in rests(imu(), None)] == [9, 9]


def test_commanded_robot_does_not_rest() -> None:
    asked = np.full(len(T), 0.2)
    assert rests(imu(), track(), Commands(T, asked, 0 * asked)) == []


def test_noise_and_bias_at_rest_are_recovered() -> None:
    samples = imu(gyro_noise=2e-3, bias=(0.01, -0.02, 0.03))
    found = imu_noise(samples, rests(samples, track()))
    assert found is not None
    assert found.rate_hz == pytest.approx(100.0)
    assert found.gyro.density == pytest.approx(2e-3 / 10.0, rel=0.05)
    assert found.accel.density == pytest.approx(2e-2 / 10.0, rel=0.05)
    assert found.gyro_bias == pytest.approx((0.01, -0.02, 0.03), abs=3e-4)
    assert found.accel_bias == pytest.approx((0.0, 0.0, 0.0), abs=3e-3)


def test_speeds_come_from_poses_where_the_source_has_none() -> None:
    yaw = np.full(len(T), np.pi / 3)
    nothing = np.full(len(T), np.nan)
    forward, turning = speeds(PlanarTrack(T, 0.2 * T * np.cos(yaw), 0.2 * T * np.sin(yaw), yaw, nothing, nothing))
    assert forward == pytest.approx(np.full(len(T), 0.2))
    assert turning == pytest.approx(np.zeros(len(T)))
