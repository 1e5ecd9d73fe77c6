"""Occupancy grid: obstacles stay in it, free floor clears it, the recorded path has a free prior."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.obstacles.occupancy import OccupancyGrid, OccupancySettings, _distance_to_zero

F64 = NDArray[np.float64]
BEARINGS = np.arctan((1.0 - (np.arange(24) + 0.5) / 12.0) * math.tan(math.radians(50.0)))
EDGES = np.arange(61, dtype=np.float64) * 0.05
FAR = np.array([[100.0, 100.0], [101.0, 100.0]])
"""A path that is elsewhere."""
ORIGIN = np.zeros(3)
BEHIND = np.array([0.0, 0.0, math.pi])


def hits(distance: float | None) -> F64:
    """Returns certain hits at one range in all bearings; None = no obstacle."""
    out = np.zeros((24, 61))
    out[:, 60 if distance is None else round(distance / 0.05)] = 1.0
    return out


def grid_of(views: list[tuple[F64, float | None]], path: F64 = FAR, settings: OccupancySettings | None = None) -> OccupancyGrid:
    found = OccupancyGrid(path, settings)
    for camera, distance in views:
        found.integrate(camera, BEARINGS, EDGES, hits(distance))
    return found


def at(x: float, y: float = 0.0) -> F64:
    return np.array([x, y])


def is_occupied(found: OccupancyGrid, point: F64) -> bool:
    return float(found.clearance(point)) == 0.0


def test_obstacle_is_occupied_the_floor_before_it_free_and_the_floor_behind_it_unknown() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 2)
    assert is_occupied(found, at(1.02))
    assert not is_occupied(found, at(0.7))
    rows = [60 + round((x - 0.025) / 0.05) for x in (0.725, 1.525)]  # the grid of 120 cells begins at -3 m
    before, behind = found.log_odds[rows, 60]
    assert before < -0.5
    assert behind == 0.0


def test_obstacle_stays_when_it_leaves_the_field_of_view() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 3 + [(BEHIND, None)] * 20)
    assert is_occupied(found, at(1.02))
    assert not is_occupied(found, at(-1.02))


def test_cells_that_are_seen_free_are_cleared() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 3 + [(ORIGIN, None)] * 8)
    assert not is_occupied(found, at(1.02))


def test_hit_below_the_minimum_range_changes_nothing() -> None:
    found = grid_of([(ORIGIN, 0.2)] * 10)
    assert not is_occupied(found, at(0.22))
    assert np.abs(found.log_odds).max() < 1e-3
    assert is_occupied(grid_of([(ORIGIN, 0.2)] * 10, settings=OccupancySettings(min_range=0.0)), at(0.22))
    # A hit beyond it counts with its own probability.
    half = 0.5 * (hits(0.2) + hits(1.0))
    found = OccupancyGrid(FAR)
    for _ in range(3):
        found.integrate(ORIGIN, BEARINGS, EDGES, half)
    assert is_occupied(found, at(1.02))


def test_obstacle_soon_outweighs_clamped_free_floor() -> None:
    # Free floor is clamped at -1.5, a view of an obstacle adds 1.0; cells are occupied from 0.8 on.
    free = [(ORIGIN, None)] * 30
    assert not is_occupied(grid_of([*free, *[(ORIGIN, 1.0)] * 2]), at(1.02))
    assert is_occupied(grid_of([*free, *[(ORIGIN, 1.0)] * 3]), at(1.02))


def test_recorded_path_is_free_until_several_views_have_an_obstacle_there() -> None:
    # A certain hit adds 0.4 * 2.5 = 1.0; cells are occupied from 0.8 on; the prior of the path is -2.
    path = np.array([[-2.0, 0.0], [2.0, 0.0]])
    once, thrice = grid_of([(ORIGIN, 1.0)], path), grid_of([(ORIGIN, 1.0)] * 3, path)
    assert not is_occupied(once, at(1.02))
    assert is_occupied(once, at(0.72, 0.72))
    assert is_occupied(thrice, at(1.02))


def test_clearance_is_the_distance_to_the_nearest_occupied_cell() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 2)
    # The first occupied cell is that from 0.95 or 1.0 m on.
    assert found.clearance(at(0.325)) == pytest.approx(0.65, abs=0.05)
    assert found.clearance(np.array([[1.02, 0.0], [0.525, 0.0]])) == pytest.approx([0.0, 0.45], abs=0.05)
    assert grid_of([]).clearance(at(0.0)) == OccupancySettings().size


def test_window_moves_with_the_robot_and_drops_cells_that_leave_it() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 2)
    found.move_window(2.0, 0.5)
    assert is_occupied(found, at(1.02))
    assert found.clearance(at(0.325)) == pytest.approx(0.65, abs=0.05)
    found.move_window(9.0, 0.5)
    found.move_window(0.0, 0.0)
    assert not is_occupied(found, at(1.02))


def test_log_odds_decay_with_time() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 2)  # 2.0
    found.decay(40.0 * math.log(2.0))  # half of it
    assert is_occupied(found, at(1.02))
    found.decay(40.0 * math.log(2.0))
    assert not is_occupied(found, at(1.02))


def test_grid_is_in_the_path_frame() -> None:
    # The camera at (1, 2) looks to the left: 1 m ahead of it is (1, 3).
    found = grid_of([(np.array([1.0, 2.0, math.pi / 2.0]), 1.0)] * 2)
    assert is_occupied(found, at(1.0, 3.02))
    assert not is_occupied(found, at(2.02, 2.0))


def test_cleared_grid_has_no_obstacles() -> None:
    found = grid_of([(ORIGIN, 1.0)] * 3)
    found.clear()
    assert not is_occupied(found, at(1.02))


def test_ranges_that_vary_put_an_obstacle_at_their_middle() -> None:
    found = OccupancyGrid(FAR)
    for free in (0.9, 1.1, 1.0, 0.95, 1.05):
        found.integrate(ORIGIN, BEARINGS, EDGES, hits(free))
    assert is_occupied(found, at(1.0))
    assert not is_occupied(found, at(0.6))


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"decay_time_constant is 0, must be 0.1 to 1e\+06"):
        OccupancySettings(decay_time_constant=0.0)


def test_hits_of_recorded_images_on_the_path_are_no_obstacles() -> None:
    path = np.array([[0.0, 0.0], [3.0, 0.0]])
    found = OccupancyGrid(path)
    found.add_recorded(ORIGIN, BEARINGS, EDGES, hits(1.0))
    for _ in range(6):
        found.integrate(ORIGIN, BEARINGS, EDGES, hits(1.0))
    assert not is_occupied(found, at(1.02)), "the robot that recorded the path drove here"
    assert is_occupied(found, at(0.82, 0.6)), "beside the path it may be a wall"
    for _ in range(12):
        found.integrate(ORIGIN, BEARINGS, EDGES, hits(1.5))
    assert is_occupied(found, at(1.52)), "the recorded images did not show this"


def test_low_obstacle_stays_in_the_grid_when_it_is_below_the_image() -> None:
    # Seen from 1 m, and then from 0.4 m, where the camera looks over it.
    near = np.array([0.62, 0.0, 0.0])
    views = [(ORIGIN, 1.0)] * 4 + [(near, None)] * 10
    assert is_occupied(grid_of(views), at(1.02))
    assert not is_occupied(grid_of(views, settings=OccupancySettings(min_clearing_range=0.0)), at(1.02))


def test_distances_are_exact_wherever_the_memory_is() -> None:
    rng = np.random.default_rng(0)
    image = np.ones((120, 120), np.uint8)
    zeros = rng.integers(0, 120, (30, 2))
    image[zeros[:, 0], zeros[:, 1]] = 0
    cells = np.stack(np.meshgrid(np.arange(120), np.arange(120), indexing="ij"), axis=-1)
    squared = np.square(cells[:, :, None] - zeros).sum(axis=-1).min(axis=-1)
    kept = []
    for _ in range(50):
        kept.append(np.empty(rng.integers(1, 60_000), np.uint8))  # moves what OpenCV allocates next
        np.testing.assert_array_equal(_distance_to_zero(image), np.sqrt(squared).astype(np.float32))
