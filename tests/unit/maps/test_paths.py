"""Shortest paths and random free poses on a floor."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.paths import PathPlanner, distance_field, path_length, shortest_path
from gibson_sim.maps.traversability import floor_maps
from gibson_sim.scenes.load import load_scene

CELL = 0.05


def _floor(blocked: NDArray[np.bool_], cell: float = CELL) -> FloorMap:
    return FloorMap(cell, (0.0, 0.0), blocked, np.ones_like(blocked))


@pytest.fixture(scope="module")
def post() -> FloorMap:
    """4 x 4 m with a square of 1 m in the middle."""
    blocked = np.zeros((80, 80), dtype=bool)
    blocked[30:50, 30:50] = True
    return _floor(blocked)


@pytest.fixture(scope="module")
def flat(root: Path) -> FloorMap:
    """The floor of the flat."""
    return floor_maps(load_scene(root / "scenes/flat"))[0]


def test_free_line_of_sight_is_the_way() -> None:
    floor = _floor(np.zeros((80, 80), dtype=bool))
    way = shortest_path(floor, (0.52, 0.61), (3.3, 1.7), radius=0.3)
    np.testing.assert_allclose(way, [[0.52, 0.61], [3.3, 1.7]])


@pytest.mark.parametrize("radius", [0.0, 0.2, 0.3])
def test_way_around_a_square_is_as_long_as_the_taut_string(post: FloorMap, radius: float) -> None:
    # From the left to the right of the square: two tangents to the circles about its upper corners, their arcs, and its edge.
    start, goal = (0.5, 2.02), (3.5, 2.02)
    away, below = 1.0, 0.48
    straight = math.sqrt(away**2 + below**2 - radius**2)
    angle = math.atan2(below, away) + math.asin(radius / math.hypot(away, below))
    exact = 2 * (straight + radius * angle) + 1.0
    way = shortest_path(post, start, goal, radius=radius)
    assert path_length(way) == pytest.approx(exact, rel=0.02)
    assert way[0] == pytest.approx(start)
    assert way[-1] == pytest.approx(goal)


def test_way_through_the_flat_is_within_2_percent_of_that_on_a_grid_four_times_as_fine(root: Path) -> None:
    floor = floor_maps(load_scene(root / "scenes/flat"), resolution=0.1)[0]
    masks = (np.kron(mask, np.ones((4, 4), dtype=bool)) for mask in (floor.occupied, floor.floor))
    coarse, exact = PathPlanner(floor, 0.2), PathPlanner(FloorMap(0.025, floor.origin, *masks), 0.2)
    ends = (2.4, 6.0), (7.6, 1.1)
    assert path_length(coarse.path(*ends)) == pytest.approx(path_length(exact.path(*ends)), rel=0.02)


def test_way_keeps_its_distance(flat: FloorMap) -> None:
    way = shortest_path(flat, (1.0, 4.7), (6.4, 3.3), radius=0.25)
    along = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(way)])
    assert flat.clearance(along).min() >= 0.25 - flat.resolution * math.sqrt(0.5)


def test_distance_field_is_the_length_of_the_way(post: FloorMap) -> None:
    field = distance_field(post, (0.525, 2.025), radius=0.2)
    assert field[tuple(post.cells((0.525, 2.025)))] == 0.0
    length = path_length(shortest_path(post, (3.525, 2.025), (0.525, 2.025), radius=0.2))
    assert field[tuple(post.cells((3.525, 2.025)))] == pytest.approx(length, rel=0.02)
    assert np.isinf(field[tuple(post.cells((2.0, 2.0)))])


def test_place_without_a_way_is_an_error() -> None:
    blocked = np.zeros((80, 80), dtype=bool)
    blocked[:, 40] = True
    with pytest.raises(SceneError, match=r"no path leads from \(1\.00, 1\.00\) to \(3\.00, 1\.00\)"):
        shortest_path(_floor(blocked), (1.0, 1.0), (3.0, 1.0), radius=0.2)
    with pytest.raises(SceneError, match=r"goal \(9\.00, 1\.00\) is not free"):
        shortest_path(_floor(blocked), (1.0, 1.0), (9.0, 1.0), radius=0.2)


def test_ways_do_not_slip_between_two_cells_that_meet_at_a_corner() -> None:
    blocked = ~np.eye(40, dtype=bool)[::-1]
    with pytest.raises(SceneError, match="no path"):
        shortest_path(_floor(blocked), (0.025, 1.975), (1.975, 0.025), radius=0.0)


def test_free_poses_keep_their_distances_and_point_anywhere(flat: FloorMap) -> None:
    poses = random_free_poses(flat, 40, np.random.default_rng(5), clearance=0.3, spacing=0.4)
    points = np.array([pose.position[:2] for pose in poses])
    gaps = np.linalg.norm(points[:, None] - points[None], axis=-1)[np.triu_indices(40, 1)]
    assert gaps.min() >= 0.4
    assert flat.clearance(points).min() >= 0.3
    assert {pose.position[2] for pose in poses} == {flat.floor_z}
    assert np.ptp([yaw_from_quat(pose.quat_xyzw) for pose in poses]) > 5.0


def test_equal_seeds_give_equal_poses(flat: FloorMap) -> None:
    one, same, other = (random_free_poses(flat, 5, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == same
    assert one != other


def test_more_poses_than_fit_are_refused(flat: FloorMap) -> None:
    with pytest.raises(SceneError, match="of 500 poses fit"):
        random_free_poses(flat, 500, np.random.default_rng(0), spacing=1.0)
