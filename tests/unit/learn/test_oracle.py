"""Pure pursuit along lines, and detours around obstacles on them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_path_following.types import STOP
from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim_learn.path_following.oracle import PurePursuit, avoid_obstacles, is_passable, near_line, resampled

CORNER = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)]


def empty_floor() -> FloorMap:
    """4 m x 4 m, free, its middle at the origin."""
    return FloorMap(0.05, (-2.0, -2.0), np.zeros((80, 80), bool), np.ones((80, 80), bool))


def with_block(floor: FloorMap, low: tuple[float, float], high: tuple[float, float]) -> FloorMap:
    """Returns the floor with a box on it."""
    occupied = floor.occupied.copy()
    (r0, c0), (r1, c1) = floor.cells(low), floor.cells(high)
    occupied[r0:r1, c0:c1] = True
    return FloorMap(floor.resolution, floor.origin, occupied, floor.floor)


def test_a_resampled_line_has_points_every_five_centimetres_and_both_ends() -> None:
    points, arc = resampled(CORNER)
    assert arc[-1] == pytest.approx(4.0)
    assert len(points) == 81
    assert points[0].tolist() == [0.0, 0.0] and points[-1].tolist() == [2.0, 2.0]
    assert points[40].tolist() == pytest.approx([2.0, 0.0])


def test_a_line_of_one_point_is_refused() -> None:
    with pytest.raises(SceneError, match="two different points"):
        resampled([(1.0, 1.0), (1.0, 1.0)])


@pytest.mark.parametrize("start", [(0.0, 0.0, 0.0), (0.0, 0.15, 0.2), (0.0, -0.1, math.pi)])
def test_pursuit_follows_a_corner_to_its_end(start: tuple[float, float, float]) -> None:
    pursuit = PurePursuit(CORNER)
    x, y, yaw = start
    furthest = 0.0
    for _ in range(200):
        velocity = pursuit.velocity(x, y, yaw)
        if pursuit.finished:
            break
        yaw += 0.2 * velocity.angular
        x, y = x + 0.2 * velocity.linear * math.cos(yaw), y + 0.2 * velocity.linear * math.sin(yaw)
        furthest = max(furthest, float(np.hypot(*(pursuit.line - (x, y)).T).min()))
    assert math.dist((x, y), (2.0, 2.0)) < 0.1
    assert furthest < 0.25
    assert pursuit.velocity(x, y, yaw) == STOP


def test_a_line_that_is_free_stays_as_it_is() -> None:
    line = [(-1.5, 0.0), (1.5, 0.0)]
    assert np.array_equal(avoid_obstacles(empty_floor(), line, 0.25), resampled(line)[0])


def test_a_way_round_keeps_its_distance_and_comes_back() -> None:
    line = [(-1.5, 0.0), (1.5, 0.0)]
    floor = with_block(empty_floor(), (-0.1, -0.1), (0.1, 0.1))
    assert is_passable(floor, line, 0.25)
    found = avoid_obstacles(floor, line, 0.25)
    points, _ = resampled(found)
    assert float(floor.clearance(points).min()) >= 0.25 - 0.05
    assert float(np.abs(points[:, 1]).max()) <= 0.48
    assert found[0].tolist() == [-1.5, 0.0] and found[-1].tolist() == [1.5, 0.0]


def test_an_obstacle_across_the_whole_path_leaves_no_detour() -> None:
    line = [(-1.5, 0.0), (1.5, 0.0)]
    floor = with_block(empty_floor(), (-0.1, -0.8), (0.1, 0.8))
    assert not is_passable(floor, line, 0.25)
    with pytest.raises(SceneError, match="no way near the line"):
        avoid_obstacles(floor, line, 0.25)


def test_cells_beside_a_line() -> None:
    floor = empty_floor()
    near = near_line(floor, [(-1.0, 0.025), (1.0, 0.025)], 0.3)
    assert floor.look_up(near, [(0.0, 0.2), (0.0, 0.5), (1.2, 0.025)], outside=False).tolist() == [True, False, True]
