"""True motion of robots with drives other than differential, against their commands and their odometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import read_urdf
from gibson_sim.geometry.transforms import matrix_from_quat, pose_from_xyz_rpy, yaw_from_quat
from gibson_sim.physics.robot import mass_and_inertia, without_friction
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import VelocityCommand

MakeScene = Callable[..., SceneSpec]
BOTS = ("skid_bot", "omni_bot", "ackermann_bot")
WALL = CollisionSpec("wall", Shape("box", (0.2, 20.0, 1.0)), pose_from_xyz_rpy((1.1, 0.0, 0.5)))
"""A wall whose face is at x = 1."""


@pytest.fixture
def bot(root: Path) -> Callable[[str], RobotSpec]:
    """Loads one of our robots."""
    return lambda name: load_robot(root / "config/robots" / name)


def send(world: PhysicsWorld, seconds: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
    """Sends a velocity 20 times a second."""
    for _ in range(round(seconds * 20)):
        world.command("robot", VelocityCommand((x, y, 0.0), (0.0, 0.0, yaw), world.stamp_ns))
        world.step(world.step_hz // 20)


def place(world: PhysicsWorld) -> tuple[float, float, float]:
    """Returns the true pose: x, y, yaw."""
    pose = world.base_pose("robot")
    return pose.position[0], pose.position[1], yaw_from_quat(pose.quat_xyzw)


def believed(world: PhysicsWorld) -> tuple[float, float, float]:
    """Returns the pose by odometry: x, y, yaw."""
    odometry = world.odometry("robot")
    return odometry.x, odometry.y, odometry.yaw


@pytest.mark.parametrize("name", BOTS)
def test_one_metre_forward(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name))) as world:
        send(world, 4.0, 0.25)
        send(world, 1.0)
        assert place(world) == pytest.approx((1.0, 0.0, 0.0), abs=0.005)
        assert believed(world) == pytest.approx((1.0, 0.0, 0.0), abs=0.005)


@pytest.mark.parametrize("name", ["skid_bot", "omni_bot"])
def test_turns_by_ninety_degrees_on_the_spot(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name))) as world:
        send(world, 2.0, yaw=math.pi / 4)
        send(world, 1.0)
        assert place(world) == pytest.approx((0.0, 0.0, math.pi / 2), abs=0.01)
        assert believed(world) == pytest.approx((0.0, 0.0, math.pi / 2), abs=0.01)


def test_omni_goes_one_metre_sideways(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(bot("omni_bot"))) as world:
        send(world, 2.0, y=0.25)
        # Half-way, odometry has its speed, too.
        assert world.odometry("robot").lateral == pytest.approx(0.25, abs=1e-3)
        assert world.base_twist("robot")[0] == pytest.approx([0.0, 0.25, 0.0], abs=2e-3)
        send(world, 2.0, y=0.25)
        send(world, 1.0)
        assert place(world) == pytest.approx((0.0, 1.0, 0.0), abs=0.005)
        assert believed(world) == pytest.approx((0.0, 1.0, 0.0), abs=0.005)


@pytest.fixture
def planar_bot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RobotSpec:
    """A box of 10 kg on a plate with two wheels, which Gazebo's plugin moves in all directions."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    inertial = '<inertial><origin xyz="0 0 0.1"/><mass value="10"/><inertia ixx="0.2" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial>'
    box = '<collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.3 0.2"/></geometry></collision>'
    ball = '<collision><geometry><sphere radius="0.05"/></geometry></collision><inertial><mass value="0.5"/>{}</inertial>'.format(
        '<inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>'
    )
    wheels = "".join(
        f'<link name="{side}">{ball}</link><joint name="{side}_joint" type="continuous"><parent link="base_link"/><child link="{side}"/>'
        f'<origin xyz="0 {y} 0.05"/><axis xyz="0 1 0"/></joint>'
        for side, y in (("left", 0.2), ("right", -0.2))
    )
    plugin = '<gazebo><plugin filename="libgazebo_ros_planar_move.so" name="move"/></gazebo>'
    (tmp_path / "bot.urdf").write_text(f'<robot name="bot"><link name="base_link">{inertial}{box}</link>{wheels}{plugin}</robot>')
    return load_robot(tmp_path / "bot.urdf")


