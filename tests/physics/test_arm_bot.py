"""Our mobile manipulator in physics: it stands, drives, holds its arm and a load, and grips."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import parse_urdf, read_urdf
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose, Vec3, VelocityCommand

MakeScene = Callable[..., SceneSpec]
BOX = """<robot name="box"><link name="box"><collision><geometry><box size="{0} {0} {0}"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx="6e-4" ixy="0" ixz="0" iyy="6e-4" iyz="0" izz="6e-4"/></inertial></link></robot>"""


@pytest.fixture(scope="module")
def arm_bot(root: Path) -> RobotSpec:
    return load_robot(root / "config/robots/arm_bot")


@pytest.fixture
def world(arm_bot: RobotSpec, make_scene: MakeScene) -> Iterator[PhysicsWorld]:
    with PhysicsWorld(make_scene(arm_bot)) as made:
        yield made


def posed(robot: RobotSpec, pose: str) -> RobotSpec:
    """The robot, starting in one of its poses; joints that the pose does not name are at their home positions."""
    return replace(robot, joints=tuple({**dict(robot.joints), **dict(robot.named_pose(pose).joints)}.items()))


def with_box(scene: SceneSpec, position: Vec3, size: float) -> SceneSpec:
    """The scene with a box of 1 kg."""
    return replace(scene, bodies=(BodySpec("box", parse_urdf(BOX.format(size), Path("box.urdf")), Pose(position)),))


def positions(world: PhysicsWorld) -> dict[str, float]:
    states = world.joint_states("robot")
    return dict(zip(states.names, states.positions.tolist(), strict=True))


def tilt(world: PhysicsWorld) -> float:
    """Angle between the robot's z axis and the vertical, radians."""
    x, y, _, _ = world.base_pose("robot").quat_xyzw
    return 2 * math.hypot(x, y)


def test_dimensions_match_the_documentation(arm_bot: RobotSpec) -> None:
    assert arm_bot.drive is not None
    assert (arm_bot.drive.wheel_radius, arm_bot.radius) == pytest.approx((0.0625, 0.272))
    model = read_urdf(arm_bot.urdf)
    stretched = model.transforms(dict(arm_bot.named_pose("stretched").joints))
    reach = stretched["gripper_link"][:3, 3] - stretched["shoulder_pan_link"][:3, 3]
    assert (reach[0], reach[2]) == pytest.approx((1.097, 0.06))
    lift, (arm,) = model.joint("torso_lift_joint"), arm_bot.manipulators
    assert arm.gripper is not None
    assert (lift.upper - lift.lower, arm.gripper.links_apart) == pytest.approx((0.38, 0.10))
    assert 60.0 < sum(link.inertial.mass for link in model.links if link.inertial is not None) < 120.0
    # The camera looks ahead, and level.
    at_home = model.transforms(dict(arm_bot.joints))["head_camera_optical_frame"]
    assert at_home[:3, :3] @ np.array([0, 0, 1]) == pytest.approx([1, 0, 0], abs=1e-9)
    assert model.transforms()["laser_link"][2, 3] == pytest.approx(0.288)
    ready = model.transforms(dict(arm_bot.named_pose("ready").joints))["gripper_link"]
    assert ready[:3, :3] == pytest.approx(np.eye(3), abs=1e-9)
    assert ready[2, 3] == pytest.approx(0.88, abs=0.01)


def test_tucked_arm_stays_within_the_circle_of_the_base(arm_bot: RobotSpec, world: PhysicsWorld) -> None:
    low, high = world.bounds("robot")
    assert max(-low[0], -low[1], high[0], high[1]) < arm_bot.radius + 0.03


def test_robot_stands_still(arm_bot: RobotSpec, world: PhysicsWorld) -> None:
    world.step(480)
    assert np.hypot(*world.base_pose("robot").position[:2]) < 1e-4
    assert tilt(world) < 1e-4
    there = positions(world)
    assert [there[name] for name, _ in arm_bot.joints] == pytest.approx([at for _, at in arm_bot.joints], abs=1e-3)


