"""The occupancy grid of a floor, cell by cell.

The hand-made room has a floor from (0, 0) to (2, 2) and four walls without thickness 0.125 m inside its rim. At 0.25 m per cell
the grid has 10 x 10 cells: cell 0 is the rim outside, cells 1 and 8 hold the walls, cells 2 to 7 are inside.
A point belongs to the highest floor below it.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.maps import floor_map
from gibson_sim.maps.floor_map import FloorMap, floor_at, floor_name, make_floor_map, with_floor_at
from gibson_sim.scenes.load import load_scene
from support.scenes import write_house, write_room

CELL = 0.25
INSIDE = {(row, column) for row in range(2, 8) for column in range(2, 8)}
Corners = list[list[float]]
HOUSE = (-2.5, 0.0, 2.86)


def _quad(a: list[float], b: list[float], c: list[float], d: list[float]) -> Corners:
    return [a, b, c, a, c, d]


def _wall(x0: float, y0: float, x1: float, y1: float, bottom: float = 0.0, top: float = 2.0) -> Corners:
    return _quad([x0, y0, bottom], [x1, y1, bottom], [x1, y1, top], [x0, y0, top])


def _level(x0: float, y0: float, x1: float, y1: float, z: float) -> Corners:
    return _quad([x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z])


FLOOR = _level(0, 0, 2, 2, 0)
NEAR, FAR = 0.125, 1.875
WALLS = _wall(NEAR, NEAR, FAR, NEAR) + _wall(FAR, NEAR, FAR, FAR) + _wall(FAR, FAR, NEAR, FAR) + _wall(NEAR, FAR, NEAR, NEAR)


def _map(corners: Corners, *, robot_height: float = 0.5, ground_plane: bool = False) -> FloorMap:
    points = np.array(corners, dtype=float)
    triangles = np.arange(len(points)).reshape(-1, 3)
    return make_floor_map(points, triangles, floor_z=0, robot_height=robot_height, resolution=CELL, ground_plane=ground_plane)


def _cells(mask: NDArray[np.bool_]) -> set[tuple[int, int]]:
    return {(int(row), int(column)) for row, column in np.argwhere(mask)}


def test_room_has_exactly_its_inner_cells_free() -> None:
    found = _map(FLOOR + WALLS)
    assert found.origin == (-0.25, -0.25)
    assert found.shape == (10, 10)
    assert _cells(found.free) == INSIDE
    ring = {(r, c) for r in range(1, 9) for c in range(1, 9)} - INSIDE
    assert _cells(found.occupied) == ring


def test_rows_run_along_y_and_columns_along_x() -> None:
    # One post at x = 1.125, y = 0.625: column 5, row 3.
    found = _map(FLOOR + WALLS + _wall(1.12, 0.62, 1.13, 0.63))
    assert INSIDE - _cells(found.free) == {(3, 5)}
    assert found.cells((1.125, 0.625)).tolist() == [3, 5]
    np.testing.assert_allclose(found.centers((3, 5)), [1.125, 0.625])


def test_table_top_above_the_robot_is_free_and_its_legs_are_not() -> None:
    legs = _wall(0.62, 0.62, 0.63, 0.63, 0, 0.75) + _wall(1.37, 1.37, 1.38, 1.38, 0, 0.75)
    table = _level(0.6, 0.6, 1.4, 1.4, 0.75) + legs
    assert INSIDE - _cells(_map(FLOOR + WALLS + table).free) == {(3, 3), (6, 6)}


def test_table_top_below_the_height_of_the_robot_is_occupied() -> None:
    # From 0.6 to 1.4 m: cells 3 to 6.
    found = _map(FLOOR + WALLS + _level(0.6, 0.6, 1.4, 1.4, 0.75), robot_height=1.0)
    assert INSIDE - _cells(found.free) == {(r, c) for r in range(3, 7) for c in range(3, 7)}


def test_thin_slanted_triangle_is_not_missed() -> None:
    # From (0.6, 0.6) to (1.4, 1.1), 1 mm wide. In cells from (3.4, 3.4) to (6.6, 5.4): it enters row 4 at column 4.36 and
    # row 5 at column 5.96.
    sliver = [[0.6, 0.6, 0.3], [1.4, 1.1, 0.3], [1.0, 0.851, 0.3]]
    assert INSIDE - _cells(_map(FLOOR + WALLS + sliver).free) == {(3, 3), (3, 4), (4, 4), (4, 5), (5, 5), (5, 6)}


def test_only_the_part_at_the_height_of_the_robot_counts() -> None:
    # A ramp of 45 degrees from (0.5, z=0) to (1.75, z=1.25) over y 0.5..0.75 (row 3): it leaves the robot's height at x = 1.0.
    ramp = _quad([0.5, 0.5, 0], [1.75, 0.5, 1.25], [1.75, 0.75, 1.25], [0.5, 0.75, 0])
    assert INSIDE - _cells(_map(FLOOR + WALLS + ramp).free) == {(3, 3), (3, 4)}


def test_threshold_is_driven_over() -> None:
    assert _cells(_map(FLOOR + WALLS + _level(0.6, 0.6, 1.4, 1.4, 0.02)).free) == INSIDE


def test_disc_keeps_its_radius_from_the_walls() -> None:
    found = _map(FLOOR + WALLS)
    # Centres of the rings are 0.125, 0.375 and 0.625 m from the walls; half the diagonal of a cell is 0.177 m.
    assert found.distance_to_obstacle[4, 4] == pytest.approx(0.625)
    assert found.distance_to_obstacle[2, 5] == pytest.approx(0.125)
    assert _cells(found.inflate(0.19)) == {(r, c) for r in range(3, 7) for c in range(3, 7)}
    assert _cells(found.inflate(0.21)) == {(4, 4), (4, 5), (5, 4), (5, 5)}
    assert not found.inflate(0.46).any()


def test_distance_to_the_corner_of_an_obstacle_is_along_the_diagonal() -> None:
    occupied = np.zeros((9, 9), dtype=bool)
    occupied[0, 0] = True
    found = FloorMap(1.0, (0.0, 0.0), occupied, np.ones((9, 9), dtype=bool))
    # From the centre of [2, 2] to the corner (1, 1) of cell [0, 0]: 1.5 along each axis.
    assert found.distance_to_obstacle[2, 2] == pytest.approx(1.5 * 2**0.5)
    assert found.clearance((2.5, 2.5)) == pytest.approx(1.5 * 2**0.5)
    assert found.clearance((-1.0, 2.5)) == 0.0


def test_outside_is_not_free_where_there_is_a_floor() -> None:
    found = _map(FLOOR + WALLS, ground_plane=True)
    assert _cells(found.free) == INSIDE


def test_ground_plane_is_floor_where_the_mesh_has_none() -> None:
    found = _map(WALLS, ground_plane=True)
    assert found.free[0, 0]
    assert not _map(WALLS + _level(0.9, 0.9, 1.1, 1.1, 0)).free[0, 0]


def test_crack_between_floor_tiles_is_closed() -> None:
    tiles = _level(0, 0, 1.0, 2, 0) + _level(1.25, 0, 2, 2, 0)
    assert _cells(_map(tiles + WALLS).free) == INSIDE


def test_largest_region_is_the_room_and_not_the_open_ground_around_it() -> None:
    # A post 4 m to the right of the room makes the open ground around far larger than the room.
    found = _map(WALLS + _wall(6.0, 1.0, 6.1, 1.1), ground_plane=True)
    assert found.free.sum() > 2 * len(INSIDE)
    assert _cells(found.largest_free_region()) == INSIDE


def test_nearest_free_place_of_an_occupied_one() -> None:
    found = _map(FLOOR + WALLS)
    assert found.nearest_free((0.1, 1.1)) == pytest.approx((0.375, 1.125))
    assert found.nearest_free((0.1, 1.1), 0.21) == pytest.approx((0.875, 1.125))
    assert found.nearest_free((1.0, 1.0), 5.0) is None


def test_height_without_anything_is_an_error() -> None:
    with pytest.raises(SceneError, match="floor_z"):
        _map(_level(0, 0, 2, 2, 40.0))


def test_scene_too_large_for_memory_gets_coarser_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floor_map, "_MAX_CELLS", 10_000)
    # 29.9 m x 29.9 m in 10,000 cells: 0.3 m each.
    assert _map(_level(0, 0, 29.9, 29.9, 0)).resolution == pytest.approx(0.3)


def test_map_too_coarse_for_a_robot_has_few_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(floor_map, "_MAX_CELLS", 10_000)
    assert _map(_level(0, 0, 100, 100, 0)).resolution == pytest.approx(2.0)


def test_map_of_things_kilometres_apart_takes_no_gigabyte() -> None:
    assert floor_map._affordable(0.05, np.array([2000.0, 2000.0])) >= 1.0
    assert floor_map._affordable(0.05, np.array([90.0, 90.0])) == 0.05
    assert floor_map._affordable(0.05, np.array([1e5, 0.1])) == 10.0  # few cells, but a row of two million


@pytest.mark.parametrize(
    ("z", "floor"),
    [
        (-2.5, 0), (-0.3, 0),  # the cellar, up to its ceiling
        (0.0, 1), (-0.1, 1), (0.75, 1), (2.5, 1),  # the ground floor; slightly in its floor; on a table; at the ceiling
        (2.86, 2), (2.7, 2), (5.0, 2), (100.0, 2),  # the upper floor, and above it
        (-50.0, 0),  # below all floors
    ],
)  # fmt: skip
def test_a_point_is_on_the_highest_floor_below_it(z: float, floor: int) -> None:
    assert floor_at(HOUSE, z) == floor


def test_one_floor_or_none_is_floor_0() -> None:
    assert floor_at((0.0,), -9.0) == floor_at((0.0,), 9.0) == floor_at((), 3.0) == 0


def test_a_height_that_is_not_a_number_is_on_the_lowest_floor() -> None:
    assert floor_at(HOUSE, math.nan) == 0


def test_the_floor_of_a_house_is_named_and_changed(tmp_path: Path) -> None:
    house = load_scene(write_house(tmp_path / "house"))
    upper = with_floor_at(house, 3.75)
    assert (floor_name(house), floor_name(upper), upper.floor_z, upper.floors) == ("floor 0", "floor 1", 3.0, (0.0, 3.0))
    assert with_floor_at(upper, 1.0).floor_z == 0.0 and with_floor_at(house, 1.0) is house
    room = load_scene(write_room(tmp_path / "room"))
    assert floor_name(room) == "" and with_floor_at(room, 9.0) is room
