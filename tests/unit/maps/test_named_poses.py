"""Named poses in the flat and in other scenes, and without a floor."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.maps.named_poses import DEFAULT_HEIGHT, DEFAULT_RADIUS, FREE_PLACES, NamedPose, named_poses
from gibson_sim.resources import known_scenes
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec, StartPose
from gibson_sim.types import Pose
from support.scenes import write_house


@pytest.fixture(scope="module")
def flat() -> SceneSpec:
    return load_scene("flat")


@pytest.fixture(scope="module")
def poses(flat: SceneSpec) -> tuple[NamedPose, ...]:
    return named_poses(flat)


def tagged(poses: tuple[NamedPose, ...], tag: str) -> list[NamedPose]:
    return [pose for pose in poses if tag in pose.tags]


def test_names_are_unique_and_all_kinds_are_there(flat: SceneSpec, poses: tuple[NamedPose, ...]) -> None:
    names = [pose.name for pose in poses]
    assert len(set(names)) == len(names)
    assert [pose.name for pose in tagged(poses, "start")] == [start.name for start in flat.starts]
    assert len(tagged(poses, "free")) == FREE_PLACES
    assert [pose.name for pose in tagged(poses, "room")] == [f"floor_0/{room.name}" for room in flat.rooms]


def test_doors_are_where_the_walls_of_the_flat_have_them(poses: tuple[NamedPose, ...]) -> None:
    doors = [door.pose.position[:2] for door in tagged(poses, "door")]
    for wanted in ((2.45, 5.3), (4.05, 3.95), (6.45, 3.95), (7.45, 5.3)):
        assert min(math.dist(wanted, door) for door in doors) < 0.2, wanted


def test_doors_are_called_by_the_rooms_that_they_connect(poses: tuple[NamedPose, ...]) -> None:
    doors = {door.name: door for door in tagged(poses, "door")}
    assert {"floor_0/door_living_kitchen", "floor_0/door_living_hall", "floor_0/door_kitchen_hall"} <= set(doors)
    assert doors["floor_0/door_hall_bathroom"].description == "door 0.8 m wide, from hall to bathroom"
    # From the hall to the bathroom, which is towards positive y.
    assert doors["floor_0/door_hall_bathroom"].pose.quat_xyzw[2] == pytest.approx(math.sqrt(0.5), abs=0.05)


@pytest.mark.shipped
@pytest.mark.parametrize("name", sorted(known_scenes()))
def test_every_room_that_a_scene_names_has_one_place_where_a_robot_can_stand(name: str) -> None:
    scene = load_scene(name)
    found = named_poses(scene)
    assert len({pose.name for pose in found}) == len(found)
    for number, floor_z in enumerate(scene.floors):
        rooms = {f"floor_{number}/{room.name}": room for room in scene.rooms if room.floor == number}
        poses = {pose.name: pose for pose in found if {"room", f"floor_{number}"} <= set(pose.tags)}
        assert list(poses) == list(rooms)
        floor = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=DEFAULT_HEIGHT)
        for key, room in rooms.items():
            xy = poses[key].pose.position[:2]
            assert scene.room_at(*xy, number) is room
            assert float(floor.clearance(np.array(xy))) >= DEFAULT_RADIUS
            assert room.room_class in poses[key].tags
        doors = [pose for pose in found if {"door", f"floor_{number}"} <= set(pose.tags)]
        assert all(float(door.description.split()[1]) >= 0.7 for door in doors)
        # At least one for each room.
        words = {word for door in doors for word in door.description.split()}
        opened = {word for pose in found if "opening" in pose.tags for word in pose.description.split()}
        assert {room.name for room in rooms.values()} <= words | opened


def test_rooms_without_a_name_are_numbered_beside_those_with_one(flat: SceneSpec) -> None:
    known = tuple(room for room in flat.rooms if room.name in ("hall", "kitchen"))
    found = named_poses(replace(flat, rooms=known))
    names = [pose.name for pose in tagged(found, "room")]
    assert names == ["floor_0/kitchen", "floor_0/hall", "floor_0/room_0", "floor_0/room_1", "floor_0/room_2"]
    assert "floor_0/door_kitchen_hall" in [pose.name for pose in found]


def test_boxes_of_free_places_and_starts_hold_nothing_but_floor(flat: SceneSpec, poses: tuple[NamedPose, ...]) -> None:
    floor = scene_floor_map(flat, robot_height=0.5)
    for pose in [*tagged(poses, "start"), *tagged(poses, "free")]:
        assert pose.low[0] < 0.0 < pose.high[0]
        grid = np.array(list(itertools.product(*(np.linspace(pose.low[i], pose.high[i], 9) * 0.99 for i in (0, 1)), [0.0])))
        world = transform_points(matrix_from_pose(pose.pose), grid)
        assert floor.free[tuple(floor.cells(world[:, :2]).T)].all(), pose.name


def test_free_places_are_far_from_each_other(poses: tuple[NamedPose, ...]) -> None:
    places = [pose.pose.position for pose in tagged(poses, "free")]
    assert min(math.dist(a, b) for a, b in itertools.combinations(places, 2)) > 1.5


def test_room_is_not_larger_than_its_box(poses: tuple[NamedPose, ...]) -> None:
    for room in tagged(poses, "room"):
        area = float(room.description.split()[2])
        assert area <= (room.high[0] - room.low[0]) * (room.high[1] - room.low[1])
        assert room.low[0] < 0.0 < room.high[0]


def test_equal_scenes_have_equal_poses(flat: SceneSpec, poses: tuple[NamedPose, ...]) -> None:
    assert named_poses(replace(flat, revision=9)) == poses


def test_scene_without_a_floor_has_its_start_poses_alone() -> None:
    scene = SceneSpec("void", Path("/nowhere"), "0", (), (), starts=(StartPose("here", Pose((1.0, 2.0, 3.0))),))
    assert [pose.name for pose in named_poses(scene)] == ["here"]


@pytest.fixture
def house(tmp_path: Path) -> SceneSpec:
    return load_scene(write_house(tmp_path))


def test_every_floor_has_places_of_its_own(house: SceneSpec) -> None:
    found = named_poses(house)
    assert (house.floors, house.floor_z) == ((0.0, 3.0), 0.0)
    for number, z in enumerate((0.0, 3.0)):
        free = [p for p in found if p.name.startswith(f"floor_{number}/free_")]
        assert free and {p.pose.position[2] for p in free} == {z}
        assert all(f"floor_{number}" in p.tags for p in free)
    # The upper floor covers the lower half of y alone.
    assert max(p.pose.position[1] for p in found if p.name.startswith("floor_1/free_")) < 2.0
    assert {p.name: p.tags[1] for p in found if "start" in p.tags} == {"below": "floor_0", "above": "floor_1"}
