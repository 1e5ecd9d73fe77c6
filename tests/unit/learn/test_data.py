"""Ground truth for images of drives: free distances, relative poses, pairs, shards. No scene is loaded."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import item_body
from gibson_sim_learn.path_following.clutter import (
    FURNITURE_KINDS,
    OBJECT_KINDS,
    OBSTACLE_KINDS,
    random_furniture,
    random_object,
    random_obstacle,
)
from gibson_sim_learn.path_following.data import (
    FREE_EDGES,
    Shard,
    column_bearings,
    distance_labels,
    free_distances,
    is_match,
    load_shard,
    make_pairs,
    median_distances,
    missing_shards,
    relative_pose,
    save_shard,
    smooth_path,
)
from gibson_sim_learn.path_following.distances.obstacles import poses_around
from gibson_sim_learn.path_following.drawing import HFOV
from gibson_sim_learn.path_following.layout import OBJECT_MODELS, ItemMaker

CELL = 0.05


def room() -> FloorMap:
    """Returns a room of 4 x 4 m from the origin on, with a wall at x = 3 m that leaves y > 3 m free."""
    occupied = np.zeros((80, 80), bool)
    occupied[:60, 60:62] = True
    return FloorMap(CELL, (0.0, 0.0), occupied, np.ones((80, 80), bool))


def test_free_distance_ends_at_the_wall() -> None:
    found = free_distances(room(), np.array([[1.0, 2.0, 0.0]]), np.array([0.0, math.pi]))
    np.testing.assert_allclose(found, [[2.0, 1.0]], atol=0.02)


def test_free_distance_is_at_most_three_metres_and_turns_with_the_robot() -> None:
    found = free_distances(room(), np.array([[0.5, 3.5, 0.0], [0.5, 3.5, -math.pi / 2.0]]), np.array([0.0]))
    np.testing.assert_allclose(found[:, 0], [3.0, 3.0])


def test_directions_go_from_left_to_right() -> None:
    bearings = column_bearings(HFOV, 2)
    # The middles of two halves lie at half the tangent of half the field of view.
    assert bearings[0] == pytest.approx(math.atan(0.5 * math.tan(HFOV / 2.0)))
    assert bearings[1] == pytest.approx(-bearings[0])


def test_relative_pose_is_in_the_frame_of_the_first() -> None:
    found = relative_pose(np.array([1.0, 1.0, math.pi / 2.0]), np.array([0.5, 3.0, math.pi]))
    np.testing.assert_allclose(found, [2.0, 0.5, math.pi / 2.0], atol=1e-12)


def test_images_with_another_heading_or_far_away_do_not_match() -> None:
    poses = np.array([[1.0, 0.2, 0.3], [3.0, 0.0, 0.0], [1.0, 1.5, 0.0], [1.0, 0.0, 1.5], [-1.0, 0.0, 0.0]])
    assert is_match(poses).tolist() == [True, False, False, False, False]


def test_pairs_are_those_ahead_on_the_same_path_and_some_of_others() -> None:
    later = np.array([[1.0, 2.0, 0.0]])
    recorded = np.array([[0.0, 2.0, 0.0], [2.0, 2.0, 0.0], [3.5, 2.0, 0.0], [2.0, 2.2, 0.0]])
    # Rows are 5 cm: the first is 1 m behind, the second 1 m ahead, the third 2.5 m; the fourth is on another path.
    pairs = make_pairs(
        later, [(0, 20)], recorded, [(0, 0), (0, 40), (0, 70), (1, 20)], room(), np.random.default_rng(0), negatives=0
    )
    assert pairs["recorded"].tolist() == [1]
    np.testing.assert_allclose([pairs["x"][0], pairs["y"][0], pairs["yaw"][0]], [1.0, 0.0, 0.0])
    assert pairs["match"].all()


def test_images_with_a_wall_between_do_not_match() -> None:
    pairs = make_pairs(
        np.array([[2.5, 1.0, 0.0]]),
        [(0, 0)],
        np.array([[3.5, 1.0, 0.0]]),
        [(0, 20)],
        room(),
        np.random.default_rng(0),
        negatives=0,
    )
    assert pairs["match"].tolist() == [False]


def test_smooth_path_rounds_its_corner_and_looks_along_it() -> None:
    floor = FloorMap(CELL, (0.0, 0.0), np.zeros((80, 80), bool), np.ones((80, 80), bool))
    path = smooth_path(np.array([[0.5, 0.5], [2.0, 0.5], [2.0, 2.0]]), floor.free, floor)
    np.testing.assert_allclose(path[0], [0.5, 0.5, 0.0], atol=0.02)
    assert path[-1, 2] == pytest.approx(math.pi / 2.0, abs=0.02)
    assert np.linalg.norm(path[:, :2] - [2.0, 0.5], axis=1).min() > 0.05
    assert np.abs(np.diff(path[:, 2])).max() < 0.4


def test_labels_of_a_distance_are_around_it_and_sum_to_one() -> None:
    labels = distance_labels(np.array([[0.55, 1.0], [2.999, 3.0]], np.float32))
    assert labels.shape == (2, 2, len(FREE_EDGES))
    np.testing.assert_allclose(labels.sum(axis=2), 1.0, atol=1e-6)
    np.testing.assert_allclose(
        labels[0, 0, 4:7], [0.0205, 0.959, 0.0205], atol=0.001
    )  # logistic: 1 / (1 + exp(1.702 * 0.05 / 0.022)) to either side
    np.testing.assert_allclose(labels[0, 1, 9:11], 0.486, atol=0.001)
    assert labels[1, :, -1].tolist() == [1.0, 1.0], "as far as is looked: nothing is there"


@pytest.mark.parametrize(("make", "expected"), [(random_object, OBJECT_KINDS), (random_obstacle, OBSTACLE_KINDS)])
def test_random_objects_stand_on_the_floor_and_are_none_of_table_2(make: ItemMaker, expected: tuple[str, ...]) -> None:
    kinds = set()
    for seed in range(80):
        item = make(np.random.default_rng(seed), f"thing_{seed}")
        assert item.text == make(np.random.default_rng(seed), f"thing_{seed}").text
        body = item_body(item)
        corners, _ = body_triangles(SceneSpec("thing", Path(), "", (), (), bodies=(body,)))
        assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-4)
        assert 0.12 <= corners[:, 2].max() <= 2.0
        assert np.abs(corners[:, :2]).max() < 0.75
        kinds.add(item.model)
    assert kinds == set(expected)
    assert kinds.isdisjoint(OBJECT_MODELS)


def test_random_furniture_stands_on_the_floor_and_is_none_of_table_2() -> None:
    kinds = set()
    for seed in range(60):
        item = random_furniture(np.random.default_rng(seed), f"furniture_{seed}")
        corners, _ = body_triangles(SceneSpec("thing", Path(), "", (), (), bodies=(item_body(item),)))
        assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-4)
        assert 0.15 <= corners[:, 2].max() <= 2.1
        assert np.linalg.norm(np.ptp(corners[:, :2], axis=0)) < 2.5
        kinds.add(item.model)
    assert kinds == set(FURNITURE_KINDS)
    assert kinds.isdisjoint(OBJECT_MODELS)


def test_obstacles_are_seen_from_where_the_robot_fits_and_not_through_walls() -> None:
    place = np.array([[2.5, 1.0]])
    poses = poses_around(place, room(), room(), np.random.default_rng(0))
    assert len(poses) > 20
    assert (room().clearance(poses[:, :2]) >= 0.2).all()
    beyond = poses[poses[:, 0] > 3.1]
    crossing = 1.0 + (beyond[:, 1] - 1.0) * 0.6 / (beyond[:, 0] - 2.5)
    assert (crossing > 2.9).all(), "the wall at x = 3.1 m hides it, but for its end at y = 3 m"
    away = np.linalg.norm(place - poses[:, :2], axis=1)
    assert away.min() >= 0.5 and away.max() <= 2.6
    bearing = np.arctan2(*(place - poses[:, :2]).T[::-1]) - poses[:, 2]
    assert abs(np.median((bearing + math.pi) % (2.0 * math.pi) - math.pi)) < 0.1


def test_shards_come_back_as_they_were_saved(tmp_path: Path) -> None:
    shard = _shard(3)
    save_shard(tmp_path / "a-000", shard)
    found = load_shard(tmp_path / "a-000")
    np.testing.assert_array_equal(found.images, shard.images)
    np.testing.assert_array_equal(found.pairs, shard.pairs)
    assert list(missing_shards(tmp_path, ("a", "b"), 2)) == [("b", 0), ("a", 1), ("b", 1)]


def test_broken_shard_is_one_line(tmp_path: Path) -> None:
    save_shard(tmp_path / "a-000", _shard(3))
    (tmp_path / "a-000" / "free.npy").write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="not a shard of data"):
        load_shard(tmp_path / "a-000")


def _shard(count: int) -> Shard:
    rng = np.random.default_rng(0)
    poses = np.column_stack([np.linspace(0.5, 1.5, count), np.full(count, 2.0), np.zeros(count)])
    pairs = make_pairs(poses, [(0, 0)] * count, poses, [(0, 0)] * count, room(), rng)
    images = rng.integers(0, 256, (count, 64, 96, 3)).astype(np.uint8)
    return Shard(images, np.ones((count, 24), np.float32), pairs)


def test_median_distance_lies_in_the_bin_that_reaches_one_half() -> None:
    edges = np.array([0.0, 1.0, 2.0, 4.0])
    hit = np.array([[0.0, 0.25, 0.5, 0.25], [1.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.8]])
    np.testing.assert_allclose(median_distances(edges, hit), [3.0, 0.5, 4.0])
