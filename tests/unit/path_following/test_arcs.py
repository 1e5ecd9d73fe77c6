"""Arcs: towards the goal, around near obstacles, slower in narrow places, never into an obstacle."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.obstacles.arcs import ArcPlanner, ArcSettings, arc_points
from gibson_path_following.types import STOP

F64 = NDArray[np.float64]


def nothing(points: F64) -> F64:
    """Returns the clearance without obstacles."""
    return np.full(points.shape[:-1], 10.0)


def beside(obstacles: F64) -> Callable[[F64], F64]:
    """Returns the clearance among point obstacles (M, 2), metres."""
    return lambda points: np.asarray(np.linalg.norm(points[..., None, :] - obstacles, axis=-1).min(axis=-1))


def test_goal_straight_ahead_is_driven_to_straight_at_full_speed() -> None:
    velocity = ArcPlanner().velocity((1.0, 0.0, 0.0), nothing)
    assert velocity.linear == pytest.approx(0.5)
    assert velocity.angular == pytest.approx(0.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_robot_turns_towards_a_goal_beside_it(side: float) -> None:
    # The arc through (0.5, 0.2) has the curvature 2 y / (x^2 + y^2) = 1.38 1/m and ends at a heading of 2 atan(y / x) = 0.76 rad.
    velocity = ArcPlanner().velocity((0.5, side * 0.2, side * 0.76), nothing)
    assert velocity.angular / velocity.linear == pytest.approx(side * 1.38, abs=0.1)


def test_goal_behind_is_turned_to_in_place() -> None:
    velocity = ArcPlanner().velocity((-0.5, 0.1, 0.0), nothing)
    assert (velocity.linear, velocity.angular) == (0.0, 1.0)


def test_robot_at_the_goal_turns_to_its_heading() -> None:
    velocity = ArcPlanner().velocity((0.05, 0.0, -0.2), nothing)
    assert velocity.linear == 0.0
    assert velocity.angular == pytest.approx(-0.3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_obstacle_beside_the_way_is_passed_on_its_free_side(side: float) -> None:
    velocity = ArcPlanner().velocity((1.0, 0.0, 0.0), beside(np.array([[0.6, side * 0.1]])))
    assert velocity.linear > 0.0
    assert velocity.angular * side < 0.0


def test_robot_is_slower_the_nearer_the_end_of_what_is_free() -> None:
    wall = [np.column_stack([np.full(41, x), np.linspace(-2.0, 2.0, 41)]) for x in (0.9, 0.5)]
    far, near = (ArcPlanner().velocity((1.0, 0.0, 0.0), beside(points)) for points in wall)
    assert 0.0 < near.linear < far.linear


def test_robot_stops_where_no_arc_is_free() -> None:
    around = np.array([[0.2 * math.cos(a), 0.2 * math.sin(a)] for a in np.linspace(-1.5, 1.5, 40)])
    assert ArcPlanner().velocity((1.0, 0.0, 0.0), beside(around)) == STOP


def test_robot_turns_to_its_goal_where_no_arc_is_free() -> None:
    around = np.array([[0.2 * math.cos(a), 0.2 * math.sin(a)] for a in np.linspace(-1.5, 1.5, 40)])
    velocity = ArcPlanner().velocity((1.0, 0.5, 0.0), beside(around))
    # 1.5 rad/s for each radian of atan2(0.5, 1).
    assert velocity.linear == 0.0
    assert velocity.angular == pytest.approx(1.5 * 0.4636, abs=1e-3)


def test_arcs_leave_what_is_too_near_already() -> None:
    # 0.18 m to the right of the robot, within its margin: it drives on, away from it.
    planner = ArcPlanner()
    velocity = planner.velocity((1.0, 0.0, 0.0), beside(np.array([[0.0, -0.18]])))
    assert velocity.linear > 0.0


def test_arc_of_a_quarter_turn_ends_at_its_radius() -> None:
    points, headings = arc_points(np.array([1.0, 0.0]), np.array([math.pi / 2]))
    np.testing.assert_allclose(points[0, 0], [1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(points[1, 0], [math.pi / 2, 0.0], atol=1e-12)
    assert headings[0, 0] == pytest.approx(math.pi / 2)


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"arc_count is 1, must be 3 to 1001"):
        ArcSettings(arc_count=1)