@pytest.mark.parametrize("command", [(0.25, 0.0, 0.0), (0.0, -0.25, 0.0), (0.2, 0.1, 0.0), (0.0, 0.0, 0.5)])
def test_planar_base_follows_velocity_commands(
    planar_bot: RobotSpec, make_scene: MakeScene, command: tuple[float, float, float]
) -> None:
    assert planar_bot.drive is not None and planar_bot.drive.kind == "planar"
    with PhysicsWorld(make_scene(planar_bot)) as world:
        send(world, 2.0, *command)
        send(world, 1.0)
        assert place(world) == pytest.approx([2.0 * value for value in command], abs=0.01)
        assert believed(world) == pytest.approx(place(world), abs=1e-4)


def test_planar_base_drives_an_arc_stops_at_a_wall_and_odometry_agrees(planar_bot: RobotSpec, make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(planar_bot)) as world:
        send(world, 4.0, 0.2, 0.1, 0.4)
        assert believed(world) == pytest.approx(place(world), abs=1e-3)
    with PhysicsWorld(make_scene(planar_bot, collisions=(WALL,))) as world:
        send(world, 6.0, 0.4)
        assert place(world)[0] == pytest.approx(0.8, abs=0.01), "its front is 0.2 m ahead"
        assert believed(world) == pytest.approx(place(world), abs=1e-3)


def test_omni_turns_about_a_point_that_it_looks_at(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(bot("omni_bot"))) as world:
        # To the right at 0.4 m/s, to the left at 0.4 rad/s: a circle about the point 1 m ahead.
        centres = []
        for _ in range(3):
            send(world, 1.0, y=-0.4, yaw=0.4)
            x, y, yaw = place(world)
            centres.append((x + math.cos(yaw), y + math.sin(yaw)))
        assert centres[1] == pytest.approx(centres[0], abs=0.01)
        assert centres[2] == pytest.approx(centres[0], abs=0.01)
        assert yaw == pytest.approx(1.2, abs=0.03)


def test_car_drives_a_circle_of_the_radius_that_was_commanded(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(bot("ackermann_bot"))) as world:
        send(world, 1.0, 0.5, yaw=0.5)
        points = []
        for _ in range(12):
            send(world, 1.0, 0.5, yaw=0.5)
            points.append(place(world)[:2])
        # The circle through three points of the path, a third of it apart.
        (ax, ay), (bx, by), (cx, cy) = points[0], points[4], points[8]
        matrix = np.array([[bx - ax, by - ay], [cx - ax, cy - ay]])
        centre = np.linalg.solve(matrix, [(bx**2 + by**2 - ax**2 - ay**2) / 2, (cx**2 + cy**2 - ax**2 - ay**2) / 2])
        assert math.dist(centre, (ax, ay)) == pytest.approx(1.0, abs=0.02)


def test_car_cannot_turn_on_the_spot(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(bot("ackermann_bot"))) as world:
        send(world, 2.0, yaw=1.0)
        assert place(world) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
        states = world.joint_states("robot")
        joints = dict(zip(states.names, states.positions.tolist(), strict=True))
        # Steered to the limit: the inner wheel is the left one.
        assert joints["steering_left_joint"] == pytest.approx(0.6, abs=0.01)
        assert 0.3 < joints["steering_right_joint"] < 0.6


def test_car_odometry_agrees_with_the_truth(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(bot("ackermann_bot"))) as world:
        for _ in range(3):
            send(world, 2.0, 0.5, yaw=0.6)
            send(world, 1.0, -0.3, yaw=0.2)
            send(world, 2.0, 0.6, yaw=-0.5)
        # 7.5 m of path
        assert believed(world) == pytest.approx(place(world), abs=0.05)


