"""Grippers that grasp and release, by command, by closing, and by themselves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import CommandError
from gibson_sim.physics.engine import pybullet
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointEfforts, JointPositions, JointTrajectory, JointVelocities, TrajectoryPoint
from gibson_sim.robots.joints.grasping import GraspSettings
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, Vec3
from support.arms import FINGERS, load_arm

TOOL: Vec3 = (0.7922381, 0.0, 0.1725912)
"""Position of the test arm's tool at home, by hand."""
ROOT = Pose()
MakeWorld = Callable[..., PhysicsWorld]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotSpec:
    return load_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture
def make_world(robot: RobotSpec) -> MakeWorld:
    def make(*bodies: BodySpec, gravity: float = 0.0, robots: tuple[RobotSpec, ...] = (robot,), **rules: object) -> PhysicsWorld:
        scene = SceneSpec(
            "test", Path("/nowhere"), "", (), (), ground_z=0.0, gravity=(0.0, 0.0, -gravity), robots=robots, bodies=bodies
        )
        return PhysicsWorld(scene, grasping=GraspSettings(**rules))  # type: ignore[arg-type]

    return make


def cube(name: str, position: Vec3, *, size: float = 0.1, kilograms: float = 1.0, static: bool = False) -> BodySpec:
    inertia = kilograms * size**2 / 6
    collision = UrdfCollision(Shape("box", (size, size, size)), Pose())
    link = UrdfLink(
        "body", (), (collision,), Inertial(kilograms, Pose(), (inertia, 0.0, 0.0, inertia, 0.0, inertia)), friction=1.0
    )
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ()), Pose(position), static)


def door(position: Vec3) -> BodySpec:
    """A leaf of 8 kg in the plane x = 0 of its frame, hinged at y = 0.7; its handle is at the origin, 0.06 m before the leaf."""
    inertia = (0.5, 0.0, 0.0, 0.5, 0.0, 0.5)
    middle = Pose((0.0, -0.4, 0.0))
    links = (
        UrdfLink(
            "frame", (), (UrdfCollision(Shape("box", (0.1, 0.1, 0.3)), Pose((0.0, 0.1, 0.0))),), Inertial(1.0, Pose(), inertia)
        ),
        UrdfLink("leaf", (), (UrdfCollision(Shape("box", (0.04, 0.8, 0.3)), middle),), Inertial(8.0, middle, inertia)),
        UrdfLink("handle", (), (UrdfCollision(Shape("sphere", (0.02, 0.0, 0.0)), Pose()),), None),
    )
    hinge = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), -1.6, 1.6, 100.0, 2.0)
    fixed = UrdfJoint("fixed", "fixed", "leaf", "handle", Pose((-0.08, -0.7, 0.0)), (1.0, 0.0, 0.0))
    place = Pose((position[0] + 0.08, position[1] + 0.7, position[2]))
    return BodySpec("door", UrdfModel("door", Path("/nowhere/d.urdf"), links, (hinge, fixed)), place, True)


def ahead(distance: float, size: float = 0.1) -> Vec3:
    """Returns the pose of a cube whose face is at a distance ahead of the tool."""
    return TOOL[0] + distance + size / 2, TOOL[1], TOOL[2]


def constraints(world: PhysicsWorld) -> int:
    return int(pybullet.getNumConstraints(physicsClientId=world._bullet.client))


@pytest.mark.parametrize(("distance", "holds"), [(0.199, True), (0.201, False), (0.01, True)])
def test_gripper_grasps_only_within_the_threshold(make_world: MakeWorld, distance: float, holds: bool) -> None:
    with make_world(cube("cup", ahead(distance))) as world:
        state = world.arms.grasp("robot")
        assert (state.holding, state.body) == (holds, "cup" if holds else "")
        assert constraints(world) == int(holds)
        if not holds:
            assert state.reason == "no movable link is within 0.2 m of tool; cup/body is at 0.201 m"


def test_threshold_is_a_setting(make_world: MakeWorld) -> None:
    with make_world(cube("cup", ahead(0.06)), distance=0.05) as world:
        assert not world.arms.grasp("robot").holding
    with make_world(cube("cup", ahead(0.04)), distance=0.05) as world:
        assert world.arms.grasp("robot").holding


def test_handle_is_preferred_to_nearer_bodies_and_static_bodies_are_never_grasped(make_world: MakeWorld) -> None:
    near = (TOOL[0], TOOL[1] + 0.08, TOOL[2])
    things = (door((TOOL[0] + 0.15, *TOOL[1:])), cube("cup", near, size=0.1), cube("wall", ahead(0.02), static=True))
    with make_world(*things) as world:
        state = world.arms.grasp("robot")
        assert (state.body, state.link) == ("door", "handle")
        world.arms.release("robot")
        world.remove("door")
        assert world.arms.grasp("robot").body == "cup"
        world.arms.release("robot")
        world.remove("cup")
        state = world.arms.grasp("robot")
        assert not state.holding
        assert state.reason == "no movable link is within 0.2 m of tool"


