"""On which floor a point is."""

from __future__ import annotations

import math

import pytest

from gibson_sim.maps.floors import floor_at

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
