"""Commands to an arm under load: a base of 20 kg, a shoulder about y, a hand that slides along the arm."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import Inertial, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import CommandError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointEfforts, JointPositions, JointTrajectory, JointVelocities, TrajectoryPoint
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

MakeScene = Callable[..., SceneSpec]
S = 1_000_000_000
URDF = """<robot name="arm">
<link name="base"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.6 0.6 0.4"/></geometry></collision>
<inertial><origin xyz="0 0 0.1"/><mass value="20"/><inertia ixx="0.9" iyy="0.9" izz="1.2"/></inertial></link>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="0.001" iyy="0.014" izz="0.014"/></inertial></link>
<link name="hand"><inertial><mass value="0.5"/><inertia ixx="0.001" iyy="0.001" izz="0.001"/></inertial></link>
<link name="turner"><inertial><mass value="0.1"/><inertia ixx="0.0001" iyy="0.0001" izz="0.0001"/></inertial></link>
<link name="caster"><inertial><mass value="0.1"/><inertia ixx="0.0001" iyy="0.0001" izz="0.0001"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
<limit lower="-1.2" upper="1.0" effort="{effort}" velocity="1.5"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="hand"/><origin xyz="0.3 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.2" effort="40" velocity="0.5"/></joint>
<joint name="twist" type="continuous"><parent link="hand"/><child link="turner"/><axis xyz="1 0 0"/>
<limit effort="5" velocity="6"/></joint>
<joint name="caster_joint" type="continuous"><parent link="base"/><child link="caster"/><origin xyz="-0.2 0 0.5"/>
<axis xyz="0 0 1"/></joint>
</robot>"""


@pytest.fixture
def make_arm(tmp_path: Path) -> Callable[..., RobotSpec]:
    def make(effort: float = 60.0) -> RobotSpec:
        (tmp_path / "arm.urdf").write_text(URDF.format(effort=effort))
        (tmp_path / "robot.yaml").write_text("urdf: arm.urdf\n")
        return load_robot(tmp_path)

    return make


@pytest.fixture
def scene(make_scene: MakeScene, make_arm: Callable[..., RobotSpec]) -> SceneSpec:
    return make_scene(make_arm())


def joints(world: PhysicsWorld) -> dict[str, float]:
    states = world.joint_states("robot")
    return dict(zip(states.names, states.positions.tolist(), strict=True))


def test_joints_without_commands_hold_their_start(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.step(5 * world.step_hz)
        assert joints(world) == pytest.approx({"shoulder": 0.0, "slide": 0.0, "twist": 0.0, "caster_joint": 0.0}, abs=1e-3)


def test_position_is_reached_against_gravity_and_held(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointPositions((-0.75, 0.15), ("shoulder", "slide")))
        # 0.75 rad at 1.5 rad/s: half of it after a quarter of a second.
        world.step(60)
        assert joints(world)["shoulder"] == pytest.approx(-0.375, abs=0.02)
        world.step(5 * world.step_hz)
        assert joints(world)["shoulder"] == pytest.approx(-0.75, abs=2e-3)
        assert joints(world)["slide"] == pytest.approx(0.15, abs=2e-3)


def test_speed_stays_within_the_limit(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointPositions((1.0,), ("shoulder",)))
        fastest = 0.0
        for _ in range(240):
            world.step()
            fastest = max(fastest, abs(world.joint_states("robot").velocities[0]))
        assert fastest == pytest.approx(1.5, rel=0.02)


def test_velocity_turns_a_continuous_joint(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointVelocities((3.0,), ("twist",)))
        world.step(2 * world.step_hz)
        assert joints(world)["twist"] == pytest.approx(6.0, abs=0.05)
        world.command_joints("robot", JointVelocities((0.0,), ("twist",)))
        world.step(world.step_hz)
        assert joints(world)["twist"] == pytest.approx(6.0, abs=0.05)


def test_velocity_ends_at_the_limit_of_position(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointVelocities((-0.5,), ("shoulder",)))
        world.step(6 * world.step_hz)
        assert joints(world)["shoulder"] == pytest.approx(-1.2, abs=0.01)


def test_trajectory_passes_through_its_points_on_time(scene: SceneSpec) -> None:
    points = (
        TrajectoryPoint(S, (-0.6, 0.10), (-0.3, 0.0)),
        TrajectoryPoint(2 * S, (-0.8, 0.05), (0.0, 0.0)),
        TrajectoryPoint(3 * S, (0.2, 0.20), (0.0, 0.0)),
    )
    with PhysicsWorld(scene) as world:
        world.step(120)
        world.command_joints("robot", JointTrajectory(("shoulder", "slide"), points))
        for point in points:
            world.step(world.step_hz)
            now = joints(world)
            assert (now["shoulder"], now["slide"]) == pytest.approx(point.positions, abs=4e-3)
        world.step(2 * world.step_hz)
        now = joints(world)
        assert (now["shoulder"], now["slide"]) == pytest.approx((0.2, 0.20), abs=2e-3)


def test_joint_that_cannot_be_at_zero_holds_the_nearest_limit(make_scene: MakeScene, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF.format(effort=60.0).replace('lower="-1.2" upper="1.0"', 'lower="-1.2" upper="-0.1"'))
    (tmp_path / "robot.yaml").write_text("urdf: arm.urdf\n")
    with PhysicsWorld(make_scene(load_robot(tmp_path))) as world:
        world.step(2 * world.step_hz)
        assert joints(world)["shoulder"] == pytest.approx(-0.1, abs=2e-3)


def test_weak_motor_does_not_lift(make_scene: MakeScene, make_arm: Callable[..., RobotSpec]) -> None:
    # Level, the arm weighs 9.81 (1 * 0.2 + 0.6 * 0.3) = 3.7 N m on the shoulder; the motor has 2.
    with PhysicsWorld(make_scene(make_arm(effort=2.0))) as world:
        world.command_joints("robot", JointPositions((-1.0,), ("shoulder",)))
        world.step(3 * world.step_hz)
        assert joints(world)["shoulder"] > 0.5
        assert max(abs(world.joint_states("robot").efforts[0]), 0.0) <= 2.0 + 1e-6


def test_empty_trajectory_stops_the_arm_where_it_is(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointTrajectory(("shoulder",), (TrajectoryPoint(2 * S, (-1.0,)),)))
        world.step(world.step_hz)
        world.command_joints("robot", JointTrajectory((), ()))
        world.step(2 * world.step_hz)
        assert joints(world)["shoulder"] == pytest.approx(-0.5, abs=0.02)


def test_joint_without_a_motor_ignores_commands(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world, pytest.raises(CommandError, match="known: shoulder, slide, twist"):
        world.command_joints("robot", JointPositions((0.0,), ("caster_joint",)))


def test_wheels_obey_the_drive_alone(root: Path, make_scene: MakeScene) -> None:
    car = load_robot(root / "config/robots/ackermann_bot")
    with PhysicsWorld(make_scene(car)) as world, pytest.raises(CommandError, match="belongs to the drive"):
        world.command_joints("robot", JointPositions((0.1,), ("steering_left_joint",)))


def test_reset_forgets_commands(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointPositions((-1.0,), ("shoulder",)))
        world.step(120)
        world.reset()
        world.step(world.step_hz)
        assert joints(world)["shoulder"] == pytest.approx(0.0, abs=1e-3)


def test_effort_accelerates_as_newton_says_up_to_the_limit_of_velocity(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(), step_hz=1000) as world:
        world.add(door())
        world.command_joints("door", JointEfforts((2.0,), ("hinge",)))
        world.step(100)
        # 2 N m on 0.5 kg m^2.
        assert world.joint_states("door").velocities[0] == pytest.approx(0.4, rel=0.01)
        assert world.joint_states("door").efforts[0] == pytest.approx(2.0, rel=0.01)
        world.step(300)
        assert world.joint_states("door").velocities[0] == pytest.approx(0.8, rel=0.01)


def test_effort_ends_at_the_limit_of_position(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        for effort, end in ((-60.0, -1.2), (60.0, 1.0)):
            world.command_joints("robot", JointEfforts((effort,), ("shoulder",)))
            for _ in range(60):
                world.step(12)
                assert -1.205 < joints(world)["shoulder"] < 1.005
            assert joints(world)["shoulder"] == pytest.approx(end, abs=2e-3)


def test_zero_effort_lets_an_arm_fall_until_the_next_command(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        world.command_joints("robot", JointEfforts((0.0,), ("shoulder",)))
        world.step(240)
        assert joints(world)["shoulder"] > 0.9
        world.command_joints("robot", JointPositions((-0.5,), ("shoulder",)))
        world.step(480)
        assert joints(world)["shoulder"] == pytest.approx(-0.5, abs=2e-3)


def test_effort_beyond_the_limit_is_refused(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world, pytest.raises(CommandError, match="effort is 61, must be -60 to 60"):
        world.command_joints("robot", JointEfforts((61.0,), ("shoulder",)))


def door() -> BodySpec:
    """A leaf about z with 0.5 kg m^2, at most 0.8 rad/s, from 0 to 1.5 rad."""
    frame = UrdfLink("frame", (), (), Inertial(1.0, Pose(), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
    leaf = UrdfLink("leaf", (), (), Inertial(5.0, Pose(), (0.5, 0.0, 0.0, 0.5, 0.0, 0.5)))
    hinge = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), 0.0, 1.5, effort=20.0, velocity=0.8)
    return BodySpec("door", UrdfModel("door", Path("/nowhere/d.urdf"), (frame, leaf), (hinge,)), Pose((0.0, 0.0, 1.0)), True)


def test_joints_of_a_body_follow_commands_also_asleep_and_swing_free_when_released(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene()) as world:
        world.add(door())
        world.step(720)
        world.command_joints("door", JointPositions((0.8,), ("hinge",)))
        world.step(60)
        assert world.joint_states("door").velocities[0] == pytest.approx(0.8, rel=0.02)
        world.step(420)
        assert world.joint_states("door").positions[0] == pytest.approx(0.8, abs=1e-3)
        world.command_joints("door", JointVelocities((-0.4,), ("hinge",)))
        world.step(120)
        world.command_joints("door", JointEfforts((0.0,), ("hinge",)))
        world.step(60)
        assert world.joint_states("door").velocities[0] == pytest.approx(-0.4, rel=0.02), "nothing slows it"


def test_reset_and_set_time_clear_joint_commands_of_a_body(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene()) as world:
        world.add(door())
        world.command_joints("door", JointVelocities((0.5,), ("hinge",)))
        world.step(120)
        world.set_step_count(0)
        world.step(120)
        assert world.joint_states("door").positions[0] == pytest.approx(0.25, abs=0.01)
        world.reset()
        world.step(120)
        assert world.joint_states("door").positions[0] == pytest.approx(0.0, abs=1e-6)


def test_command_for_joints_of_an_unknown_robot_is_refused(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene()) as world:
        world.add(door())
        with pytest.raises(CommandError, match="no joint 'lock' that accepts commands; known: hinge"):
            world.command_joints("door", JointPositions((0.1,), ("lock",)))
        world.remove("door")
        with pytest.raises(CommandError, match="no robot or body 'door' in this world; known: none"):
            world.command_joints("door", JointPositions((0.1,), ("hinge",)))


def test_equal_runs_are_bit_equal(scene: SceneSpec) -> None:
    with PhysicsWorld(scene) as world:
        results = []
        for _ in range(2):
            world.command_joints("robot", JointTrajectory(("shoulder",), (TrajectoryPoint(S, (-0.9,), (0.0,), (0.0,)),)))
            world.command_joints("robot", JointVelocities((math.pi,), ("twist",)))
            world.command_joints("robot", JointEfforts((1.5,), ("slide",)))
            world.step(300)
            results.append((world.joint_states("robot").positions.tobytes(), world.state().positions.tobytes()))
            world.reset()
        assert results[0] == results[1]
