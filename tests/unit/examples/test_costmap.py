"""The costmap: cells where the robot may drive."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_examples.costmap import Costmap, CostmapSettings
from gibson_examples.errors import MapError
from gibson_examples.grid import Grid
from unit.examples.drawing import empty_room, grid_of

SETTINGS = CostmapSettings(robot_radius=0.2, margin=0.1, map_tolerance=0.2, range=3.0, persistence_s=5.0)


def room() -> Costmap:
    """4 m x 4 m."""
    return Costmap(empty_room(4.0, 4.0), SETTINGS)


def beam(costmap: Costmap, x: float, now_s: float, *, hit: bool = True) -> None:
    """Adds a scan of one beam along +x from 0.5, 2.0, that ends at x."""
    costmap.add_scan((0.5, 2.0), [(x, 2.0)], np.array([hit]), now_s)


def test_first_row_of_the_map_is_at_the_lowest_y() -> None:
    grid = grid_of("..", "#.", origin=(5.0, 7.0), resolution=0.5)
    assert grid.occupied.tolist() == [[True, False], [False, False]]
    assert grid.cells((5.1, 7.1)).tolist() == [0, 0]
    assert grid.cells((5.6, 7.1)).tolist() == [0, 1]
    assert grid.centers([1, 0]).tolist() == [5.25, 7.75]


def test_map_without_cells_is_refused() -> None:
    with pytest.raises(MapError, match="at least one cell"):
        Grid(0.05, (0.0, 0.0), np.zeros((0, 3), dtype=np.int8))


def test_clearance_is_counted_from_the_side_of_the_wall() -> None:
    # The wall ends at x = 0.05; the cell that holds x = 1.02 has its centre at 1.025.
    assert room().clearance_at((1.02, 2.0)) == pytest.approx(0.975)


def test_outside_the_map_and_in_unknown_cells_there_is_no_clearance() -> None:
    costmap = Costmap(grid_of("..?", "..."))
    assert costmap.clearance_at((-1.0, 0.05)) == 0.0
    assert costmap.clearance_at((0.25, 0.15)) == 0.0


def test_places_nearer_than_radius_and_margin_have_no_way_through() -> None:
    costmap = room()
    cost = costmap.cost()
    rows, columns = costmap.grid.cells([(0.33, 2.0), (0.37, 2.0)]).T
    assert np.isinf(cost[rows[0], columns[0]])
    assert np.isfinite(cost[rows[1], columns[1]])


def test_cost_falls_with_the_distance_and_is_nothing_far_away() -> None:
    costmap = room()
    row, near = costmap.grid.cells((0.42, 2.0))
    middle, far = costmap.grid.cells((0.6, 2.0))[1], costmap.grid.cells((2.0, 2.0))[1]
    cost = costmap.cost()
    assert cost[row, near] > cost[row, middle] > cost[row, far] == 0.0


def test_hit_in_free_space_becomes_an_obstacle() -> None:
    costmap = room()
    beam(costmap, 2.02, now_s=1.0)
    assert costmap.obstacles(1.0).sum() == 1
    assert costmap.clearance_at((2.02, 2.02)) == 0.0
    assert costmap.clearance_at((1.52, 2.02)) == pytest.approx(0.475)


def test_hit_on_a_wall_of_the_map_adds_nothing() -> None:
    costmap = Costmap(empty_room(3.0, 4.0), SETTINGS)
    beam(costmap, 2.85, now_s=1.0)
    assert not costmap.obstacles(1.0).any()


def test_beam_that_goes_through_clears_the_obstacle() -> None:
    costmap = room()
    beam(costmap, 2.02, now_s=1.0)
    beam(costmap, 3.0, now_s=2.0)
    assert not costmap.obstacles(2.0)[costmap.grid.cells((2.02, 2.0))[0], costmap.grid.cells((2.02, 2.0))[1]]


def test_beam_that_returns_nothing_clears_as_well() -> None:
    costmap = room()
    beam(costmap, 2.02, now_s=1.0)
    beam(costmap, 12.0, now_s=2.0, hit=False)
    assert not costmap.obstacles(2.0).any()


def test_hit_beyond_the_range_is_left_out() -> None:
    costmap = Costmap(empty_room(8.0, 4.0), SETTINGS)
    beam(costmap, 4.0, now_s=1.0)
    assert not costmap.obstacles(1.0).any()


def test_obstacle_that_is_not_seen_again_is_forgotten() -> None:
    costmap = room()
    beam(costmap, 2.02, now_s=1.0)
    costmap.add_scan((0.5, 1.0), [(1.0, 1.0)], np.array([False]), now_s=6.5)
    assert costmap.clearance_at((2.02, 2.02)) > 1.0


def test_nearest_passable_place_is_beside_the_obstacle() -> None:
    costmap = room()
    cell = costmap.nearest_passable((0.1, 2.02), within=0.4)
    assert cell is not None
    assert costmap.grid.centers(cell) == pytest.approx([0.375, 2.025])
    assert costmap.nearest_passable((0.1, 2.02), within=0.15) is None


def test_place_far_outside_the_map_has_no_passable_one() -> None:
    assert room().nearest_passable((-50.0, math.pi), within=0.4) is None