@pytest.mark.parametrize(("name", "separation"), [("gibson_bot", 0.23), ("skid_bot", 0.57)])
def test_wrong_radius_of_the_left_wheels_bends_the_odometry_alone(
    bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str, separation: float
) -> None:
    robot = bot(name)
    sensors = replace(robot.sensors, wheel_odometry=WheelOdometrySpec(left_radius_factor=1.1))
    with PhysicsWorld(make_scene(replace(robot, sensors=sensors))) as world:
        send(world, 4.0, 0.25)
        send(world, 1.0)
        assert place(world) == pytest.approx((1.0, 0.0, 0.0), abs=0.01)
        # 1 m on the right, 1.1 m on the left
        assert believed(world)[2] == pytest.approx(-0.1 / separation, abs=0.01)


@pytest.mark.parametrize("name", BOTS)
def test_wall_stops_the_robot(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name), collisions=(WALL,))) as world:
        deepest, steepest = -math.inf, 0.0
        for _ in range(80):
            send(world, 0.05, 0.5)
            deepest = max(deepest, float(world.bounds("robot")[1][0]))
            steepest = max(steepest, math.acos(min(1.0, matrix_from_quat(world.base_pose("robot").quat_xyzw)[2, 2])))
        assert deepest == pytest.approx(1.0, abs=0.01)
        assert steepest < math.radians(3.0)
        # Its wheels go on turning, so odometry is wrong.
        assert believed(world)[0] > 1.5


@pytest.mark.parametrize("name", BOTS)
def test_stands_still_at_rest(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name))) as world:
        world.step(10 * world.step_hz)
        assert world.base_pose("robot").position == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


@pytest.mark.parametrize("name", BOTS)
def test_stands_still_on_a_ramp(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    angle = math.radians(6.0)
    ramp = pose_from_xyz_rpy((0.1 * math.sin(angle), 0.0, -0.1 * math.cos(angle)), (0.0, -angle, 0.0))
    robot = replace(bot(name), start=pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, -angle, 0.0)))
    scene = make_scene(robot, collisions=(CollisionSpec("ramp", Shape("box", (8.0, 4.0, 0.2)), ramp),), ground_z=None)
    with PhysicsWorld(scene) as world:
        world.step(5 * world.step_hz)
        assert world.base_pose("robot").position == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)


def test_omni_slides_where_the_floor_is_steeper_than_its_traction(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    # Traction 0.5 holds up to 26.6 degrees; at 35 degrees the rest accelerates it by 9.81 (sin 35 - 0.5 cos 35) = 1.61 m/s^2.
    angle = math.radians(35.0)
    ramp = pose_from_xyz_rpy((0.1 * math.sin(angle), 0.0, -0.1 * math.cos(angle)), (0.0, -angle, 0.0))
    robot = replace(bot("omni_bot"), start=pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.0, -angle, 0.0)))
    scene = make_scene(robot, collisions=(CollisionSpec("ramp", Shape("box", (8.0, 4.0, 0.2)), ramp),), ground_z=None)
    with PhysicsWorld(scene) as world:
        world.step(world.step_hz)
        assert world.base_twist("robot")[0][0] == pytest.approx(-1.61, abs=0.1)


def test_omni_in_the_air_cannot_change_its_speed(bot: Callable[[str], RobotSpec], make_scene: MakeScene) -> None:
    robot = replace(bot("omni_bot"), start=pose_from_xyz_rpy((0.0, 0.0, 50.0), (0.0, 0.0, 0.0)))
    with PhysicsWorld(make_scene(robot)) as world:
        send(world, 1.0, 0.5, 0.3, 1.0)
        # It only swings against its wheels, which spin up.
        assert place(world) == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


