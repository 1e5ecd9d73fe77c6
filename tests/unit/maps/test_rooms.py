"""Rooms and doors in a drawing of a floor: # wall, . floor, cells of 0.1 m."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.rooms import find_rooms


def floor_of(drawing: list[str]) -> FloorMap:
    """Returns the map of a drawing whose last line has the lowest y; its lower left corner is the origin."""
    wall = np.array([[c == "#" for c in line] for line in reversed(drawing)])
    return FloorMap(0.1, (0.0, 0.0), wall, np.ones_like(wall))


def two_rooms(door: int) -> FloorMap:
    """Two rooms of 2 m x 3 m beside each other, a wall of 0.1 m between them, and a door ``door`` cells wide at y = 1 m."""
    lines = ["#" * 43]
    for row in range(30):
        is_door = 10 <= row < 10 + door
        lines.append("#" + "." * 20 + ("." if is_door else "#") + "." * 20 + "#")
    return floor_of(["#" * 43, *reversed(lines)])


def test_two_rooms_with_a_door_are_two_rooms_and_a_door() -> None:
    rooms, doors = find_rooms(two_rooms(8))
    assert len(rooms) == 2
    assert [room.area for room in rooms] == pytest.approx([6.0, 6.0], abs=0.15)
    assert rooms[0].low == pytest.approx((0.1, 0.1))
    assert rooms[0].high == pytest.approx((2.1, 3.1), abs=0.11)
    (door,) = doors
    # In the wall between x = 2.1 and 2.2 m; between y = 1.1 and 1.9 m.
    assert door.center == pytest.approx((2.15, 1.5), abs=0.16)
    assert door.width == pytest.approx(0.8, abs=0.15)
    assert door.rooms == (0, 1)
    assert math.cos(door.yaw) == pytest.approx(1.0, abs=0.05), "from the left room to the right one"


def test_wide_opening_is_no_door() -> None:
    rooms, doors = find_rooms(two_rooms(14))
    assert (len(rooms), doors) == (1, ())


def test_gap_that_is_too_narrow_is_no_door() -> None:
    rooms, doors = find_rooms(two_rooms(2))
    assert (len(rooms), doors) == (2, ())


def test_furniture_in_the_middle_does_not_cut_a_room_in_two() -> None:
    lines = ["#" * 42]
    for row in range(30):
        lines.append("#" + "." * 18 + ("####" if 8 <= row < 22 else "....") + "." * 18 + "#")
    rooms, doors = find_rooms(floor_of([*lines, "#" * 42]))
    assert (len(rooms), doors) == (1, ())


def test_closet_is_no_room() -> None:
    closet = ["#" * 14, *["#" + "." * 12 + "#"] * 12, "#" * 14]
    assert find_rooms(floor_of(closet)) == ((), ())


def test_floor_without_room_for_anything_has_no_rooms() -> None:
    assert find_rooms(floor_of(["####", "#..#", "####"])) == ((), ())
