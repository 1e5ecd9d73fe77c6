"""On which floor a point is."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from gibson_sim.maps.floors import floor_at, floor_name, with_floor_at
from gibson_sim.scenes.load import load_scene
from support.scenes import write_house, write_room

HOUSE = (-2.5, 0.0, 2.86)


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
