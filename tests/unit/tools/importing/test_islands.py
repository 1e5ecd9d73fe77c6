"""Pieces of floor that gaps in a scan separate are reported; those behind walls are not."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.maps.floor_map import FloorMap
from gibson_sim_tools.importing.checks.islands import islands


def _map(floor: np.ndarray, occupied: np.ndarray) -> FloorMap:
    return FloorMap(0.1, (0.0, 0.0), occupied, floor & ~occupied)


def _blank() -> tuple[np.ndarray, np.ndarray]:
    """Returns a floor of 6 x 3 m with walls about it."""
    floor, occupied = np.ones((32, 62), dtype=bool), np.zeros((32, 62), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return floor, occupied


def test_a_strip_that_was_not_scanned_makes_islands() -> None:
    floor, occupied = _blank()
    floor[:, 40:44] = False
    large, small = islands(_map(floor, occupied), 0.2)
    assert large == pytest.approx(3.4 * 2.5, rel=0.15) and small == pytest.approx(1.2 * 2.5, rel=0.25)


def test_a_wall_makes_none() -> None:
    floor, occupied = _blank()
    occupied[:, 40:42] = True
    assert islands(_map(floor, occupied), 0.2) == ()


def test_what_is_farther_than_a_metre_or_hardly_a_place_makes_none() -> None:
    floor, occupied = _blank()
    wide, tiny = floor.copy(), floor.copy()
    wide[:, 25:50] = False
    assert islands(_map(wide, occupied), 0.2) == ()
    tiny[:, 40:56] = False
    assert islands(_map(tiny, occupied), 0.2) == ()


def test_a_floor_without_any_place_makes_none() -> None:
    floor, occupied = _blank()
    assert islands(_map(~floor, occupied), 0.2) == ()
