"""Third-party robots: the Husky of PyBullet's data, TurtleBot 3, LoCoBot; and mimic joints."""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.urdf import parse_urdf
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import VelocityCommand

MakeScene = Callable[..., SceneSpec]
TURTLEBOT = "urdf: {}/nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf\nlidar: {{link: base_scan}}\n"
LOCOBOT = """urdf: {}/locobot/interbotix_ros_xslocobots/interbotix_xslocobot_descriptions/urdf/locobot.urdf.xacro
xacro_args: {{robot_name: locobot, base_model: kobuki, robot_model: locobot_wx250s, arm_model: mobile_wx250s, show_lidar: true}}
manipulators:
  - name: arm
    joints: [waist, shoulder, elbow, forearm_roll, wrist_angle, wrist_rotate]
    tip_link: locobot/ee_gripper_link
    gripper: {{joints: [left_finger], open: 0.037, closed: 0.015, max_effort: 5.0}}
named_poses: {{sleep: {{shoulder: -1.1, elbow: 1.55, wrist_angle: 0.5, left_finger: 0.03}}}}
home: sleep
"""
DRIVE = "drive: {{type: differential, left_joint: wheel_left_joint, right_joint: wheel_right_joint, wheel_radius: {}}}\n"
SLIDES = """<robot name="r"><link name="base"><inertial><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
</inertial></link><link name="a">{0}</link><link name="b">{0}</link>
<joint name="lead" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="100" velocity="1"/></joint>
<joint name="follow" type="{1}"><parent link="base"/><child link="b"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="100" velocity="9"/><mimic joint="lead" multiplier="-2" offset="0.1"/></joint></robot>"""
INERTIAL = '<inertial><mass value="0.3"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts the cache of expanded descriptions in a temporary folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def moved(world: PhysicsWorld, linear: float, angular: float, steps: int = 240) -> tuple[float, float]:
    """Commands a velocity for a while; returns the final velocity of the base, m/s and rad/s."""
    for _ in range(steps):
        world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
        world.step()
    speed, spin = world.base_twist("robot")
    return speed[0], spin[2]


def positions(world: PhysicsWorld, name: str) -> dict[str, float]:
    states = world.joint_states(name)
    return dict(zip(states.names, states.positions.tolist(), strict=True))


@pytest.mark.parametrize(("linear", "angular"), [(0.6, 0.0), (0.3, 0.8)])
def test_the_husky_drives_as_commanded(root: Path, make_scene: MakeScene, linear: float, angular: float) -> None:
    husky = load_robot(root / "config/robots/husky")
    assert husky.drive is not None
    assert husky.drive.wheel_radius == pytest.approx(0.17775)
    assert husky.drive.wheel_separation == pytest.approx(0.5708 * 1.875)  # type: ignore[union-attr]
    with PhysicsWorld(make_scene(husky)) as world:
        assert moved(world, linear, angular) == pytest.approx((linear, angular), rel=0.02, abs=0.002)
        # Its file gives its wheels a stiffness: 30 kN/m each, under 46 kg.
        assert world.base_pose("robot").position[2] == pytest.approx(-0.0025, abs=0.0015)


def test_the_husky_is_drawn_from_meshes_that_are_there(root: Path) -> None:
    husky = load_robot(root / "config/robots/husky")
    assert len(husky.visuals) == 9
    assert all(Path(visual.shape.mesh).is_file() for visual in husky.visuals)
    assert "$(" not in husky.urdf.read_text()


@pytest.mark.parametrize(
    ("urdf", "kind"),
    [
        ("nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf", "differential"),
        ("nav2_minimal_tb3_tb4/nav2_minimal_tb4_description/urdf/standard/turtlebot4.urdf.xacro", "differential"),
        ("pybullet_data/husky/husky.urdf", "skid_steer"),
        ("pybullet_data/racecar/racecar.urdf", "ackermann"),
    ],
)
def test_a_description_alone_drives_a_metre_and_turns(
    request: pytest.FixtureRequest, make_scene: MakeScene, urdf: str, kind: str
) -> None:
    if urdf.startswith("pybullet_data"):
        import pybullet_data

        path = Path(pybullet_data.getDataPath()).parent / urdf
    else:
        path = request.getfixturevalue("data_dir") / urdf
    if path.suffix == ".xacro" and importlib.util.find_spec("xacro") is None:
        pytest.skip("the xacro package is not installed; pip install xacro")
    robot = load_robot(path)
    assert robot.drive is not None
    assert robot.drive.kind == kind
    with PhysicsWorld(make_scene(robot)) as world:
        start = world.base_pose("robot").position
        moved(world, 0.25, 0.0, 4 * 240)
        moved(world, 0.0, 0.0)
        ahead = world.base_pose("robot").position
        assert (ahead[0] - start[0], ahead[1] - start[1]) == pytest.approx((1.0, 0.0), abs=0.02)
        assert moved(world, 0.2, 0.25)[1] == pytest.approx(0.25, rel=0.05)


