"""Doors: those that are found in homes, and one that a scripted robot opens."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.tasks.episode import Observation, item_body
from gibson_sim.tasks.ground import Ground, ground_of
from gibson_sim.tasks.kinds.open_door import DAMPINGS, FRICTIONS, HANDLE_HEIGHTS, OPEN, OpenDoor, episode_door
from gibson_sim.tasks.run import TaskRun, run_episode
from gibson_sim.tasks.scripts.doors import (
    DoorChange,
    HingedDoor,
    backing_path,
    changed_door,
    doorway,
    hinged_door,
    leaf_outline,
    scene_doors,
    with_bodies,
)
from gibson_sim.types import Pose

TASK = OpenDoor()


@pytest.fixture(scope="module")
def home() -> Ground:
    return ground_of("linden_flat", "arm_bot")


def _body(model: str, pose: Pose | None = None) -> BodySpec:
    body = load_spawnable(model, "", name="thing", pose=pose or Pose())
    assert isinstance(body, BodySpec)
    return body


def _door(model: str, pose: Pose | None = None) -> HingedDoor:
    door = hinged_door(_body(model, pose))
    assert door is not None
    return door


@pytest.mark.parametrize(("model", "sense", "width"), [("door_90_left", 1.0, 0.874), ("door_80_right", -1.0, 0.774)])
def test_a_door_says_where_its_hinge_is_and_how_it_opens(model: str, sense: float, width: float) -> None:
    door = _door(model, pose_from_xyz_rpy((2.0, 1.0, 0.0), (0.0, 0.0, math.pi / 2)))
    assert door.hinge == (2.0, 1.0) and door.bearing == pytest.approx(math.pi / 2) and door.sense == sense
    assert door.width == pytest.approx(width) and door.handle_z == pytest.approx(1.02)
    assert door.stop == pytest.approx(math.radians(100.0), abs=1e-4)
    # Open by a quarter turn its handle is where the closed leaf's side is.
    assert door.at(math.pi / 2) == pytest.approx(door.off(0.0, door.radius))
    assert door.away(np.array([door.at(0.5)]))[0] > 0.0


@pytest.mark.parametrize("model", ["cabinet_doors", "fridge_body", "sliding_door_90", "window_casement", "mug"])
def test_only_hinged_doors_are_recognised_as_doors(model: str) -> None:
    assert hinged_door(_body(model)) is None


def test_the_opening_is_the_angle_between_the_leaf_and_the_closed_leaf() -> None:
    door = _door("door_90_left", pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    leaf = pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 1.0 + 1.2))
    assert door.opening(Observation(0.0, {door.leaf: leaf}, "")) == pytest.approx(1.2)


def test_a_changed_door_has_another_handle_and_hinge_and_its_meshes() -> None:
    model = _body("door_90_right").model
    text = changed_door(model.path, DoorChange(handle_height=0.95, damping=4.0, friction=1.5, handle_friction=0.31))
    body = load_spawnable("", text, name="changed", pose=Pose())
    assert isinstance(body, BodySpec)
    door = hinged_door(body)
    assert door is not None and door.handle_z == pytest.approx(0.95)
    hinge = next(joint for joint in body.model.joints if joint.name == "hinge")
    assert (hinge.damping, hinge.friction) == (4.0, 1.5)
    assert body.model.link("handle").friction == 0.31
    meshes = [Path(visual.shape.mesh) for link in body.model.links for visual in link.visuals if visual.shape.kind == "mesh"]
    assert len(meshes) == 2 and all(mesh.is_file() for mesh in meshes)


def test_the_way_back_keeps_the_hand_off_the_edge_of_the_leaf() -> None:
    door = _door("door_90_left")
    way = backing_path(door, math.radians(45.0), math.radians(90.0))
    assert way.openings[-1] > math.radians(80.0) and (np.diff(way.openings) > 0.0).all()
    base = way.places[-1, 0], way.places[-1, 1], way.yaws[-1]
    assert way.speeds(base, way.openings[-1]) == pytest.approx((0.0, 0.0))
    assert way.speeds(base, way.openings[0])[0] > 0.0


def test_doors_of_a_home_are_found_and_doors_without_clearance_are_skipped(home: Ground) -> None:
    doors = {door.body: door for door in scene_doors(home.scene)}
    assert set(doors) == {"front_door", "bedroom_1_door", "bedroom_2_door", "bathroom_door"}
    there = doorway(home, doors["bedroom_1_door"], ("bedroom_1_door",))
    assert there is not None and there.wide > OPEN
    assert doorway(home, doors["front_door"], ("front_door",)) is None  # nothing to go to is behind it
    cells = home.floor.centers(np.argwhere(there.near))
    assert (there.door.away(cells) > 0.0).all() and (there.door.away(home.floor.centers(np.argwhere(there.far))) < 0.0).all()


def test_open_doors_and_loose_objects_are_obstacles_unless_excluded(home: Ground) -> None:
    door = next(door for door in scene_doors(home.scene) if door.body == "bedroom_1_door")
    swung = leaf_outline(door, math.radians(77.349)).mean(axis=0)
    assert with_bodies(home, ()).floor.clearance(swung) == 0.0
    assert with_bodies(home, ("bedroom_1_door",)).floor.clearance(swung) > 0.2


def test_equal_seeds_give_equal_doors_and_others_differ() -> None:
    arena = ground_of("arena", "arm_bot")
    assert TASK.generate(5, arena) == TASK.generate(5, arena) != TASK.generate(6, arena)


def test_episodes_in_a_home_close_one_of_its_doors_and_differ_by_seed(home: Ground) -> None:
    first, other = (TASK.generate(seed, home) for seed in (5, 6))
    assert first.removed == ("bedroom_1_door",) and first.items[0].name == "door"
    door = episode_door(first)
    assert HANDLE_HEIGHTS[0] < door.handle_z < HANDLE_HEIGHTS[1] and door.handle_z != episode_door(other).handle_z
    hinge = next(joint for joint in item_body(first.items[0]).model.joints if joint.name == "hinge")
    assert DAMPINGS[0] < hinge.damping < DAMPINGS[1] and FRICTIONS[0] < hinge.friction < FRICTIONS[1]
    assert first.goal.position is not None
    sides = door.away(np.array([first.start.position[:2], first.goal.position[:2]]))
    assert sides[0] > 0.8 and sides[1] < -0.8


def test_a_home_without_a_door_with_room_is_refused() -> None:
    with pytest.raises(SceneError, match="no door that a robot has the room to pull open"):
        TASK.generate(0, ground_of("flat", "arm_bot"))


def test_the_script_opens_a_door_and_goes_through_without_touching_a_wall() -> None:
    widest = 0.0

    def watch(obs: Observation) -> None:
        nonlocal widest
        widest = max(widest, episode_door(run.episode).opening(obs))

    with TaskRun(TASK) as run:
        found = run_episode(run, 4, "scripted", watch)
        assert found.success and found.time < 60.0 and widest > math.radians(75.0)
        assert episode_door(run.episode).opening(run.observation) > OPEN
