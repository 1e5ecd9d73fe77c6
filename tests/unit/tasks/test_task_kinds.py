"""How episodes place robots and objects, and what scripts compute, worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.paths import path_length
from gibson_sim.tasks.episode import Item, Observation, item_root
from gibson_sim.tasks.furnishing import extent, height
from gibson_sim.tasks.ground import Ground, footprint, ground_of
from gibson_sim.tasks.kinds.object_search import HIDDEN, NEAR, ObjectSearch
from gibson_sim.tasks.kinds.point_goal import DISTANCE, RADIUS, THINGS, PointGoal
from gibson_sim.tasks.kinds.push_through import AWAY, PushThrough, _squared, _widths
from gibson_sim.tasks.placing import START_CLEARANCE, at_distance, clutter, free_place, no_room, on_floor
from gibson_sim.tasks.scripts.driving import pose_xy
from gibson_sim.tasks.scripts.handling import FINGERS, downwards, grip
from gibson_sim.types import Pose

BASE = "robot/base_footprint"


@pytest.fixture(scope="module")
def arena() -> Ground:
    return ground_of("arena", "gibson_bot")


def test_a_free_place_is_on_the_floor_and_clear_of_walls(arena: Ground) -> None:
    pose = free_place(arena, np.random.default_rng(1))
    assert pose.position[2] == arena.floor.floor_z
    assert arena.floor.clearance(pose_xy(pose)) >= arena.space.clearance + START_CLEARANCE


def test_a_pose_at_a_distance_has_a_path_of_that_length(arena: Ground) -> None:
    rng = np.random.default_rng(2)
    start = free_place(arena, rng)
    goal, distance = at_distance(arena, rng, start, 1.5, 2.5)
    assert 1.5 <= distance <= 2.5
    # Distances on the grid are a little longer than the smoothed path.
    assert path_length(arena.space.planner.path(pose_xy(start), pose_xy(goal))) <= distance + 0.1
    with pytest.raises(SceneError):
        at_distance(arena, rng, start, 500.0, 501.0)


def test_clutter_lies_along_the_path_and_leaves_places_clear(arena: Ground) -> None:
    path = np.array([[1.0, 2.2], [3.0, 2.2]])
    items = clutter(arena, np.random.default_rng(3), path, ("ball", "stool"), 4, keep_clear=[((1.0, 2.2), 0.5)], beside=0.3)
    assert 0 < len(items) <= 4
    assert [item.name for item in items] == [f"clutter_{k}" for k in range(1, len(items) + 1)]
    for item in items:
        x, y = pose_xy(item.pose)
        assert 0.7 <= x <= 3.3 and abs(y - 2.2) <= 0.3
        assert math.dist((x, y), (1.0, 2.2)) >= 0.5 + 0.26
        assert item.model in ("ball", "stool")


def test_poses_on_the_floor_are_upright(arena: Ground) -> None:
    pose = on_floor(arena, 1.0, 2.0, math.pi / 2)
    assert pose.position == (1.0, 2.0, arena.floor.floor_z)
    assert pose.quat_xyzw == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert str(no_room("fly", arena, "too low")) == "task fly: scene 'arena' has no room for it: too low; choose another scene"


def test_the_shortest_path_of_point_goal_is_the_path_without_objects_less_the_radius(arena: Ground) -> None:
    episode = PointGoal().generate(5, arena)
    assert episode.goal.position is not None
    length = path_length(arena.space.planner.path(pose_xy(episode.start), episode.goal.position[:2]))
    assert episode.shortest == pytest.approx(max(length - RADIUS, 0.1))
    assert length <= DISTANCE[1] + 0.1 and len(episode.items) <= THINGS


def test_boxes_of_push_through_fill_the_doorway_across(arena: Ground) -> None:
    assert [_squared(yaw) for yaw in (0.1, 1.4, -3.0)] == pytest.approx([0.0, math.pi / 2, -math.pi])
    # box_cardboard: 0.30 x 0.40 m, so 0.40 m across as it is, 0.30 m turned by a quarter.
    widths = {(model, turn > 0.0): width for model, turn, width in _widths()}
    assert widths["box_cardboard", False] == pytest.approx(0.40) and widths["box_cardboard", True] == pytest.approx(0.30)
    episode = PushThrough().generate(1, arena)
    door = min(arena.doors, key=lambda one: math.dist(one.center, pose_xy(episode.items[0].pose)))
    corners = np.concatenate([footprint(item.model, item.pose) for item in episode.items])
    yaw = _squared(door.yaw)
    across = corners @ [-math.sin(yaw), math.cos(yaw)]
    # What is left free beside the boxes is too narrow for the robot.
    assert door.width - np.ptp(across) < 2.0 * arena.robot.radius
    assert episode.shortest <= 2.0 * sum(AWAY)


def test_the_target_of_object_search_is_hidden_and_its_shortest_path_ends_near_it(arena: Ground) -> None:
    episode = ObjectSearch().generate(2, arena)
    assert episode.shortest >= HIDDEN - NEAR
    assert (episode.goal.radius, episode.goal.target) == (NEAR, episode.items[0].name)


def _observation(item: Item, yaw: float = 0.0) -> Observation:
    return Observation(0.0, {BASE: pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, yaw)), item_root(item): item.pose}, BASE)


def test_a_gripper_that_points_down_has_its_fingers_left_and_right_of_the_robot() -> None:
    item = Item("thing", "can_soda", Pose((1.0, 0.0, 0.5)))
    ahead, across, _ = downwards(_observation(item, math.pi / 2)).T
    assert ahead == pytest.approx((0.0, 0.0, -1.0))
    assert np.abs(across) == pytest.approx((1.0, 0.0, 0.0))


def test_an_oblong_object_is_grasped_at_its_narrow_sides() -> None:
    item = Item("thing", "remote_control", Pose((1.0, 0.0, 0.5)))
    low, high = extent(item.model)
    deep, wide = high[0] - low[0], high[1] - low[1]
    assert abs(deep - wide) > 0.01
    narrow = np.array([1.0, 0.0, 0.0] if deep < wide else [0.0, 1.0, 0.0])
    for yaw in (0.0, 0.7):
        turned = replace(item, pose=pose_from_xyz_rpy((1.0, 0.0, 0.5), (0.0, 0.0, yaw)))
        c, s = math.cos(yaw), math.sin(yaw)
        side = np.array([c * narrow[0] - s * narrow[1], s * narrow[0] + c * narrow[1], 0.0])
        assert abs(downwards(_observation(turned), turned)[:, 1] @ side) == pytest.approx(1.0)


@pytest.mark.parametrize("model", ["can_soda", "remote_control"])
def test_fingers_reach_over_tall_objects_and_not_into_the_table_beside_low_ones(model: str) -> None:
    item = Item("thing", model, Pose((1.0, 2.0, 0.5)))
    low, high = extent(model)
    tall = 0.5 + high[2] - FINGERS
    lowest = 0.5 + low[2] + FINGERS
    x, y, z = grip(item, _observation(item))
    assert (x, y) == pytest.approx((1.0 + (low[0] + high[0]) / 2, 2.0 + (low[1] + high[1]) / 2))
    assert z == pytest.approx(max(tall, lowest))
    assert (z > tall) == (height(model) < 2.0 * FINGERS)