def test_target_restricts_grasping_to_one_body(make_world: MakeWorld) -> None:
    with make_world(cube("near", ahead(0.02)), cube("other", (TOOL[0], 0.15, TOOL[2]))) as world:
        assert world.arms.grasp("robot", target="other").body == "other"
        world.arms.release("robot")
        world.remove("near")
        with pytest.raises(CommandError, match=r"cannot grasp 'near': it is not in this world; there are: other"):
            world.arms.grasp("robot", target="near")
        with pytest.raises(CommandError, match="cannot grasp 'robot'"):
            world.arms.grasp("robot", target="robot")


@pytest.mark.parametrize(
    ("closing", "opening"),
    [
        (JointPositions((0.0, 0.0), FINGERS), JointPositions((0.05, 0.05), FINGERS)),
        (JointTrajectory(FINGERS, (TrajectoryPoint(10**9, (0.01, 0.01)),)), JointVelocities((0.05,), FINGERS[1:])),
        (JointEfforts((-5.0, -5.0), FINGERS), JointTrajectory(FINGERS[:1], (TrajectoryPoint(10**9, (0.05,)),))),
    ],
)
def test_closing_grasps_and_opening_releases(make_world: MakeWorld, closing: object, opening: object) -> None:
    with make_world(cube("cup", ahead(0.05))) as world:
        world.command_joints("robot", JointPositions((0.3,), ("turn",)))
        assert not world.arms.grasp_state("robot").holding
        world.command_joints("robot", closing)  # type: ignore[arg-type]
        assert world.arms.grasp_state("robot").body == "cup"
        world.step(60)
        world.command_joints("robot", JointPositions((0.0,), ("turn",)))
        assert world.arms.grasp_state("robot").holding
        world.command_joints("robot", opening)  # type: ignore[arg-type]
        state = world.arms.grasp_state("robot")
        assert (state.holding, state.reason) == (False, "let go: the gripper opened")
        assert constraints(world) == 0


def test_grasped_object_follows_the_tool_and_stays_where_it_is_released(make_world: MakeWorld) -> None:
    with make_world(cube("cup", ahead(0.02))) as world:
        world.arms.grasp("robot")
        world.command_joints("robot", JointPositions((0.4,), ("turn",)))
        world.step(240)
        there = world.body_pose("cup").position
        assert there[1] > 0.15
        assert math.dist(there, world.arms.tool_pose("robot").position) == pytest.approx(0.07, abs=2e-3)
        world.arms.release("robot")
        world.command_joints("robot", JointPositions((0.0,), ("lift",)))
        world.step(240)
        assert world.arms.tool_pose("robot").position[2] > TOOL[2] + 0.2
        assert world.body_pose("cup").position[2] < TOOL[2] + 0.1


def test_pull_stays_within_the_limit_and_the_hinge_decides_when_to_release(make_world: MakeWorld) -> None:
    limit, angle = 60.0, 0.5
    with make_world(door((TOOL[0] + 0.05, *TOOL[1:])), max_force=limit, release_angle=angle) as world:
        assert world.arms.grasp("robot").link == "handle"
        world.command_joints("door", JointPositions((0.9,), ("hinge",)))
        forces = []
        while world.arms.grasp_state("robot").holding:
            world.step()
            forces.append(world.arms.grasp_state("robot").force)
            assert world.step_count < 480
        assert 0.3 * limit < max(forces) <= 1.05 * limit
        # At most one step of the fastest hinge beyond the limit.
        assert angle < world.joint_states("door").positions[0] < angle + 2.0 / 240 + 1e-6
        assert "more than the set angle, 28.6479 degrees" in world.arms.grasp_state("robot").reason
        assert constraints(world) == 0


@pytest.mark.parametrize(("release_force", "holds"), [(20.0, False), (200.0, True), (0.0, True)])
def test_gripper_releases_above_the_set_force(make_world: MakeWorld, release_force: float, holds: bool) -> None:
    with make_world(cube("cup", ahead(0.02), kilograms=5.0), gravity=9.81, release_force=release_force) as world:
        world.arms.grasp("robot")
        world.step(24)
        state = world.arms.grasp_state("robot")
        assert state.holding == holds
        if holds:
            assert state.force > 20.0
        else:
            assert state.reason.endswith("is more than the set force, 20 N")


def test_sticky_gripper_grasps_only_bodies_in_contact(make_world: MakeWorld) -> None:
    with make_world(cube("cup", ahead(0.03, 0.06), size=0.06), mode="sticky") as world:
        assert not world.arms.grasp("robot").holding
        world.step(300)
        assert world.arms.grasp_state("robot").reason == "the fingers closed without touching a movable link"
        world.set_state("cup", Pose((TOOL[0], 0.0, TOOL[2])))
        world.command_joints("robot", JointPositions((0.0, 0.0), FINGERS))
        world.step(120)
        state = world.arms.grasp_state("robot")
        assert (state.body, state.link, state.mode) == ("cup", "body", "sticky")
        before = np.array(world.body_pose("cup").position) - np.array(world.arms.tool_pose("robot").position)
        world.command_joints("robot", JointPositions((0.5,), ("hand",)))
        world.step(240)
        assert world.body_pose("cup").quat_xyzw[0] == pytest.approx(math.sin(0.25), abs=0.01)
        after = np.array(world.body_pose("cup").position) - np.array(world.arms.tool_pose("robot").position)
        assert float(np.linalg.norm(after)) == pytest.approx(float(np.linalg.norm(before)), abs=2e-3)


