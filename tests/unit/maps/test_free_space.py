"""The free space of a robot: a wall with a door of 0.60 m, which a robot passes or does not."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_space import MARGIN, FreeSpace

CELL = 0.05
LEFT, RIGHT = (1.0, 2.0), (3.0, 2.0)
BOX = np.array([[0.8, 1.8], [1.2, 1.8], [1.2, 2.2], [0.8, 2.2]])


@pytest.fixture(scope="module")
def floor() -> FloorMap:
    """4 x 4 m, with a wall at x = 1.95 to 2.05 m and a door at y = 1.7 to 2.3 m."""
    blocked = np.zeros((80, 80), dtype=bool)
    blocked[:, 39:41] = True
    blocked[34:46, 39:41] = False
    return FloorMap(CELL, (0.0, 0.0), blocked, np.ones_like(blocked))


def test_robot_passes_a_door_that_leaves_its_clearance(floor: FloorMap) -> None:
    # From the centres of the middle cells of the door to the wall: 0.275 m.
    assert FreeSpace(floor, 0.23).connected(LEFT, RIGHT)
    assert not FreeSpace(floor, 0.24).connected(LEFT, RIGHT)
    assert FreeSpace(floor, 0.24).connected(LEFT, RIGHT, clearance=0.24)


def test_clearance_is_radius_and_margin(floor: FloorMap) -> None:
    assert FreeSpace(floor, 0.2).clearance == pytest.approx(0.24)
    assert MARGIN == 0.04


def test_position_in_an_obstacle_is_connected_only_if_it_is_snapped(floor: FloorMap) -> None:
    space = FreeSpace(floor, 0.2)
    in_wall = (2.0, 0.5)
    assert not space.connected(in_wall, RIGHT)
    assert space.connected(in_wall, RIGHT, snap=True)
    assert not space.connected(LEFT, (9.0, 9.0))


def test_path_through_a_door_without_room_for_the_margin_exists_nevertheless(floor: FloorMap) -> None:
    length, path = FreeSpace(floor, 0.25).shortest(LEFT, RIGHT)
    assert length == pytest.approx(2.0)
    assert not FreeSpace(floor, 0.25).contains(path)
    assert FreeSpace(floor, 0.2).contains(path)
    with pytest.raises(SceneError, match="no path leads"):
        FreeSpace(floor, 0.35).shortest(LEFT, RIGHT)


def test_path_leads_around_obstacles_that_are_added(floor: FloorMap) -> None:
    space = FreeSpace(floor, 0.2)
    with_box = space.with_obstacles([BOX])
    direct, around = (each.shortest((0.4, 2.0), (1.65, 2.0)) for each in (space, with_box))
    assert direct[0] == pytest.approx(1.25)
    # Tangents and arcs of 0.24 m radius about the two upper or lower corners: 0.377 + 0.247 + 0.400 + 0.222 + 0.430 m.
    assert around[0] == pytest.approx(1.68, abs=0.08)
    assert not with_box.contains(direct[1])
    assert space.with_obstacles([]) is space


def test_regions_are_those_between_which_no_path_leads(floor: FloorMap) -> None:
    left, right = (tuple(floor.cells(xy)) for xy in (LEFT, RIGHT))
    narrow, wide = FreeSpace(floor, 0.2).regions(), FreeSpace(floor, 0.2).regions(0.4)
    assert narrow[left] == narrow[right] != 0
    assert 0 != wide[left] != wide[right] != 0
    assert FreeSpace(floor, 0.2).largest_region(0.4).sum() < (wide > 0).sum()
