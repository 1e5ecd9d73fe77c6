"""Tools that move at a velocity, and counts of collisions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel
from gibson_sim.errors import CommandError
from gibson_sim.geometry.transforms import invert, matrix_from_pose
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.joints.servo import ToolTwist
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, Vec3, VelocityCommand
from support.arms import ARM_JOINTS, load_arm

STILL: Vec3 = (0.0, 0.0, 0.0)
_LIMITS = {"turn": 2.0, "lift": 1.6, "roll": 3.0, "elbow": 2.2, "forearm": 3.0, "wrist": 2.1, "hand": 3.0}


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotSpec:
    return load_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture
def world(robot: RobotSpec) -> Iterator[PhysicsWorld]:
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0, robots=(robot,))
    with PhysicsWorld(scene) as made:
        yield made


def servo(world: PhysicsWorld, seconds: float, twist: ToolTwist) -> None:
    """Sends a twist 30 times a second."""
    for _ in range(round(seconds * 30)):
        world.arms.servo("robot", twist)
        world.step(8)


def angles(world: PhysicsWorld) -> dict[str, float]:
    return dict(zip(world.joint_states("robot").names, world.joint_states("robot").positions.tolist(), strict=True))


def test_tool_moves_at_the_velocity_and_stops_when_commands_end(world: PhysicsWorld) -> None:
    before = np.array(world.arms.tool_pose("robot").position)
    servo(world, 1.0, ToolTwist((0.0, 0.12, 0.06), STILL))
    moved = np.array(world.arms.tool_pose("robot").position) - before
    assert moved == pytest.approx([0.0, 0.12, 0.06], abs=3e-3)
    rotation = matrix_from_pose(world.arms.tool_pose("robot"))[:3, :3]
    assert rotation == pytest.approx(np.eye(3), abs=0.01)
    world.step(240)
    # 0.25 s after the last command, 8 steps before.
    there = np.array(world.arms.tool_pose("robot").position)
    assert there - before == pytest.approx(np.array([0.0, 0.12, 0.06]) * (1.0 + 0.25 - 8 / 240), abs=4e-3)
    world.step(240)
    assert np.array(world.arms.tool_pose("robot").position) == pytest.approx(there, abs=1e-4)


def test_frame_is_that_of_the_tool_or_of_any_link(world: PhysicsWorld) -> None:
    world.command_joints("robot", JointPositions((math.pi / 2,), ("hand",)))
    world.step(300)
    before = world.arms.tool_pose("robot").position
    # The tool's y is the base's z now.
    servo(world, 0.5, ToolTwist((0.0, 0.1, 0.0), STILL, "tool"))
    middle = world.arms.tool_pose("robot").position
    assert np.array(middle) - np.array(before) == pytest.approx([0.0, 0.0, 0.05], abs=3e-3)
    # The frame of the shoulder turns with the first joint, which is still at 0.
    servo(world, 0.5, ToolTwist((0.0, 0.1, 0.0), STILL, "turn_link"))
    assert np.array(world.arms.tool_pose("robot").position)[1] - middle[1] == pytest.approx(0.05, abs=5e-3)
    with pytest.raises(CommandError, match=r"frame 'map' is not a link of robot 'robot'; use its base, 'base', its tool, 'tool'"):
        world.arms.servo("robot", ToolTwist(STILL, STILL, "map"))


def test_arm_turns_about_its_tool(world: PhysicsWorld) -> None:
    before = world.arms.tool_pose("robot").position
    servo(world, 1.0, ToolTwist(STILL, (0.0, 0.0, 0.4)))
    pose = world.arms.tool_pose("robot")
    assert pose.position == pytest.approx(before, abs=5e-3)
    assert 2 * math.atan2(pose.quat_xyzw[2], pose.quat_xyzw[3]) == pytest.approx(0.4, abs=0.02)


def test_limits_hold_where_the_arm_is_stretched_out(world: PhysicsWorld) -> None:
    fastest = 0.0
    for _ in range(60):
        world.arms.servo("robot", ToolTwist((0.4, 0.0, 0.2), STILL))
        world.step(8)
        fastest = max(fastest, float(np.abs(world.joint_states("robot").velocities[:7]).max()))
        assert all(abs(at) <= _LIMITS[name] + 1e-3 for name, at in angles(world).items() if name in _LIMITS)
    assert fastest <= 1.5 * 1.01
    reach = math.dist(world.arms.tool_pose("robot").position, (0.2, 0.0, 0.65))
    assert reach == pytest.approx(0.2 + 0.13 + 0.2 + 0.12 + 0.13 + 0.15, abs=0.05)


def test_joint_command_takes_over_from_the_servo(world: PhysicsWorld) -> None:
    servo(world, 0.2, ToolTwist((0.0, 0.2, 0.0), STILL))
    world.command_joints("robot", JointPositions(tuple(0.0 for _ in ARM_JOINTS), ARM_JOINTS))
    world.step(480)
    assert [angles(world)[name] for name in ARM_JOINTS] == pytest.approx([0.0] * 7, abs=2e-3)


def test_tool_follows_a_circle_while_the_base_drives_a_curve(root: Path) -> None:
    robot = load_robot(root / "config/robots/arm_bot")
    ready = dict(robot.named_pose("ready").joints)
    with PhysicsWorld(
        SceneSpec("test", root, "", (), (), ground_z=0.0, robots=(replace(robot, joints=tuple(ready.items())),))
    ) as world:

        def tool() -> NDArray[np.float64]:
            return invert(matrix_from_pose(world.body_pose("robot"))) @ matrix_from_pose(world.arms.tool_pose("robot"))

        world.step(60)
        start = tool()
        for k in range(75):
            angle, radius, turning = 2.0 * math.pi * k / 150, 0.08, 2.0 * math.pi / 5.0
            now = tool()
            behind = start[:3, 3] + radius * np.array([0.0, math.sin(angle), 1.0 - math.cos(angle)]) - now[:3, 3]
            turn = start[:3, :3] @ now[:3, :3].T
            twist = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
            assert np.linalg.norm(behind) < 0.004
            assert np.linalg.norm(twist) < math.radians(0.5)
            linear = radius * turning * np.array([0.0, math.cos(angle), math.sin(angle)]) + 2.0 * behind
            world.arms.servo(
                "robot", ToolTwist((linear[0], linear[1], linear[2]), (2.0 * twist[0], 2.0 * twist[1], 2.0 * twist[2]))
            )
            world.command("robot", VelocityCommand((0.3, 0.0, 0.0), (0.0, 0.0, 0.3), world.stamp_ns))
            world.step(8)
        forward, around = world.base_twist("robot")
        assert (forward[0], around[2]) == pytest.approx((0.3, 0.3), rel=0.02)


def test_floor_below_is_no_collision_and_walls_are(robot: RobotSpec) -> None:
    inertia = (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)
    link = UrdfLink("body", (), (UrdfCollision(Shape("box", (0.2, 1.0, 1.0)), Pose()),), Inertial(5.0, Pose(), inertia))
    wall = BodySpec("wall", UrdfModel("wall", Path("/nowhere/x.urdf"), (link,), ()), Pose((-0.38, 0.0, 0.5)), True)
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0, robots=(robot,), bodies=(wall,))
    with PhysicsWorld(scene) as world:
        assert world.collisions("robot").count == 0
        world.step(120)
        assert world.collisions("robot").count == 0
        for _ in range(2):
            world.set_state("robot", linear=(-1.0, 0.0, 0.0))
            world.step(120)
            world.set_state("robot", Pose(), linear=STILL, angular=STILL)
            world.step(60)
        found = world.collisions("robot")
        assert (found.count, found.ongoing, found.last_link, found.last_body) == (2, 0, "base", "wall")
        assert found.greatest_force > 0.0
        assert 0.0 < found.duration < 1.0
        world.reset()
        assert world.collisions("robot").count == 0
        touched = world.contacts()
        assert all(contact.body_b == "ground" for contact in touched)