def test_friction_alone_lifts_what_the_fingers_press(make_world: MakeWorld) -> None:
    on_floor = (TOOL[0], 0.0, TOOL[2])
    table = cube("table", (TOOL[0], 0.0, TOOL[2] - 0.03 - 0.05), static=True)
    with make_world(cube("cup", on_floor, size=0.06, kilograms=0.3), table, gravity=9.81, mode="physical") as world:
        world.step(60)
        assert world.arms.grasp_state("robot") == replace(world.arms.grasp_state("robot"), holding=False, force=0.0, reason="")
        world.arms.move_gripper("robot", 0.0)
        world.step(120)
        state = world.arms.grasp_state("robot")
        assert (state.body, state.link, constraints(world)) == ("cup", "body", 0)
        assert state.force == pytest.approx(60.0, rel=0.2)
        up = Pose((TOOL[0], 0.0, TOOL[2] + 0.1))
        solution = world.arms.solve_arm("robot", up)
        assert solution.within(1e-4, 1e-3)
        world.command_joints("robot", JointTrajectory(solution.names, (TrajectoryPoint(10**9, solution.positions),)))
        world.step(300)
        assert world.body_pose("cup").position[2] == pytest.approx(TOOL[2] + 0.1, abs=0.01)
        world.arms.move_gripper("robot", 1.0)
        world.step(240)
        assert not world.arms.grasp_state("robot").holding
        assert world.body_pose("cup").position[2] < TOOL[2] + 0.05


def test_deletion_and_reset_end_grasps(make_world: MakeWorld) -> None:
    with make_world(cube("cup", ahead(0.02)), cube("jar", (TOOL[0], 0.15, TOOL[2]))) as world:
        assert world.arms.grasp("robot").body == "cup"
        world.remove("cup")
        world.step()
        state = world.arms.grasp_state("robot")
        assert (state.holding, state.reason) == (False, "the held object was removed")
        assert world.arms.grasp("robot").body == "jar"
        world.reset()
        assert (world.arms.grasp_state("robot").holding, world.arms.grasp_state("robot").reason) == (False, "")
        assert world.arms.grasp("robot").body == "jar"
        world.remove("robot")
        assert constraints(world) == 0
        world.step()
        with pytest.raises(CommandError, match="no robot 'robot'"):
            world.arms.grasp("robot")


def test_a_thousand_grasps_leave_nothing_behind(make_world: MakeWorld) -> None:
    with make_world(cube("cup", ahead(0.02))) as world:
        for k in range(1000):
            assert world.arms.grasp("robot").holding
            if k % 100 == 0:
                world.step()
            world.arms.release("robot")
        assert (constraints(world), world.attachments.all) == (0, ())
        assert world.body_pose("cup").position == pytest.approx(ahead(0.02), abs=1e-3)


def test_equal_commands_give_equal_worlds(make_world: MakeWorld) -> None:
    states = []
    for _ in range(2):
        with make_world(cube("cup", ahead(0.02)), door((TOOL[0] + 0.12, *TOOL[1:])), gravity=9.81) as world:
            world.arms.move_gripper("robot", 0.0)
            world.command_joints("robot", JointPositions((0.3, 0.2), ("turn", "lift")))
            world.step(60)
            states.append((world.state().positions, world.arms.grasp_state("robot")))
    assert np.array_equal(states[0][0], states[1][0])
    assert states[0][1] == states[1][1]


def test_grasping_without_an_arm_or_a_gripper_is_refused(make_world: MakeWorld, robot: RobotSpec) -> None:
    bare = replace(robot, name="bare", manipulators=())
    armless = replace(
        robot, name="stump", manipulators=(replace(robot.manipulators[0], gripper=None),), start=Pose((0.0, 3.0, 0.0))
    )
    with make_world(robots=(replace(bare, start=Pose((0.0, -3.0, 0.0))), armless)) as world:
        with pytest.raises(CommandError, match="robot 'bare' has no manipulator"):
            world.arms.grasp("bare")
        with pytest.raises(CommandError, match=r"arm 'arm' of robot 'stump' has no gripper; add one to its robot\.yaml"):
            world.arms.move_gripper("stump", 1.0)
        with pytest.raises(CommandError, match="has no manipulator 'leg'; known: arm"):
            world.arms.tool_pose("stump", "leg")
        with pytest.raises(CommandError, match="no joint 'nose'"):
            world.command_joints("stump", JointPositions((0.0,), ("nose",)))
