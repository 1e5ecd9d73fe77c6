"""Drift of odometry with known errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.drift import drift, fit_alphas, slip_variance
from gibson_sim.bags.comparison.recorded_drive import PlanarTrack
from gibson_sim.robots.drives.base import DeadReckoning
from gibson_sim.robots.drives.wheel_odometry import OdometryNoise
from gibson_sim.robots.sensor_specs import WheelOdometrySpec


def integrated(t: np.ndarray, forward: np.ndarray, turn: np.ndarray) -> PlanarTrack:
    """Returns the track of motions (N - 1,) between the times (N,)."""
    path, rows, yaw = DeadReckoning(), [(0.0, 0.0)], np.concatenate([[0.0], np.cumsum(turn)])
    for way, angle in zip(forward.tolist(), turn.tolist(), strict=True):
        path.add(way, 0.0, angle, 0.02)
        rows.append((path.odometry.x, path.odometry.y))
    x, y = np.array(rows).T
    return PlanarTrack(t, x, y, yaw, np.full(len(t), np.nan), np.full(len(t), np.nan))


T = np.arange(0.0, 60.0, 0.02)
FORWARD = np.full(len(T) - 1, 0.4 * 0.02)
TURN = 0.5 * np.sign(np.sin(2 * np.pi * T[:-1] / 20.0)) * 0.02
TRUTH = integrated(T, FORWARD, TURN)


def test_exact_odometry_does_not_drift() -> None:
    found = drift(TRUTH, TRUTH)
    assert found is not None
    assert (found.scales.forward, found.scales.turn) == pytest.approx((1.0, 1.0))
    assert found.path_m == pytest.approx(0.4 * T[-1], rel=1e-3)
    assert found.end_error_m == pytest.approx(0.0, abs=1e-9)
    assert found.stuck_s == 0.0


def test_scales_and_veer_are_recovered() -> None:
    found = drift(integrated(T, 1.05 * FORWARD, 0.92 * TURN + 0.01 * FORWARD), TRUTH)
    assert found is not None
    assert found.scales.forward == pytest.approx(1.05, rel=1e-3)
    assert found.scales.turn == pytest.approx(0.92, rel=1e-3)
    assert found.scales.veer == pytest.approx(0.01, rel=0.02)


def test_a_wall_that_stops_the_robot_for_a_while_does_not_change_the_scales() -> None:
    stuck = (T[:-1] > 20.0) & (T[:-1] < 30.0)
    truth = integrated(T, np.where(stuck, 0.0, FORWARD), np.where(stuck, 0.1 * TURN, TURN))
    found = drift(integrated(T, 1.05 * FORWARD, 0.92 * TURN), truth)
    assert found is not None
    assert (found.scales.forward, found.scales.turn) == pytest.approx((1.05, 0.92), rel=0.01)
    assert found.stuck_s == pytest.approx(10.0, abs=1.0)


def test_scales_of_a_robot_that_was_stuck_for_most_of_its_drive_are_not_determined() -> None:
    stuck = T[:-1] > 0.5 * T[-1]
    truth = integrated(T, np.where(stuck, 0.0, FORWARD), np.where(stuck, 0.1 * TURN, TURN))
    found = drift(integrated(T, 1.05 * FORWARD, 0.92 * TURN), truth)
    assert found is not None
    assert not found.scales.forward_deviation < 0.05
    assert not found.scales.turn_deviation < 0.05


def test_error_of_a_straight_path_is_its_scale() -> None:
    straight = np.zeros_like(TURN)
    found = drift(integrated(T, 1.03 * FORWARD, straight), integrated(T, FORWARD, straight))
    assert found is not None
    assert found.error_per_m[1.0] == pytest.approx(0.03, rel=0.02)
    assert found.error_per_m[10.0] == pytest.approx(0.03, rel=0.02)
    assert found.end_error_m == pytest.approx(0.03 * found.path_m, rel=0.01)


def test_error_of_turning_in_place_is_its_scale() -> None:
    still, turning = np.zeros_like(FORWARD), np.full(len(TURN), 0.02)
    found = drift(integrated(T, still, 0.95 * turning), integrated(T, still, turning))
    assert found is not None
    assert math.isnan(found.scales.forward)
    assert found.turn_per_rad == pytest.approx(0.05, rel=0.02)
    assert found.end_error_rad == pytest.approx(0.05 * (T[-1] - T[0]), rel=0.01)


def test_start_of_the_truth_does_not_matter() -> None:
    moved = PlanarTrack(
        T, 3.0 - TRUTH.y, 7.0 + TRUTH.x, TRUTH.yaw + math.pi / 2, TRUTH.linear, TRUTH.angular
    )  # turned by 90 degrees, then shifted
    found = drift(TRUTH, moved)
    assert found is not None
    assert found.end_error_m == pytest.approx(0.0, abs=1e-9)


def test_recordings_without_a_common_time_have_no_drift() -> None:
    later = PlanarTrack(T + 100.0, TRUTH.x, TRUTH.y, TRUTH.yaw, TRUTH.linear, TRUTH.angular)
    assert drift(TRUTH, later) is None


def test_variance_of_slip_over_a_segment_is_that_of_blocks() -> None:
    rng = np.random.default_rng(1)
    blocks = np.repeat(rng.standard_normal(20_000), 20) / 20
    for units in (0.5, 1.0, 3.0):
        sums = np.convolve(blocks, np.ones(round(units * 20)), "valid")
        assert float(np.var(sums)) == pytest.approx(float(slip_variance(np.array([units]))[0]), rel=0.05)


def test_random_errors_of_the_simulated_odometry_are_recovered() -> None:
    spec = WheelOdometrySpec(alpha1=4e-4, alpha2=1e-4, alpha3=4e-4, alpha4=1e-4)
    noise = OdometryNoise(spec, "robot", 3)
    seconds, dt = 4800, 0.1
    t = np.arange(0.0, seconds, dt)
    phase = (t[:-1] // 4).astype(int) % 3
    forward = np.where(phase == 1, 0.0, 0.4 * dt)
    turn = np.where(phase == 0, 0.0, 0.8 * dt) * np.sign(np.sin(t[:-1] / 7))
    measured = [noise.motion(i, a, 0.0, b) for i, (a, b) in enumerate(zip(forward.tolist(), turn.tolist(), strict=True))]
    odometry = integrated(t, *np.array([(a, b) for a, _, b in measured]).T)
    found = fit_alphas(odometry, integrated(t, forward, turn))
    assert found is not None
    # Standard deviations, of about 1,300 m and 2,500 rad.
    roots = [math.sqrt(value) for value in (found.alpha1, found.alpha2, found.alpha3, found.alpha4)]
    assert roots == pytest.approx([0.02, 0.01, 0.02, 0.01], rel=0.1)


def test_a_short_drive_does_not_determine_random_errors() -> None:
    short = PlanarTrack(T[:100], TRUTH.x[:100], TRUTH.y[:100], TRUTH.yaw[:100], TRUTH.linear[:100], TRUTH.angular[:100])
    assert fit_alphas(short, short) is None
