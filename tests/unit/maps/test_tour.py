"""Starts and tours on small floors made by hand."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.tour import choose_start, plan_tour

RADIUS = 0.2
CELL = 0.05


def _floor(width: float, height: float, *boxes: tuple[float, float, float, float]) -> FloorMap:
    """Returns a floor from (0, 0) with boxes (x0, y0, x1, y1) on it, metres."""
    occupied = np.zeros((round(height / CELL), round(width / CELL)), dtype=bool)
    for x0, y0, x1, y1 in boxes:
        occupied[round(y0 / CELL) : round(y1 / CELL), round(x0 / CELL) : round(x1 / CELL)] = True
    return FloorMap(CELL, (0.0, 0.0), occupied, np.ones_like(occupied))


def two_rooms() -> FloorMap:
    """Two rooms of 4 m x 4 m; the wall between them at x = 4 has a door of 1 m from y = 1.5."""
    return _floor(8, 4, (3.95, 0, 4.05, 1.5), (3.95, 2.5, 4.05, 4))


def _length(path: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _along(path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns points every centimetre or closer along the path."""
    t = np.linspace(0, 1, 11)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in pairwise(path)])


def test_tour_keeps_its_distance() -> None:
    floor = two_rooms()
    path = plan_tour(floor, (1.0, 1.0), RADIUS, 25.0)
    assert floor.clearance(_along(path)).min() >= RADIUS


def test_tour_keeps_its_distance_in_box_coordinates() -> None:
    # Independent of the map's own distances: the jambs of the door end at (3.95..4.05, 1.5) and (3.95..4.05, 2.5).
    points = _along(plan_tour(two_rooms(), (1.0, 1.0), RADIUS, 25.0))
    at_door = points[np.abs(points[:, 0] - 4.0) < 0.05]
    assert len(at_door)
    assert at_door[:, 1].min() >= 1.5 + RADIUS
    assert at_door[:, 1].max() <= 2.5 - RADIUS


def test_tour_begins_at_the_start() -> None:
    assert plan_tour(two_rooms(), (1.03, 1.02), RADIUS, 10.0)[0].tolist() == [1.03, 1.02]


@pytest.mark.parametrize("length", [0.5, 3.0, 10.0, 60.0])
def test_tour_has_about_the_requested_length(length: float) -> None:
    assert _length(plan_tour(two_rooms(), (1.0, 1.0), RADIUS, length)) == pytest.approx(length, abs=1.0)


def test_tour_is_deterministic() -> None:
    first, second = (plan_tour(two_rooms(), (1.0, 1.0), RADIUS, 15.0) for _ in range(2))
    assert first.tolist() == second.tolist()


def test_both_rooms_are_visited() -> None:
    path = plan_tour(two_rooms(), (1.0, 1.0), RADIUS, 15.0)
    assert path[:, 0].max() > 6.0
    longer = plan_tour(two_rooms(), (1.0, 1.0), RADIUS, 40.0)
    back = longer[int(longer[:, 0].argmax()) :]
    assert back[:, 0].min() < 2.0


def test_third_corner_is_visited_before_the_first_one_again() -> None:
    # A plus of four corridors, 1 m wide and 4 m long, from the middle (4.5, 4.5).
    floor = _floor(9, 9, (0, 0, 4, 4), (5, 0, 9, 4), (0, 5, 4, 9), (5, 5, 9, 9))
    # 4 m out of the left arm, then at most 8 m there and back for each of the others.
    path = plan_tour(floor, (0.5, 4.5), RADIUS, 4 + 3 * 8)
    for end in ((8.5, 4.5), (4.5, 0.5), (4.5, 8.5)):
        assert np.linalg.norm(path - end, axis=1).min() < 0.9


def test_door_that_is_narrower_than_the_robot_is_not_driven_through() -> None:
    floor = _floor(8, 4, (3.95, 0, 4.05, 1.5), (3.95, 1.95, 4.05, 4))
    assert plan_tour(floor, (1.0, 1.0), 0.23, 20.0)[:, 0].max() < 3.95
    assert plan_tour(floor, (1.0, 1.0), 0.18, 20.0)[:, 0].max() > 6.0


def test_points_are_close_together() -> None:
    path = plan_tour(two_rooms(), (1.0, 1.0), RADIUS, 15.0)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() <= 0.1 + 1e-6
    assert steps.min() > 0


def test_start_inside_an_obstacle_names_the_nearest_free_place() -> None:
    floor = _floor(6, 6, (1, 1, 3, 2))
    with pytest.raises(ConfigError) as caught:
        plan_tour(floor, (1.6, 1.9), RADIUS, 5.0)
    found = re.search(r"nearest free place is \(([\d.]+), ([\d.]+)\)", str(caught.value))
    assert found is not None
    # Straight up, beyond the edge at y = 2 by the radius and at most one cell and its half diagonal.
    x, y = float(found[1]), float(found[2])
    assert x == pytest.approx(1.6, abs=0.05)
    assert 2.0 + RADIUS <= y <= 2.0 + RADIUS + 0.1


def test_start_outside_the_map_is_an_error() -> None:
    with pytest.raises(ConfigError, match="nearest free place"):
        plan_tour(_floor(4, 4), (-3.0, 2.0), RADIUS, 5.0)


def test_room_that_is_walled_off_is_not_visited() -> None:
    path = plan_tour(_floor(8, 4, (3.95, 0, 4.05, 4)), (1.0, 1.0), RADIUS, 20.0)
    assert path[:, 0].max() < 3.95 - RADIUS


def test_robot_that_fits_nowhere_is_an_error() -> None:
    floor = _floor(1, 1)
    with pytest.raises(SceneError, match="free for a robot"):
        plan_tour(floor, (0.5, 0.5), 0.6, 5.0)
    with pytest.raises(SceneError, match="free for a robot"):
        choose_start(floor, 0.6)


@pytest.mark.parametrize(("radius", "length"), [(0.2, 0.0), (0.0, 5.0), (0.2, float("nan")), (-1.0, 5.0)])
def test_lengths_must_be_above_0(radius: float, length: float) -> None:
    with pytest.raises(ConfigError, match="above 0"):
        plan_tour(two_rooms(), (1.0, 1.0), radius, length)


def test_start_is_the_most_open_place_and_looks_along_the_room() -> None:
    # A square of 4 m with a corridor to the right, in the middle of the height.
    floor = _floor(12, 4, (4, 0, 12, 1.5), (4, 2.5, 12, 4))
    x, y, yaw = choose_start(floor, RADIUS)
    assert (x, y) == pytest.approx((2.0, 2.0), abs=0.15)
    assert yaw == pytest.approx(0.0)