@pytest.mark.parametrize(("linear", "angular"), [(0.3, 0.0), (0.3, -0.5)])
def test_robot_follows_velocity_commands_within_two_percent(world: PhysicsWorld, linear: float, angular: float) -> None:
    for _ in range(200):
        world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
        world.step()
    speed, spin = world.base_twist("robot")
    assert (speed[0], spin[2]) == pytest.approx((linear, angular), rel=0.02, abs=0.002)


def test_stretched_arm_holds_a_kilogram_and_robot_does_not_tip(arm_bot: RobotSpec, make_scene: MakeScene) -> None:
    robot = posed(arm_bot, "stretched")
    scene = with_box(make_scene(robot), (1.13, 0.0, 0.787), 0.05)
    with PhysicsWorld(scene) as world:
        world.attachments.attach("robot", "gripper_link", "box", "box", kind="fixed")
        world.step(240)
        there = positions(world)
        assert [there[name] for name in robot.manipulator().joints] == pytest.approx([0.0] * 7, abs=0.01)
        assert tilt(world) < 1e-3
        assert world.body_pose("box").position[2] == pytest.approx(0.787, abs=0.01)
        states, model = world.joint_states("robot"), read_urdf(robot.urdf)
        efforts = dict(zip(states.names, np.abs(states.efforts).tolist(), strict=True))
        # Half of the motor's torque: 1 kg at 0.98 m from the axis, and 12 kg of links.
        assert 55.0 < efforts["shoulder_lift_joint"] < 0.6 * model.joint("shoulder_lift_joint").effort


def test_gripper_lifts_a_kilogram_by_friction_alone(arm_bot: RobotSpec, make_scene: MakeScene) -> None:
    robot = posed(arm_bot, "ready")
    x, y, z = read_urdf(robot.urdf).transforms(dict(robot.joints))["gripper_link"][:3, 3].tolist()
    stand = CollisionSpec("stand", Shape("box", (0.05, 0.05, z - 0.03)), Pose((x, y, (z - 0.03) / 2)))
    gripper = robot.manipulator().gripper
    assert gripper is not None
    with PhysicsWorld(with_box(make_scene(robot, collisions=(stand,)), (x, y, z), 0.06)) as world:
        world.command_joints("robot", JointPositions((gripper.closed,) * 2, gripper.joints))
        world.step(150)
        there = positions(world)
        assert [there[name] for name in gripper.joints] == pytest.approx([0.03, 0.03], abs=1e-3)
        world.command_joints("robot", JointPositions((0.30,), ("torso_lift_joint",)))
        world.step(60)
        # The torso lifts at its 0.1 m/s, not faster.
        assert positions(world)["torso_lift_joint"] == pytest.approx(0.275, abs=0.002)
        world.step(90)
        assert world.body_pose("box").position == pytest.approx((x, y, z + 0.05), abs=0.002)


def test_reset_restores_the_initial_state(arm_bot: RobotSpec, world: PhysicsWorld) -> None:
    world.command_joints("robot", JointPositions((0.0,), ("elbow_flex_joint",)))
    world.step(120)
    assert abs(positions(world)["elbow_flex_joint"] - 1.72) > 0.5
    world.reset()
    assert positions(world)["elbow_flex_joint"] == pytest.approx(1.72)
    world.step(60)
    assert positions(world)["elbow_flex_joint"] == pytest.approx(1.72, abs=1e-3)


def test_the_base_keeps_its_heading_while_the_stretched_arm_swings_and_stops_at_once(
    arm_bot: RobotSpec, make_scene: MakeScene
) -> None:
    with PhysicsWorld(make_scene(posed(arm_bot, "stretched"))) as world:
        for goal in (-1.3, 1.3):
            at = positions(world)["shoulder_pan_joint"]
            while abs(at - goal) > 1e-9:
                # As scripts do: a target a little ahead, ten times a second, so that the arm moves at full speed until its end.
                at += max(-0.12, min(0.12, goal - at))
                world.command_joints("robot", JointPositions((at,), ("shoulder_pan_joint",)))
                world.step(24)
            world.step(120)
            _, _, z, w = world.base_pose("robot").quat_xyzw
            assert abs(2.0 * math.atan2(z, w)) < math.radians(0.2)
            assert tilt(world) < 2e-3