@pytest.mark.parametrize(("kilograms", "moves"), [(1.0, True), (60.0, False)])
def test_omni_pushes_what_is_light(
    bot: Callable[[str], RobotSpec], make_scene: MakeScene, tmp_path: Path, kilograms: float, moves: bool
) -> None:
    # 8.6 kg with traction 0.5 push with 42 N; friction 0.5 holds a box of 60 kg with 294 N.
    i = kilograms * 0.09 / 6
    (tmp_path / "box.urdf").write_text(
        '<robot name="box"><link name="box"><collision><geometry><box size="0.3 0.3 0.3"/></geometry></collision>'
        f'<inertial><mass value="{kilograms}"/><inertia ixx="{i}" iyy="{i}" izz="{i}"/></inertial></link></robot>'
    )
    box = BodySpec("box", read_urdf(tmp_path / "box.urdf"), pose_from_xyz_rpy((0.6, 0.0, 0.15)))
    scene = replace(make_scene(bot("omni_bot")), bodies=(box,))
    with PhysicsWorld(scene) as world:
        send(world, 4.0, 0.4)
        moved = world.body_pose("box").position[0] - 0.6
        assert moved > 0.8 if moves else moved < 0.01


def test_mass_and_inertia_are_those_of_all_parts_about_the_vertical(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(
        '<robot name="two"><link name="a"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>'
        '<inertia ixx="0.4" iyy="0.4" izz="0.5"/></inertial></link><link name="b"><inertial><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.03"/></inertial></link><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0.3 0.5" rpy="1.5707963267948966 0 0"/></joint></robot>'
    )
    # The second link lies on its side, so that its y axis is vertical: 0.5 + 2 * 0.1^2 + 0.02 + 1 * 0.3^2
    assert mass_and_inertia(read_urdf(tmp_path / "two.urdf")) == pytest.approx((3.0, 0.63))


def test_links_below_an_omni_wheel_have_no_friction(tmp_path: Path) -> None:
    rough = '<contact><lateral_friction value="1"/></contact>'
    (tmp_path / "cart.urdf").write_text(
        f'<robot name="cart"><link name="base">{rough}</link><link name="wheel">{rough}</link><link name="roller">{rough}</link>'
        '<joint name="hub" type="continuous"><parent link="base"/><child link="wheel"/></joint>'
        '<joint name="pin" type="fixed"><parent link="wheel"/><child link="roller"/></joint></robot>'
    )
    model = without_friction(read_urdf(tmp_path / "cart.urdf"), ["hub"])
    assert {link.name: link.friction for link in model.links} == {"base": 1.0, "wheel": 0.0, "roller": 0.0}


@pytest.mark.parametrize("name", BOTS)
def test_stale_command_stops_the_robot(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name)), cmd_vel_timeout=0.5) as world:
        world.command("robot", VelocityCommand((0.25, 0.0, 0.0), (0.0, 0.0, 0.0), 0))
        world.step(120)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.25, abs=0.01)
        world.step(72)
        assert world.base_twist("robot")[0][0] == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize("name", BOTS)
def test_equal_runs_are_bit_equal_also_after_a_reset(bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str) -> None:
    with PhysicsWorld(make_scene(bot(name), collisions=(WALL,))) as world:
        results = []
        for _ in range(2):
            send(world, 1.0, 0.5, 0.2, 0.7)
            send(world, 2.0, 0.5, -0.2, -0.3)
            state = world.state()
            results.append(
                (state.positions.tobytes(), state.quats_xyzw.tobytes(), state.twists.tobytes(), world.odometry("robot"))
            )
            world.reset()
        assert results[0] == results[1]


@pytest.mark.parametrize("name", BOTS)
def test_steps_of_another_length_lead_to_the_same_place(
    bot: Callable[[str], RobotSpec], make_scene: MakeScene, name: str
) -> None:
    with PhysicsWorld(make_scene(bot(name)), step_hz=1000) as world:
        send(world, 2.0, 0.25, yaw=0.2)
        fine = place(world)
    with PhysicsWorld(make_scene(bot(name)), step_hz=120) as world:
        send(world, 2.0, 0.25, yaw=0.2)
        assert place(world) == pytest.approx(fine, abs=0.005)
