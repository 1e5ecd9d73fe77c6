"""Scans of a square room with known errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.bags.comparison.lidar import (
    cast,
    dropout_of,
    lidar_noise,
    residuals_against_map,
    residuals_at_matches,
    resolution_of,
    scan_poses,
)
from gibson_sim.bags.comparison.recorded_drive import OccupancyMap, PlanarTrack, Scans

BEAMS, SCANS = 180, 100
STEP = 2 * math.pi / BEAMS
T = np.arange(SCANS) * 0.1


def exact(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Returns ranges (BEAMS,) in a room from -3 m to 3 m, both ways."""
    x, y = x + mount[0] * math.cos(yaw) - mount[1] * math.sin(yaw), y + mount[0] * math.sin(yaw) + mount[1] * math.cos(yaw)
    angles = yaw + mount[2] + np.arange(BEAMS) * STEP
    with np.errstate(divide="ignore"):
        along_x = np.where(np.cos(angles) > 0, 3.0 - x, -3.0 - x) / np.cos(angles)
        along_y = np.where(np.sin(angles) > 0, 3.0 - y, -3.0 - y) / np.sin(angles)
    return np.minimum(along_x, along_y)


def scans(ranges: np.ndarray, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scans:
    return Scans(T[: len(ranges)], ranges, 0.0, STEP, 0.1, 12.0, mount)


def track(poses: np.ndarray) -> PlanarTrack:
    return PlanarTrack(T, *poses.T, np.full(len(T), np.nan), np.full(len(T), np.nan))


def noisy(sigma: float, dropout: float = 0.0, step: float = 0.0) -> Scans:
    rng = np.random.default_rng(4)
    ranges = exact() + sigma * rng.standard_normal((SCANS, BEAMS))
    if step:
        ranges = np.rint(ranges / step) * step
    ranges[rng.random(ranges.shape) < dropout] = np.inf
    return scans(ranges)


def test_noise_and_dropout_at_rest_are_recovered() -> None:
    found = lidar_noise(noisy(0.012, 0.02), [(0.0, 10.0)])
    assert found.range_noise == pytest.approx(0.012, rel=0.03)
    assert found.dropout == pytest.approx(0.02, rel=0.1)


def test_steps_of_the_range_are_not_counted_as_noise() -> None:
    found = lidar_noise(noisy(0.012, step=0.02), [(0.0, 10.0)])
    assert found.resolution == 0.02
    assert found.range_noise == pytest.approx(0.012, rel=0.05)


def test_noise_is_unknown_without_rest() -> None:
    assert math.isnan(lidar_noise(noisy(0.01), []).range_noise)


def test_continuous_ranges_have_no_resolution() -> None:
    assert resolution_of(noisy(0.01).ranges) == 0.0


def test_a_beam_that_leaves_the_room_is_no_dropout() -> None:
    ranges = np.tile(exact(), (SCANS, 1))
    ranges[:, 40:60] = np.inf
    assert dropout_of(ranges)[0] == pytest.approx(0.0)


def test_scan_against_a_map_shows_its_bias() -> None:
    occupied = np.zeros((140, 140), dtype=bool)
    occupied[10] = occupied[129] = occupied[:, 10] = occupied[:, 129] = True
    # Walls fill cells whose middle is 2.975 m from the centre: their inner faces are there to half a cell.
    grid = OccupancyMap(occupied, 0.05, (-3.5, -3.5))
    assert cast(grid, (0.0, 0.0), np.array([0.0, math.pi / 2]), 10.0) == pytest.approx([2.975, 2.975], abs=0.03)
    still = track(np.zeros((SCANS, 3)))
    found, shifted = (residuals_against_map(scans(np.tile(exact(), (SCANS, 1)) + bias), still, grid) for bias in (0.0, 0.04))
    assert found is not None
    assert shifted is not None
    assert found.bias == pytest.approx(0.0, abs=0.05)
    assert shifted.bias - found.bias == pytest.approx(0.04, abs=1e-9)


def test_beam_beyond_the_map_hits_nothing() -> None:
    grid = OccupancyMap(np.zeros((10, 10), dtype=bool), 0.1, (0.0, 0.0))
    assert cast(grid, (0.5, 0.5), np.array([1.0]), 5.0).tolist() == [math.inf]


def test_scans_at_nearly_the_same_pose_differ_by_the_bias_alone() -> None:
    mount = (0.1, 0.0, 0.3)
    a, b = (0.50, 0.20, 0.10), (0.53, 0.18, 0.13)
    real = scans(exact(*a, mount=mount)[None] + 0.025, mount)
    sim = scans(exact(*b, mount=mount)[None], mount)
    found = residuals_at_matches(real, np.array([a]), sim, np.array([b]), np.array([[0, 0]]))
    assert found is not None
    assert found.bias == pytest.approx(0.025, abs=1e-3)
    assert found.spread < 2e-3


def test_no_matches_give_no_residuals() -> None:
    one = scans(exact()[None])
    assert residuals_at_matches(one, np.zeros((1, 3)), one, np.zeros((1, 3)), np.zeros((0, 2), dtype=np.intp)) is None


def test_scan_outside_the_track_has_no_pose() -> None:
    poses = scan_poses(scans(np.tile(exact(), (SCANS, 1))), PlanarTrack(*(np.arange(2.0),) * 6))
    assert np.isfinite(poses[:11]).all()
    assert np.isnan(poses[11:]).all()
