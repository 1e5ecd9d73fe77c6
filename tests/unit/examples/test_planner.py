"""Paths on a costmap."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_examples.costmap import Costmap, CostmapSettings
from gibson_examples.errors import PlanError
from gibson_examples.geometry import F64
from gibson_examples.planner import SPACING, RoutePlanner, resample
from unit.examples.drawing import empty_room, grid_of

SETTINGS = CostmapSettings(robot_radius=0.2, margin=0.05, inflation=0.5)
TWO_ROOMS = ["#" * 41, *["#" + "." * 19 + "#" + "." * 19 + "#"] * 20, *["#" + "." * 39 + "#"] * 9, "#" * 41]
"""4.1 m x 3.1 m, cells of 0.1 m: a wall at x = 2.0 to 2.1 with a doorway from y = 0.1 to 1.0."""


def length(path: F64) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def two_rooms() -> Costmap:
    return Costmap(grid_of(*TWO_ROOMS), SETTINGS)


def test_way_through_an_empty_room_is_the_straight_line() -> None:
    path = RoutePlanner(Costmap(empty_room(6.0, 6.0), SETTINGS), (4.5, 4.0)).path((1.5, 2.0))
    assert path[0] == pytest.approx([1.5, 2.0])
    assert path[-1] == pytest.approx([4.5, 4.0])
    assert length(path) == pytest.approx(np.hypot(3.0, 2.0), rel=0.005)


def test_points_of_a_way_are_evenly_spaced() -> None:
    path = RoutePlanner(two_rooms(), (3.0, 2.0)).path((1.0, 2.0))
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps.max() < 1.1 * SPACING
    assert np.median(steps) == pytest.approx(SPACING, rel=0.02)


def test_way_to_the_next_room_leads_through_the_doorway_and_keeps_the_distance() -> None:
    costmap = two_rooms()
    path = RoutePlanner(costmap, (3.0, 2.0)).path((1.0, 2.0))
    in_wall = path[(path[:, 0] > 2.0) & (path[:, 0] < 2.1)]
    assert len(in_wall)
    assert (in_wall[:, 1] < 1.0).all()
    assert costmap.clearance_at(path).min() >= 0.25 - 0.05  # of one cell, for what lies between two centres


def test_way_keeps_to_the_middle_of_a_doorway() -> None:
    path = RoutePlanner(two_rooms(), (3.0, 2.0)).path((1.0, 2.0))
    in_wall = path[(path[:, 0] > 2.0) & (path[:, 0] < 2.1)]
    assert in_wall[:, 1] == pytest.approx(np.full(len(in_wall), 0.55), abs=0.16)


def test_obstacle_in_the_doorway_closes_it() -> None:
    ends = np.column_stack([np.full(9, 2.05), np.arange(0.15, 1.0, 0.1)])
    costmap = Costmap(grid_of(*TWO_ROOMS), CostmapSettings(robot_radius=0.2, margin=0.05, map_tolerance=0.0))
    costmap.add_scan((1.0, 0.5), ends, np.ones(9, dtype=bool), now_s=0.0)
    with pytest.raises(PlanError, match=r"^no way from 1.00,2.00 to 3.00,2.00"):
        RoutePlanner(costmap, (3.0, 2.0)).path((1.0, 2.0))


def test_obstacle_on_the_line_is_gone_round() -> None:
    costmap = Costmap(empty_room(6.0, 6.0), SETTINGS)
    costmap.add_scan((1.0, 3.0), [(3.0, 2.9), (3.0, 3.0), (3.0, 3.1)], np.ones(3, dtype=bool), now_s=0.0)
    path = RoutePlanner(costmap, (5.0, 3.0)).path((1.0, 3.0))
    assert costmap.clearance_at(path).min() >= 0.25 - 0.05
    assert length(path) < 4.5


def test_goal_in_a_wall_is_refused_with_what_it_needs() -> None:
    with pytest.raises(PlanError, match=r"^goal 2.05,2.00 is too near to an obstacle, .* needs 0.25 m around it"):
        RoutePlanner(two_rooms(), (2.05, 2.0))


def test_goal_a_little_too_near_to_a_wall_becomes_the_place_beside_it() -> None:
    routes = RoutePlanner(Costmap(empty_room(6.0, 6.0), SETTINGS), (0.22, 3.02))
    assert routes.end == pytest.approx((0.325, 3.025))
    assert routes.path((3.0, 3.0))[-1] == pytest.approx(routes.end)


def test_robot_that_is_too_near_to_a_wall_finds_its_way_out() -> None:
    path = RoutePlanner(Costmap(empty_room(6.0, 6.0), SETTINGS), (3.0, 3.0)).path((0.15, 3.0))
    assert path[0] == pytest.approx([0.15, 3.0])


def test_robot_in_the_middle_of_obstacles_has_no_way() -> None:
    costmap = Costmap(grid_of(*["#" * 30] * 10, *["#" * 20 + "." * 10] * 10), SETTINGS)
    with pytest.raises(PlanError, match="no free place within"):
        RoutePlanner(costmap, (2.5, 0.5)).path((0.5, 1.5))


def test_start_at_the_goal_gives_a_way_of_two_points() -> None:
    path = RoutePlanner(Costmap(empty_room(6.0, 6.0), SETTINGS), (3.01, 3.01)).path((3.02, 3.02))
    assert path.tolist() == [[3.02, 3.02], [3.01, 3.01]]


def test_corners_stay_when_a_line_is_resampled() -> None:
    points = resample(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), 0.25)
    assert points == pytest.approx(
        np.array([[0, 0], [0.25, 0], [0.5, 0], [0.75, 0], [1, 0], [1, 0.25], [1, 0.5], [1, 0.75], [1, 1]])
    )