def test_turtlebot_3_drives_as_commanded(data_dir: Path, tmp_path: Path, make_scene: MakeScene) -> None:
    (tmp_path / "robot.yaml").write_text(TURTLEBOT.format(data_dir) + DRIVE.format(0.033))
    robot = load_robot(tmp_path)
    # Its meshes are in millimetres.
    assert [v.shape.size for v in robot.visuals if v.shape.mesh.endswith("tire.dae")] == [(0.001, 0.001, 0.001)] * 2
    with PhysicsWorld(make_scene(robot)) as world:
        assert moved(world, 0.2, 0.5) == pytest.approx((0.2, 0.5), rel=0.02, abs=0.005)


def test_locobot_drives_and_both_fingers_follow(data_dir: Path, tmp_path: Path, make_scene: MakeScene) -> None:
    if importlib.util.find_spec("xacro") is None:
        message = "SKIPPED: the xacro package is not installed; pip install xacro"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    (tmp_path / "robot.yaml").write_text(LOCOBOT.format(data_dir) + DRIVE.format(0.0352))
    robot = load_robot(tmp_path)
    with PhysicsWorld(make_scene(robot)) as world:
        world.command_joints("robot", JointPositions((0.02,), ("left_finger",)))
        assert moved(world, 0.2, 0.5) == pytest.approx((0.2, 0.5), rel=0.02, abs=0.01)
        there = positions(world, "robot")
        assert (there["left_finger"], there["right_finger"]) == pytest.approx((0.02, -0.02), abs=1e-4)
        assert (there["shoulder"], there["elbow"]) == pytest.approx((-1.1, 1.55), abs=0.01)


@pytest.mark.parametrize("kind", ["prismatic", "revolute"])
def test_a_joint_that_mimics_is_where_its_leader_puts_it(make_scene: MakeScene, kind: str) -> None:
    model = parse_urdf(SLIDES.format(INERTIAL, kind), Path("r.urdf"))
    body = BodySpec("one", model, static=True, joints=(("lead", 0.2),))
    scene = SceneSpec("test", Path(), "", (), (), bodies=(body,))
    with PhysicsWorld(scene) as world:
        assert positions(world, "one") == {"lead": pytest.approx(0.2), "follow": pytest.approx(-0.3)}
        world.command_joints("one", JointPositions((0.4,), ("lead",)))
        for _ in range(4):
            world.step(30)
            there = positions(world, "one")
            assert there["follow"] == pytest.approx(0.1 - 2 * there["lead"], abs=2e-3)
        assert there == {"lead": pytest.approx(0.4, abs=1e-3), "follow": pytest.approx(-0.7, abs=2e-3)}
        world.reset()
        world.step(10)
        assert positions(world, "one")["follow"] == pytest.approx(0.1 - 2 * positions(world, "one")["lead"], abs=2e-3)


def test_gears_are_gone_with_their_body(make_scene: MakeScene) -> None:
    model = parse_urdf(SLIDES.format(INERTIAL, "revolute"), Path("r.urdf"))
    with PhysicsWorld(SceneSpec("test", Path(), "", (), ())) as world:
        for number in range(20):
            world.add(BodySpec(f"one{number}", model, static=True))
            world.step(2)
            world.remove(f"one{number}")
        world.add(BodySpec("last", model, static=True))
        world.step(60)
        there = positions(world, "last")
        assert there["follow"] == pytest.approx(0.1 - 2 * there["lead"], abs=5e-3)


def test_textures_of_collision_meshes_are_never_kept_by_the_engine(make_scene: MakeScene, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "noise.png"), np.zeros((512, 512, 3), dtype=np.uint8))
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd noise.png\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nusemtl m\nf 1/1 3/1 2/1\nf 1/1 2/1 4/1\nf 2/1 3/1 4/1\nf 3/1 1/1 4/1\n"
    )
    shape = '<collision><geometry><mesh filename="m.obj"/></geometry></collision>'
    model = parse_urdf(f'<robot name="r"><link name="base">{shape}{INERTIAL}</link></robot>', tmp_path / "r.urdf")

    def resident_kb() -> int:
        return next(
            int(line.split()[1]) for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS")
        )

    with PhysicsWorld(make_scene()) as world:
        before = 0
        for number in range(60):
            world.add(BodySpec(f"one{number}", model))
            world.remove(f"one{number}")
            before = before or (resident_kb() if number == 20 else 0)
        # A texture has 786 kB.
        assert resident_kb() - before < 10 * 786


def test_continuous_joints_of_an_arm_are_held(make_scene: MakeScene, tmp_path: Path) -> None:
    # A bar on a level axis would swing down.
    text = """<robot name="r"><link name="base"><collision><geometry><box size="1 1 0.1"/></geometry></collision>
    <inertial><mass value="50"/><inertia ixx="5" ixy="0" ixz="0" iyy="5" iyz="0" izz="5"/></inertial></link>
    <link name="bar"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
    </inertial></link><joint name="j" type="continuous"><parent link="base"/><child link="bar"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 1 0"/><limit effort="20" velocity="1"/></joint></robot>"""
    (tmp_path / "r.urdf").write_text(text)

    def angle(arm: str) -> float:
        (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n" + arm)
        robot: RobotSpec = load_robot(tmp_path)
        with PhysicsWorld(make_scene(robot)) as world:
            world.step(60)
            return math.fabs(positions(world, "robot")["j"])

    assert angle("manipulators: [{name: arm, joints: [j], tip_link: bar}]\n") < 1e-3
    assert angle("") > 0.5
