"""True motion of the robot against its commands and its odometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.geometry.transforms import matrix_from_quat, pose_from_xyz_rpy, yaw_from_quat
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import VelocityCommand

MakeScene = Callable[..., SceneSpec]
Drive = Callable[[PhysicsWorld, float, float, float], None]
WALL_X = 1.0


def wall(yaw: float = 0.0) -> CollisionSpec:
    """Returns a wall whose face goes through (1, 0), its normal turned by ``yaw`` from -x."""
    centre = (WALL_X + 0.1 * math.cos(yaw), 0.1 * math.sin(yaw), 0.5)
    return CollisionSpec("wall", Shape("box", (0.2, 20.0, 1.0)), pose_from_xyz_rpy(centre, (0.0, 0.0, yaw)))


def tilt(world: PhysicsWorld) -> float:
    """Returns the angle between the robot's z axis and the world's, radians."""
    up = matrix_from_quat(world.base_pose("robot").quat_xyzw)[2, 2]
    return math.acos(min(1.0, up))


def test_one_metre_forward(flat: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(flat) as world:
        drive(world, 0.25, 0.0, 4.0)
        drive(world, 0.0, 0.0, 1.0)
        assert world.base_pose("robot").position == pytest.approx((1.0, 0.0, 0.0), abs=0.01)


def test_heading_holds_over_four_metres(flat: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(flat) as world:
        drive(world, 0.5, 0.0, 8.0)
        assert world.base_pose("robot").position[0] > 3.8
        assert abs(math.degrees(yaw_from_quat(world.base_pose("robot").quat_xyzw))) < 0.5


def test_turns_by_two_radians(flat: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(flat) as world:
        drive(world, 0.0, 1.0, 2.0)
        drive(world, 0.0, 0.0, 1.0)
        assert yaw_from_quat(world.base_pose("robot").quat_xyzw) == pytest.approx(2.0, rel=0.02)


def test_wheel_odometry_agrees_with_the_truth(flat: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(flat) as world:
        for _ in range(4):
            drive(world, 0.3, 0.0, 2.0)
            drive(world, 0.1, 0.8, 1.5)
            drive(world, 0.25, -0.9, 1.0)
        truth, odometry = world.base_pose("robot"), world.odometry("robot")
        error = math.hypot(truth.position[0] - odometry.x, truth.position[1] - odometry.y)
        # 4 m of path
        assert error < 0.005 * 4.0
        assert odometry.yaw == pytest.approx(yaw_from_quat(truth.quat_xyzw), abs=0.02)


def test_odometry_starts_at_zero_wherever_the_robot_starts(make_scene: MakeScene, robot: RobotSpec, drive: Drive) -> None:
    start = pose_from_xyz_rpy((3.0, -2.0, 0.0), (0.0, 0.0, math.pi / 2))
    with PhysicsWorld(make_scene(replace(robot, start=start))) as world:
        drive(world, 0.25, 0.0, 4.0)
        drive(world, 0.0, 0.0, 1.0)
        odometry = world.odometry("robot")
        assert (odometry.x, odometry.y) == pytest.approx((1.0, 0.0), abs=0.01)
        assert world.base_pose("robot").position == pytest.approx((3.0, -1.0, 0.0), abs=0.01)


def test_stands_still_at_rest(flat: SceneSpec) -> None:
    with PhysicsWorld(flat) as world:
        world.step(10 * world.step_hz)
        pose = world.base_pose("robot")
        # A motor that holds speed 0 instead of the angle creeps 0.25 mm.
        assert pose.position == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)
        assert abs(yaw_from_quat(pose.quat_xyzw)) < math.radians(0.05)


def test_starts_with_its_wheels_on_the_floor(flat: SceneSpec) -> None:
    with PhysicsWorld(flat) as world:
        world.step(1)
        assert abs(world.base_twist("robot")[0][2]) < 0.01
        world.step(world.step_hz)
        assert abs(world.base_pose("robot").position[2]) < 1e-3


def test_stale_command_stops_the_robot(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot), cmd_vel_timeout=0.5) as world:
        world.command("robot", VelocityCommand((0.25, 0.0, 0.0), (0.0, 0.0, 0.0), 0))
        world.step(120)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.25, abs=0.01)
        # 0.25 m/s at 1 m/s^2 take 0.25 s to brake.
        world.step(60 + 12)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.0, abs=0.002)


def test_command_from_the_future_is_not_obeyed_for_ever(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        world.command("robot", VelocityCommand((0.25, 0.0, 0.0), (0.0, 0.0, 0.0), 10**18))
        world.step(2 * world.step_hz)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.0, abs=0.002)


def test_speeds_up_by_the_limit(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        world.command("robot", VelocityCommand((0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 0))
        # 0.25 s at 1 m/s^2
        world.step(60)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("yaw_deg", [0, 30])
@pytest.mark.parametrize("speed", [0.25, 0.5])
def test_wall_stops_the_robot(make_scene: MakeScene, robot: RobotSpec, drive: Drive, yaw_deg: int, speed: float) -> None:
    yaw = math.radians(yaw_deg)
    deepest, steepest, highest = 0.0, 0.0, 0.0
    with PhysicsWorld(make_scene(robot, collisions=(wall(yaw),))) as world:
        for _ in range(120):
            drive(world, speed, 0.0, 0.05)
            x, y, z = world.base_pose("robot").position
            gap = (WALL_X - x) * math.cos(yaw) - y * math.sin(yaw) - robot.radius
            deepest, steepest, highest = min(deepest, gap), max(steepest, tilt(world)), max(highest, z)
        assert gap < 0.02, "the robot never came to the wall"
        assert deepest > -0.01
        assert steepest < math.radians(2.0)
        assert highest < 0.002


def test_wheels_that_slip_at_a_wall_deceive_odometry(make_scene: MakeScene, robot: RobotSpec, drive: Drive) -> None:
    with PhysicsWorld(make_scene(robot, collisions=(wall(),))) as world:
        drive(world, 0.5, 0.0, 5.0)
        assert world.odometry("robot").x > 2.0
        assert world.base_pose("robot").position[0] < 1.0


def test_table_top_stops_the_upper_deck(make_scene: MakeScene, robot: RobotSpec, drive: Drive) -> None:
    top = CollisionSpec("top", Shape("box", (1.0, 2.0, 0.04)), pose_from_xyz_rpy((1.5, 0.0, 0.22)))
    with PhysicsWorld(make_scene(robot, collisions=(top,))) as world:
        drive(world, 0.3, 0.0, 6.0)
        # The edge is at x = 1.0, the deck has a radius of 0.14 m.
        assert world.base_pose("robot").position[0] == pytest.approx(0.86, abs=0.02)


def test_real_turtlebot3_drives(data_dir: Path, make_scene: MakeScene, tmp_path: Path, drive: Drive) -> None:
    urdf = data_dir / "nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf"
    (tmp_path / "robot.yaml").write_text(
        f"urdf: {urdf}\ndrive: {{type: differential, left_joint: wheel_left_joint, right_joint: wheel_right_joint}}\n"
    )
    waffle = load_robot(tmp_path / "robot.yaml")
    assert (waffle.drive.wheel_radius, waffle.drive.wheel_separation) == pytest.approx((0.033, 0.288), abs=1e-4)
    with PhysicsWorld(make_scene(waffle)) as world:
        drive(world, 0.25, 0.0, 4.0)
        drive(world, 0.0, 0.0, 1.0)
        assert world.base_pose("robot").position[0] == pytest.approx(1.0, abs=0.03)


def test_velocity_is_in_the_base_frame(make_scene: MakeScene, robot: RobotSpec, drive: Drive) -> None:
    start = pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    with PhysicsWorld(make_scene(replace(robot, start=start))) as world:
        drive(world, 0.3, 0.0, 1.0)
        linear, _ = world.base_twist("robot")
        assert linear == pytest.approx([0.3, 0.0, 0.0], abs=0.01)
        state = world.state()
        assert state.twists[0, :3] == pytest.approx([0.0, 0.3, 0.0], abs=0.01)


def test_wheel_joints_turn_forward(make_scene: MakeScene, robot: RobotSpec, drive: Drive) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        drive(world, 0.36, 0.0, 2.0)
        joints = world.joint_states("robot")
        assert joints.names == ("wheel_left_joint", "wheel_right_joint")
        # 0.36 m/s over 0.036 m
        assert joints.velocities == pytest.approx([10.0, 10.0], abs=0.1)
        assert np.all(joints.positions > 15.0)


def test_robot_forgets_its_command_when_time_is_set_back(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        world.step(1200)
        world.command(robot.name, VelocityCommand((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), world.stamp_ns))
        world.step(60)
        world.set_step_count(0)
        world.step(240)
        assert world.stamp_ns == 10**9
        assert abs(world.odometry(robot.name).angular) < 0.01
