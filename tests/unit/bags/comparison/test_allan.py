"""Allan deviation of noise with a closed-form solution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.imu_noise import allan_curve, noise_model, overlapping_allan

RATE_HZ = 100.0


def white(density: float, seconds: float, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return density * math.sqrt(RATE_HZ) * rng.standard_normal(round(seconds * RATE_HZ))


def walk(strength: float, seconds: float, seed: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.cumsum(strength / math.sqrt(RATE_HZ) * rng.standard_normal(round(seconds * RATE_HZ)))


def test_two_levels_have_the_deviation_computed_by_hand() -> None:
    # Means of two neighbours: 0, 0.5 (overlapping), 1; all pairs at a distance of two differ by 1: sqrt(1 / 2).
    assert overlapping_allan(np.array([0.0, 0.0, 1.0, 1.0]), 1.0, [2])[0] == pytest.approx(math.sqrt(0.5))


def test_alternating_samples_have_the_deviation_computed_by_hand() -> None:
    # Neighbours always differ by 2, so half the mean square is 2.
    assert overlapping_allan(np.array([1.0, -1.0] * 10), 1.0, [1])[0] == pytest.approx(math.sqrt(2.0))


def test_white_noise_falls_with_the_root_of_the_time() -> None:
    found = overlapping_allan(white(0.02, 1000.0), RATE_HZ, [1, 10, 100])
    assert found == pytest.approx([0.02 / math.sqrt(m / RATE_HZ) for m in (1, 10, 100)], rel=0.05)


def test_random_walk_rises_with_the_root_of_the_time() -> None:
    found = overlapping_allan(walk(0.01, 2000.0), RATE_HZ, [100, 1000])
    assert found == pytest.approx([0.01 * math.sqrt(tau / 3.0) for tau in (1.0, 10.0)], rel=0.15)


def test_too_short_a_signal_has_no_deviation() -> None:
    assert math.isnan(overlapping_allan(np.ones(10), 1.0, [6])[0])
    assert allan_curve([np.ones(5)], RATE_HZ) is None


def test_density_and_walk_are_separated() -> None:
    curve = allan_curve([white(0.003, 1200.0, seed) + walk(0.001, 1200.0, seed + 9) for seed in range(3)], RATE_HZ)
    assert curve is not None
    model = noise_model(curve)
    assert model.density == pytest.approx(0.003, rel=0.05)
    assert model.walk == pytest.approx(0.001, rel=0.2)
    assert model.reaches


def test_short_white_noise_shows_no_walk() -> None:
    curve = allan_curve([white(0.003, 10.0, seed) for seed in range(3)], RATE_HZ)
    assert curve is not None
    model = noise_model(curve)
    assert model.density == pytest.approx(0.003, rel=0.05)
    assert model.walk == 0.0


def test_segments_are_weighted_by_their_length() -> None:
    curve = allan_curve([white(0.01, 300.0, 1), white(0.01, 2.0, 5)], RATE_HZ)
    assert curve is not None
    assert curve.deviation[0] == pytest.approx(0.1, rel=0.03)
    assert curve.tau[-1] == pytest.approx(60.0, rel=0.01)


def test_silence_has_no_noise() -> None:
    curve = allan_curve([np.zeros(1000)], RATE_HZ)
    assert curve is not None
    assert noise_model(curve).density == 0.0
