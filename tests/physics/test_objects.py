"""Our objects in the engine: they settle, keep their limits, come to rest, gain no energy, and can be grasped by their handles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.geometry.transforms import matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose, SceneState
from gibson_sim_tools.making.objects.catalogue import JOINED, OBJECTS, door_names
from gibson_sim_tools.making.objects.model import ObjectJoint, ObjectModel

HZ = 240
TABLE_Z = 0.75
DROPPED = (
    "bottle_water", "bottle_wine", "can_soda", "can_food", "cup", "mug", "bowl", "plate", "glass_tumbler", "book_a", "book_stack", "box_cereal",
    "vase", "candle", "teapot", "laptop", "keyboard", "remote_control", "fruit_apple", "clock",
)  # fmt: skip
DEEPEST = 2e-3
JOINED_NAMES = tuple(model.name for model in JOINED)


def body(name: str, pose: Pose, joints: Sequence[tuple[str, float]] = ()) -> BodySpec:
    found = load_spawnable(name, "", name=name, pose=pose)
    assert isinstance(found, BodySpec)
    return replace(found, joints=tuple(joints))


def world_of(*bodies: BodySpec, collisions: tuple[CollisionSpec, ...] = ()) -> PhysicsWorld:
    return PhysicsWorld(SceneSpec("objects", Path("/nowhere"), "", (), collisions, ground_z=0.0, bodies=bodies), step_hz=HZ)


def moving(model: ObjectModel) -> list[ObjectJoint]:
    return [joint for joint in model.joints if joint.kind != "fixed"]


def positions(model: ObjectModel, state: SceneState) -> NDArray[np.float64]:
    """Returns the joint positions, radians or metres."""
    found = []
    for joint in moving(model):
        parent, child = (state.links.index(f"{model.name}/{link}") for link in (joint.parent, joint.child))
        turn = matrix_from_quat(state.quats_xyzw[parent])
        offset = turn.T @ (state.positions[child] - state.positions[parent]) - joint.origin
        rotation = turn.T @ matrix_from_quat(state.quats_xyzw[child])
        spin = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
        angle = math.atan2(float(np.dot(spin, joint.axis)), float(np.trace(rotation)) - 1.0)
        found.append(float(np.dot(offset, joint.axis)) if joint.kind == "prismatic" else angle)
    return np.array(found)


def energy(spec: BodySpec, state: SceneState) -> float:
    """Returns the kinetic energy, of translation and rotation, and the potential energy, J."""
    total = 0.0
    for link in spec.model.links:
        if link.inertial is None:
            continue
        row = state.links.index(f"{spec.name}/{link.name}")
        turn = matrix_from_quat(state.quats_xyzw[row])
        arm = turn @ np.array(link.inertial.pose.position)
        velocity = state.twists[row, :3] + np.cross(state.twists[row, 3:], arm)
        spin = turn.T @ state.twists[row, 3:]
        ixx, ixy, ixz, iyy, iyz, izz = link.inertial.inertia
        inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        mass, height = link.inertial.mass, float(state.positions[row, 2] + arm[2])
        total += 0.5 * mass * float(velocity @ velocity) + 0.5 * float(spin @ inertia @ spin) + mass * 9.81 * height
    return total


def test_twenty_objects_dropped_on_a_table_settle_less_than_two_millimetres_deep() -> None:
    table = CollisionSpec("table", Shape("box", (3.0, 2.4, 0.04)), Pose((0.0, 0.0, TABLE_Z - 0.02)))
    bodies = [
        body(name, pose_from_xyz_rpy((-1.1 + 0.55 * (k % 5), -0.8 + 0.5 * (k // 5), TABLE_Z + 0.08), (0.0, 0.0, 0.7 * k)))
        for k, name in enumerate(DROPPED)
    ]
    assert len(bodies) == 20
    with world_of(*bodies, collisions=(table,)) as world:
        # They hit, rock and come to rest.
        world.step(HZ)
        for _ in range(10):
            world.step(HZ // 4)
            assert min((c.distance for name in DROPPED for c in world.contacts(name)), default=0.0) > -DEEPEST
        for name in DROPPED:
            contacts = world.contacts(name)
            assert {c.body_b for c in contacts} == {"table"}, name
            assert min(c.distance for c in contacts) > -DEEPEST, name
            assert np.abs(np.concatenate(world.body_twist(name))).max() < 5e-3, name
            assert world.body_pose(name).position[2] == pytest.approx(TABLE_Z, abs=DEEPEST if name != "book_stack" else 0.015)


@pytest.mark.parametrize("name", JOINED_NAMES)
def test_joints_swing_free_without_gaining_energy_keep_their_limits_and_come_to_rest(name: str) -> None:
    """Half open, then released; the whole body leans, so that level joints move."""
    model = OBJECTS[name]
    joints = moving(model)
    lower, upper = (np.array([getattr(joint, side) for joint in joints]) for side in ("lower", "upper"))
    start = [(joint.name, (joint.lower + joint.upper) / 2) for joint in joints]
    # Leaning by 0.2 rad, gravity drives every joint against one of its stops.
    spec = replace(body(name, pose_from_xyz_rpy((0.0, 0.0, 3.0), (0.2, -0.2, 0.0)), start), static=True)
    seen, places = [], []
    with world_of(spec) as world:
        assert not world.warnings
        for _ in range(120):
            state = world.state()
            seen.append(energy(spec, state))
            places.append(positions(model, state))
            world.step(10)
        last = world.state()
    energies, at = np.array(seen), np.array(places)
    fallen = energies[0] - energies.min()
    assert fallen > 0.05, "it moved"
    # At most the integrator's error of a free fall in one step, m g^2 dt^2 / 2, may be gained.
    noise = model.mass * (9.81 / HZ) ** 2 / 2
    assert (energies - np.minimum.accumulate(energies)).max() < noise
    stops = np.array([math.radians(1.5) if joint.kind == "revolute" else 3e-3 for joint in joints])
    assert (at > lower - stops).all() and (at < upper + stops).all()
    assert (at[-1] > lower - 1e-3).all() and (at[-1] < upper + 1e-3).all()
    assert np.abs(last.twists).max() < 1e-2


@pytest.mark.parametrize(("name", "opens"), [("door_80_left", 1.0), ("door_80_right", -1.0)])
def test_a_left_door_opens_to_the_left_and_a_right_one_to_the_right(name: str, opens: float) -> None:
    with world_of(body(name, Pose(), [("hinge", math.radians(90.0))])) as world:
        state = world.state()
        handle = state.positions[state.links.index(f"{name}/handle")]
        assert handle == pytest.approx((0.0, opens * 0.714, 1.02), abs=1e-6)


def test_the_door_of_the_oven_stays_shut_and_stays_open() -> None:
    model = OBJECTS["oven_body"]
    for start, rest in ((0.0, 0.0), (80.0, 90.0)):
        with world_of(replace(body("oven_body", Pose(), [("door", math.radians(start))]), static=True)) as world:
            world.step(2 * HZ)
            assert math.degrees(positions(model, world.state())[0]) == pytest.approx(rest, abs=0.2)


def test_drawers_and_doors_stand_still_where_they_are_left() -> None:
    start = [("drawer_1", 0.1), ("drawer_3", 0.25)]
    with world_of(body("cabinet_drawers", Pose(), start)) as world:
        world.step(2 * HZ)
        assert positions(OBJECTS["cabinet_drawers"], world.state()) == pytest.approx([0.1, 0.0, 0.25], abs=5e-3)
        assert world.body_pose("cabinet_drawers").quat_xyzw[3] == pytest.approx(1.0, abs=1e-4), "it does not tip over"


HANDLES = {
    **{name: ("hinge", (0.65, side * 0.037, 1.02), (0.0, 1.0 if name.endswith("left") else -1.0, 0.0))
       for name in door_names() if "80" in name for side in ((-1.0,) if name.endswith("left") else (1.0,))},
    "sliding_door_90": ("slide", (0.043, 0.045, 1.05), (1.0, 0.0, 0.0)),
    "cabinet_drawers": ("drawer_2", (0.204, 0.0, 0.416), (1.0, 0.0, 0.0)),
    "cabinet_doors": ("door_right", (0.204, -0.034, 0.46), (1.0, 0.0, 0.0)),
    "fridge_body": ("door", (0.319, 0.250, 1.10), (1.0, 0.0, 0.0)),
    "oven_body": ("door", (0.2745, 0.0, 0.4475), (1.0, 0.0, 0.0)),
    "window_casement": ("hinge", (0.72, 0.044, 0.53), (0.0, 1.0, 0.0)),
}  # fmt: skip
"""Object -> joint, position of a fingertip at its handle, and the direction in which it pulls or pushes."""


@pytest.mark.parametrize("name", HANDLES)
def test_a_finger_at_the_handle_finds_room_and_opens_it(name: str) -> None:
    joint, place, way = HANDLES[name]
    model = OBJECTS[name]
    tip = Shape("sphere", (0.006, 0.0, 0.0))
    inertial = Inertial(50.0, Pose(), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    finger = UrdfModel("finger", Path("/nowhere/f.urdf"), (UrdfLink("tip", (), (UrdfCollision(tip, Pose()),), inertial),), ())
    with world_of(replace(body(name, Pose()), static=True), BodySpec("finger", finger, Pose(place))) as world:
        world.step()
        assert not [c for c in world.contacts("finger") if c.distance < 0.0], "there is room for a finger"
        speed = 0.24
        for k in range(HZ // 2):
            x, y, z = (np.array(place) + np.array(way) * speed * k / HZ).tolist()
            world.set_state("finger", Pose((x, y, z)), (speed * way[0], speed * way[1], speed * way[2]), (0.0, 0.0, 0.0))
            world.step()
        index = [one.name for one in moving(model)].index(joint)
        assert positions(model, world.state())[index] > (0.05 if "slide" in joint or "drawer" in joint else math.radians(5.0))


def test_balls_come_to_rest_and_bottles_that_fell_over_stop_rolling() -> None:
    lying = pose_from_xyz_rpy((0.0, 1.0, 0.034), (math.pi / 2, 0.0, 0.0))
    with world_of(
        body("ball", Pose()), body("bottle_wine", lying), body("can_soda", replace(lying, position=(0.0, 2.0, 0.034)))
    ) as world:
        for name in ("ball", "bottle_wine", "can_soda"):
            world.set_state(name, linear=(0.4, 0.0, 0.0))
        world.step(6 * HZ)
        for name in ("ball", "bottle_wine", "can_soda"):
            assert np.abs(np.concatenate(world.body_twist(name))).max() < 0.02, name
            assert world.body_pose(name).position[0] > 0.02, name
