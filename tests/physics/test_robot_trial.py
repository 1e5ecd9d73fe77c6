"""The test drive of a robot: what it measures, against the engine and against what is known of the robot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gibson_sim.formats.load_mesh import mesh_points
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import derive_file, load_robot
from gibson_sim.robots.loading.guess import Guess
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import VelocityCommand
from gibson_sim_tools.robots.report import by_hand, report_lines, topics
from gibson_sim_tools.robots.robot_file import robot_file_text
from gibson_sim_tools.robots.trial import try_robot

INERTIA = '<inertia ixx="{0}" ixy="0" ixz="0" iyy="{0}" iyz="0" izz="{0}"/>'
CART = """<robot name="cart"><link name="base_link"><inertial><origin xyz="{x} 0 {height}"/><mass value="20"/>{inertia}</inertial>
<collision><origin xyz="{x} 0 {height}"/><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
<collision><origin xyz="0.3 0 0.02"/><geometry><sphere radius="0.02"/></geometry></collision><contact><lateral_friction value="0"/></contact></link>
{wheels}</robot>"""
WHEEL = """<link name="{side}"><inertial><mass value="0.5"/>{inertia}</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision>
<contact><lateral_friction value="1.5"/></contact></link><joint name="{side}_joint" type="continuous"><parent link="base_link"/>
<child link="{side}"/><origin xyz="0 {y} 0.1"/><axis xyz="0 1 0"/></joint>"""


def cart(folder: Path, *, x: float = 0.1, height: float = 0.5, acceleration: float = 1.0, **drive: float) -> RobotSpec:
    """A mass on two wheels and a ball in front, which tips backward over its axle when it starts faster than g x / height."""
    inertia = INERTIA.format(0.01)
    wheels = "".join(WHEEL.format(side=side, y=y, inertia=inertia) for side, y in (("left", 0.3), ("right", -0.3)))
    (folder / "cart.urdf").write_text(CART.format(x=x, height=height, wheels=wheels, inertia=inertia))
    more = "".join(f", {key}: {value}" for key, value in drive.items())
    limits = f"max_linear_acceleration: {acceleration}, max_wheel_torque: 60"
    drive_text = f"{{type: differential, left_joint: left_joint, right_joint: right_joint, {limits}{more}}}"
    (folder / "robot.yaml").write_text(f"urdf: cart.urdf\ndrive: {drive_text}\n")
    return load_robot(folder)


def test_the_engine_tips_a_robot_at_the_acceleration_that_statics_gives(
    tmp_path: Path, make_scene: Callable[..., SceneSpec]
) -> None:
    at_rest = try_robot(cart(tmp_path))
    limit = at_rest.stability.tipping_acceleration((1.0, 0.0))
    # 20 kg at 0.5 m and 1 kg of wheels at 0.1 m: 9.81 * (20 * 0.1) / (20 * 0.5 + 0.1)
    assert limit == pytest.approx(9.81 * 2.0 / 10.1, rel=0.01)
    tilts = {}
    for part in (0.9, 1.1):
        with PhysicsWorld(make_scene(cart(tmp_path, acceleration=part * limit, max_linear=4.0)), cmd_vel_timeout=10.0) as world:
            world.step(120)
            world.command("robot", VelocityCommand((4.0, 0.0, 0.0), (0.0, 0.0, 0.0), world.stamp_ns))
            world.step(240)
            tilts[part] = -math.degrees(math.asin(2 * world.base_pose("robot").quat_xyzw[1]))
    assert tilts[0.9] < 0.5 and tilts[1.1] > 5.0
    (line,) = [line for line in by_hand(try_robot(cart(tmp_path, acceleration=3.0))) if line.startswith("drive.max_linear")]
    assert line.startswith("drive.max_linear_acceleration: 1.6 instead of 3 m/s^2")
    assert not [line for line in by_hand(at_rest) if line.startswith("drive.max_linear")]


def test_slip_is_measured(tmp_path: Path) -> None:
    straight, turn = try_robot(cart(tmp_path, slip=0.1, turn_slip=0.2)).drives
    assert (straight.slip, turn.slip) == pytest.approx((0.1, 0.2), abs=0.005)
    assert straight.driven.x == pytest.approx(0.9, abs=0.01)
    assert turn.driven.yaw == pytest.approx(0.8 * 2 * math.pi, abs=0.03)
    assert len([line for line in by_hand(try_robot(cart(tmp_path, slip=0.1))) if "wheels slip by 10.0 %" in line]) == 1


def test_a_robot_that_falls_is_not_driven(tmp_path: Path) -> None:
    trial = try_robot(cart(tmp_path, x=-0.2))
    assert trial.has_fallen and trial.drives == ()
    assert "drive: it has fallen over at rest; the test drive is left out" in report_lines(trial)


@pytest.mark.parametrize(("name", "drives"), [("gibson_bot", 2), ("omni_bot", 3), ("ackermann_bot", 2), ("skid_bot", 2)])
def test_our_robots_drive_as_commanded(root: Path, name: str, drives: int) -> None:
    trial = try_robot(load_robot(root / "config/robots" / name))
    assert len(trial.drives) == drives
    for drive in trial.drives:
        assert drive.driven == pytest.approx(drive.commanded, abs=3e-3)
        assert abs(drive.slip) < 1e-3
    assert (trial.tilt, trial.drift) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert trial.drives[-1].driven.yaw == pytest.approx(2 * math.pi, abs=3e-3)


def test_the_report_names_footprint_topics_and_what_the_file_lacks(root: Path) -> None:
    robot = load_robot(root / "config/robots/gibson_bot")
    guess = Guess("lidar", "at scan", by_hand="lidar at scan: beams, from its data sheet")
    lines = report_lines(try_robot(robot), [guess])
    assert any(line.startswith('footprint: "[[') and "robot_radius: 0.175" in line for line in lines)
    assert "set by hand: lidar at scan: beams, from its data sheet" in lines
    assert any(line.startswith("1 m forward: ") for line in lines) and any(
        line.startswith("turn of 360 degrees: ") for line in lines
    )
    named = " ".join(topics(robot))
    for topic in (
        "cmd_vel (in;",
        "odom, ground_truth/odom",
        "scan (sensor_msgs/LaserScan",
        "camera/depth/image_raw",
        "imu (",
        "bumper/wrench",
        "battery_state",
    ):
        assert topic in named
    assert "joint_trajectory" not in named, "it has no joints beside those of its drive"


def test_an_arm_has_joint_topics_and_cannot_tip(root: Path) -> None:
    robot = replace(load_robot(root / "config/robots/arm_bot"), drive=None, fixed_base=True)
    trial = try_robot(robot)
    lines = report_lines(trial)
    assert "support: its base is fixed, it cannot tip over" in lines and "drive: none; the test drive is left out" in lines
    assert "joint_trajectory (in;" in " ".join(topics(robot)) and "cmd_vel" not in " ".join(topics(robot))


@pytest.mark.parametrize(
    ("urdf", "kind", "sensors"),
    [
        ("nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf", "differential", "lidar cameras imu"),
        (
            "nav2_minimal_tb3_tb4/nav2_minimal_tb4_description/urdf/standard/turtlebot4.urdf.xacro",
            "differential",
            "lidar cameras imu",
        ),
    ],
)
def test_manufacturer_robots_drive_with_derived_settings(
    data_dir: Path, tmp_path: Path, urdf: str, kind: str, sensors: str
) -> None:
    derived = derive_file(data_dir / urdf)
    assert derived.values["drive"]["type"] == kind and set(sensors.split()) <= set(derived.values)
    (tmp_path / "robot.yaml").write_text(robot_file_text(str(data_dir / urdf), {}, derived))
    straight, turn = try_robot(load_robot(tmp_path), mesh_points()).drives
    assert straight.driven == pytest.approx((1.0, 0.0, 0.0), abs=0.02)
    assert turn.driven == pytest.approx((0.0, 0.0, 2 * math.pi), abs=0.05)


BARE_WHEEL = """<link name="{0}_wheel"><collision><origin rpy="1.5707963 0 0"/>
<geometry><cylinder radius="0.08" length="0.04"/></geometry></collision></link>
<joint name="{0}_wheel_joint" type="continuous"><parent link="base_link"/><child link="{0}_wheel"/><origin xyz="0.05 {1} 0.08"/>{2}</joint>"""


def bare(folder: Path, *, caster: bool = False, axis: str = '<axis xyz="0 1 0"/>') -> Path:
    """A box and two wheels, as one writes them first: without a mass anywhere."""
    ball = '<collision><origin xyz="-0.15 0 0.02"/><geometry><sphere radius="0.02"/></geometry></collision>' if caster else ""
    box = '<collision><origin xyz="0 0 0.09"/><geometry><box size="0.4 0.3 0.1"/></geometry></collision>'
    wheels = "".join(BARE_WHEEL.format(side, y, axis) for side, y in (("left", 0.18), ("right", -0.18)))
    (folder / "mybot.urdf").write_text(f'<robot name="mybot"><link name="base_link">{box}{ball}</link>{wheels}</robot>')
    return folder / "mybot.urdf"


def bare_report(folder: Path, urdf: Path) -> list[str]:
    derived = derive_file(urdf)
    (folder / "robot.yaml").write_text(robot_file_text(urdf.name, {}, derived))
    return report_lines(try_robot(load_robot(folder)), derived.guesses)


def test_report_names_missing_masses_and_casters_and_omits_meaningless_lines(tmp_path: Path) -> None:
    lines = bare_report(tmp_path, bare(tmp_path))
    assert lines[0].startswith("masses are missing: ") and "base_link (1 kg), left_wheel (0.05 kg)" in lines[0]
    assert lines[2].startswith("support: it stands on two wheels: add a caster")
    assert not [line for line in lines if "at rest" in line or "tips over" in line or "acceleration: " in line]


def test_a_robot_without_masses_drives_by_assumed_ones(tmp_path: Path) -> None:
    lines = bare_report(tmp_path, bare(tmp_path, caster=True))
    assert lines[0].startswith("masses are missing: ") and lines[1].startswith("at rest: tilt 0.0")
    # The box weighs 1 kg at 0.09 m, the wheels 0.1 kg at 0.08 m; 50 mm behind the axle less the wheels' part.
    assert ", 0.089 m above the floor" in lines[2]
    assert "static stability margin: 3" in " ".join(lines) or "static stability margin: 4" in " ".join(lines)
    assert any(line.startswith("1 m forward: 1.00") for line in lines)
    assert not [line for line in lines if "has no mass" in line], "it is told once"


def test_the_axis_that_wheels_lack_is_named(tmp_path: Path) -> None:
    (said,) = [str(guess) for guess in derive_file(bare(tmp_path, axis=""), needs_drive=False).guesses if guess.key == "drive"]
    assert "'left_wheel_joint' lies along x, the robot's forward direction" in said and '<axis xyz="0 1 0"/>' in said
