"""The map of what stands around: things stay in it, free floor clears it, the recorded path is trusted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError
from gibson_path_following.occupancy import OccupancyMap, OccupancySettings

F64 = NDArray[np.float64]
BEARINGS = np.arctan((1.0 - (np.arange(24) + 0.5) / 12.0) * math.tan(math.radians(50.0)))
EDGES = np.arange(61, dtype=np.float64) * 0.05
FAR = np.array([[100.0, 100.0], [101.0, 100.0]])
"""A path that is elsewhere."""
ORIGIN = np.zeros(3)
BEHIND = np.array([0.0, 0.0, math.pi])


def hits(distance: float | None) -> F64:
    """Returns things at one distance in all directions, for sure; None = nothing anywhere."""
    out = np.zeros((24, 61))
    out[:, 60 if distance is None else round(distance / 0.05)] = 1.0
    return out


def map_of(views: list[tuple[F64, float | None]], path: F64 = FAR, settings: OccupancySettings | None = None) -> OccupancyMap:
    found = OccupancyMap(path, settings)
    for camera, distance in views:
        found.see(camera, BEARINGS, EDGES, hits(distance))
    return found


def at(x: float, y: float = 0.0) -> F64:
    return np.array([x, y])


def is_occupied(found: OccupancyMap, point: F64) -> bool:
    return float(found.clearance(point)) == 0.0


def test_thing_is_occupied_the_floor_before_it_free_and_what_is_behind_unknown() -> None:
    found = map_of([(ORIGIN, 1.0)] * 2)
    assert is_occupied(found, at(1.02))
    assert not is_occupied(found, at(0.7))
    rows = [60 + round((x - 0.025) / 0.05) for x in (0.725, 1.525)]  # the map of 120 cells begins at -3 m
    before, behind = found.log_odds[rows, 60]
    assert before < -0.5
    assert behind == 0.0


def test_thing_stays_when_it_leaves_the_view() -> None:
    found = map_of([(ORIGIN, 1.0)] * 3 + [(BEHIND, None)] * 20)
    assert is_occupied(found, at(1.02))
    assert not is_occupied(found, at(-1.02))


def test_cells_that_are_seen_free_are_cleared() -> None:
    found = map_of([(ORIGIN, 1.0)] * 3 + [(ORIGIN, None)] * 8)
    assert not is_occupied(found, at(1.02))


def test_what_seems_nearer_than_is_believed_tells_nothing() -> None:
    found = map_of([(ORIGIN, 0.2)] * 10)
    assert not is_occupied(found, at(0.22))
    assert np.abs(found.log_odds).max() < 1e-3
    assert is_occupied(map_of([(ORIGIN, 0.2)] * 10, settings=OccupancySettings(nearest=0.0)), at(0.22))
    # What is likely beyond is seen as before, as far as it is likely.
    half = 0.5 * (hits(0.2) + hits(1.0))
    found = OccupancyMap(FAR)
    for _ in range(3):
        found.see(ORIGIN, BEARINGS, EDGES, half)
    assert is_occupied(found, at(1.02))


def test_thing_counts_soon_where_the_floor_was_free_for_long() -> None:
    # Free floor counts 1.5 at most, a view of a thing 1.0; occupied is 0.8 and more.
    free = [(ORIGIN, None)] * 30
    assert not is_occupied(map_of([*free, *[(ORIGIN, 1.0)] * 2]), at(1.02))
    assert is_occupied(map_of([*free, *[(ORIGIN, 1.0)] * 3]), at(1.02))


def test_recorded_path_is_free_until_a_thing_is_seen_there_for_a_while() -> None:
    # A view that is sure adds 0.4 * 2.5 = 1.0; occupied is 0.8 and more; the path begins at -2.
    path = np.array([[-2.0, 0.0], [2.0, 0.0]])
    once, thrice = map_of([(ORIGIN, 1.0)], path), map_of([(ORIGIN, 1.0)] * 3, path)
    assert not is_occupied(once, at(1.02))
    assert is_occupied(once, at(0.72, 0.72))
    assert is_occupied(thrice, at(1.02))


def test_clearance_is_the_distance_to_the_nearest_occupied_cell() -> None:
    found = map_of([(ORIGIN, 1.0)] * 2)
    # The first occupied cell is that from 0.95 or 1.0 m on.
    assert found.clearance(at(0.325)) == pytest.approx(0.65, abs=0.05)
    assert found.clearance(np.array([[1.02, 0.0], [0.525, 0.0]])) == pytest.approx([0.0, 0.45], abs=0.05)
    assert map_of([]).clearance(at(0.0)) == OccupancySettings().size


def test_map_goes_with_the_robot_and_forgets_what_it_leaves_behind() -> None:
    found = map_of([(ORIGIN, 1.0)] * 2)
    found.centre(2.0, 0.5)
    assert is_occupied(found, at(1.02))
    assert found.clearance(at(0.325)) == pytest.approx(0.65, abs=0.05)
    found.centre(9.0, 0.5)
    found.centre(0.0, 0.0)
    assert not is_occupied(found, at(1.02))


def test_evidence_fades_with_time() -> None:
    found = map_of([(ORIGIN, 1.0)] * 2)  # 2.0
    found.fade(40.0 * math.log(2.0))  # half of it
    assert is_occupied(found, at(1.02))
    found.fade(40.0 * math.log(2.0))
    assert not is_occupied(found, at(1.02))


def test_map_is_of_the_frame_of_the_path() -> None:
    # The camera at (1, 2) looks to the left: 1 m ahead of it is (1, 3).
    found = map_of([(np.array([1.0, 2.0, math.pi / 2.0]), 1.0)] * 2)
    assert is_occupied(found, at(1.0, 3.02))
    assert not is_occupied(found, at(2.02, 2.0))


def test_cleared_map_knows_nothing() -> None:
    found = map_of([(ORIGIN, 1.0)] * 3)
    found.clear()
    assert not is_occupied(found, at(1.02))


def test_distances_that_vary_put_a_thing_where_it_most_likely_is() -> None:
    found = OccupancyMap(FAR)
    for free in (0.9, 1.1, 1.0, 0.95, 1.05):
        found.see(ORIGIN, BEARINGS, EDGES, hits(free))
    assert is_occupied(found, at(1.0))
    assert not is_occupied(found, at(0.6))


def test_settings_out_of_range_are_one_line() -> None:
    with pytest.raises(SettingError, match=r"memory is 0, must be 0.1 to 1e\+06"):
        OccupancySettings(memory=0.0)


def test_what_recorded_images_show_on_the_path_is_no_thing_there() -> None:
    path = np.array([[0.0, 0.0], [3.0, 0.0]])
    found = OccupancyMap(path)
    found.expect(ORIGIN, BEARINGS, EDGES, hits(1.0))
    for _ in range(6):
        found.see(ORIGIN, BEARINGS, EDGES, hits(1.0))
    assert not is_occupied(found, at(1.02)), "the robot that recorded the path drove here"
    assert is_occupied(found, at(0.82, 0.6)), "beside the path it may be a wall"
    for _ in range(12):
        found.see(ORIGIN, BEARINGS, EDGES, hits(1.5))
    assert is_occupied(found, at(1.52)), "the recorded images did not show this"


def test_low_thing_stays_in_the_map_when_it_is_too_near_to_be_seen() -> None:
    # Seen from 1 m, and then from 0.4 m, where the camera looks over it.
    near = np.array([0.62, 0.0, 0.0])
    views = [(ORIGIN, 1.0)] * 4 + [(near, None)] * 10
    assert is_occupied(map_of(views), at(1.02))
    assert not is_occupied(map_of(views, settings=OccupancySettings(blind=0.0)), at(1.02))
