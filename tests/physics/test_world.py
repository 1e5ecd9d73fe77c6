"""Guarantees of PhysicsWorld besides driving: frames, determinism, isolation, rays, lifetime."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import read_urdf
from gibson_sim.errors import CommandError, ConfigError, PhysicsError
from gibson_sim.geometry.transforms import matrices_from_poses, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld, non_degenerate_triangles
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.types import Pose, VelocityCommand

MakeScene = Callable[..., SceneSpec]
WALL = CollisionSpec("wall", Shape("box", (0.2, 20.0, 1.0)), pose_from_xyz_rpy((0.7, 0.0, 0.5)))
ZERO = VelocityCommand((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0)

OFFSET_URDF = """<robot name="r">
<link name="base"><inertial><origin xyz="0.3 -0.2 0.5" rpy="0.4 0.5 0.6"/><mass value="2"/>
<inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0.03" izz="0.15"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.1 0.4 -0.2" rpy="0.3 0 0"/><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="tip"/>
<joint name="j" type="continuous"><parent link="base"/><child link="arm"/>
<origin xyz="0 0 1" rpy="0.2 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="t" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.5 0 0" rpy="0 0.7 0"/></joint>
</robot>"""


def offset_robot(folder: Path) -> RobotSpec:
    """Returns a robot whose centres of mass are far from its link frames, rotated and lifted."""
    (folder / "r.urdf").write_text(OFFSET_URDF)
    (folder / "robot.yaml").write_text("urdf: r.urdf\nradius: 0.1\nheight: 1\n")
    return load_robot(folder / "robot.yaml", start=pose_from_xyz_rpy((1.0, 2.0, 30.0), (0.1, 0.2, 0.3)))


def flatten(world: PhysicsWorld) -> NDArray[np.float64]:
    state = world.state()
    return np.concatenate([state.positions.ravel(), state.quats_xyzw.ravel(), state.twists.ravel()])


def run(world: PhysicsWorld) -> NDArray[np.float64]:
    """Drives the robot 1,000 steps in curves, into the wall; returns the last state as one row."""
    for i in range(50):
        world.command("robot", VelocityCommand((0.4, 0.0, 0.0), (0.0, 0.0, math.sin(i / 5)), world.stamp_ns))
        world.step(20)
    return flatten(world)


def test_state_holds_link_frames_not_centres_of_mass(make_scene: MakeScene, tmp_path: Path) -> None:
    robot = offset_robot(tmp_path)
    with PhysicsWorld(make_scene(robot)) as world:
        state = world.state()
        got = dict(zip(state.links, matrices_from_poses(state.positions, state.quats_xyzw), strict=True))
    T_world_base = matrix_from_pose(robot.start)
    for link, T_base_link in read_urdf(robot.urdf).transforms().items():
        np.testing.assert_allclose(got[f"robot/{link}"], T_world_base @ T_base_link, atol=1e-9)


def test_twists_are_those_of_the_link_frames(make_scene: MakeScene, tmp_path: Path) -> None:
    # A body that falls and tumbles: the velocity must be the derivative of the position, for every link.
    robot = offset_robot(tmp_path)
    with PhysicsWorld(replace(make_scene(robot), gravity=(0.0, 3.0, -9.81)), step_hz=10_000) as world:
        # A motor on one of two links gives a spin; without it the test would not cover w x r.
        world._bullet.drive_joints(world._robots["robot"].engine_body, [0], [4.0], [50.0])
        world.step(500)
        before = world.state()
        world.step(1)
        now = world.state()
        world.step(1)
        after = world.state()
    measured = (after.positions - before.positions) * world.step_hz / 2
    assert np.abs(now.twists[:, 3:]).max() > 0.3
    np.testing.assert_allclose(now.twists[:, :3], measured, atol=5e-3)


def test_links_are_named_by_body_root_first(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        assert world.links == tuple(f"robot/{link}" for link in robot.links)
        assert world.links[0] == "robot/base_footprint"


def test_stamp_is_exact(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(), step_hz=240) as world:
        world.step(1)
        assert world.stamp_ns == 4_166_666
        world.step(239)
        assert (world.step_count, world.stamp_ns) == (240, 1_000_000_000)
        assert world.state().stamp_ns == 1_000_000_000


def test_state_stays_when_time_goes_on(make_scene: MakeScene, robot: RobotSpec, drive: Callable[..., None]) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        state = world.state()
        drive(world, 0.5, 0.0, 1.0)
        assert state.positions[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_equal_worlds_give_equal_bits(make_scene: MakeScene, mesh_floor: CollisionSpec, robot: RobotSpec) -> None:
    other = replace(robot, name="other", start=pose_from_xyz_rpy((0.4, 0.45, 0.0), (0.0, 0.0, -1.5)))
    scene = make_scene(robot, other, collisions=(mesh_floor, WALL), ground_z=None)
    with PhysicsWorld(scene) as a, PhysicsWorld(scene) as b:
        assert run(a).tobytes() == run(b).tobytes()


@pytest.mark.parametrize("keep_time", [False, True])
def test_run_after_reset_gives_equal_bits(
    make_scene: MakeScene, mesh_floor: CollisionSpec, robot: RobotSpec, keep_time: bool
) -> None:
    with PhysicsWorld(make_scene(robot, collisions=(mesh_floor, WALL), ground_z=None)) as world:
        start = flatten(world)
        first = run(world)
        world.reset(keep_time=keep_time)
        assert flatten(world).tobytes() == start.tobytes()
        assert run(world).tobytes() == first.tobytes()


def test_reset_forgets_the_command_and_the_odometry(make_scene: MakeScene, robot: RobotSpec, drive: Callable[..., None]) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        drive(world, 0.5, 0.3, 1.0)
        world.reset()
        assert world.stamp_ns == 0
        assert world.odometry("robot").x == 0.0
        world.step(60)
        assert world.base_pose("robot").position == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


def test_reset_can_let_time_run_on(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        world.step(240)
        world.reset(keep_time=True)
        assert world.stamp_ns == 1_000_000_000


def test_two_worlds_do_not_touch_each_other(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as alone:
        expected = run(alone)
    with PhysicsWorld(make_scene(robot)) as a, PhysicsWorld(make_scene(robot, collisions=(WALL,))) as b:
        for i in range(50):
            for world in (a, b):
                world.command("robot", VelocityCommand((0.4, 0.0, 0.0), (0.0, 0.0, math.sin(i / 5)), world.stamp_ns))
                world.step(20)
        got = flatten(a)
        assert got.tobytes() == expected.tobytes()
        assert b.base_pose("robot").position[0] < 0.6 - robot.radius + 0.01 < a.base_pose("robot").position[0]
        b.close()
        a.step()


def test_robots_collide_with_each_other(make_scene: MakeScene, robot: RobotSpec, drive: Callable[..., None]) -> None:
    other = replace(robot, name="other", start=Pose((0.6, 0.0, 0.0)))
    with PhysicsWorld(make_scene(robot, other)) as world:
        drive(world, 0.3, 0.0, 4.0)
        gap = world.base_pose("other").position[0] - world.base_pose("robot").position[0]
        assert gap > 2 * robot.radius - 0.01


def test_rays_measure_distance_to_box_mesh_and_plane(make_scene: MakeScene, mesh_floor: CollisionSpec) -> None:
    scene = make_scene(collisions=(replace(mesh_floor, pose=Pose((0.0, 0.0, 2.0))), WALL), ground_z=-1.0)
    with PhysicsWorld(scene) as world:
        origins = [[0.0, 0.1, 0.5], [0.0, 0.1, 0.5], [0.0, 0.1, 0.5], [0.0, 0.1, 0.5]]
        got = world.cast_rays(origins, [[1, 0, 0], [0, 0, 1], [0, 0, -1], [-1, 0, 0]], 10.0)
    # The wall's face is at x = 0.6, the mesh at z = 2, the plane at z = -1.
    assert got.tolist() == pytest.approx([0.6, 1.5, 1.5, math.inf])


def test_rays_end_at_their_range(make_scene: MakeScene) -> None:
    with PhysicsWorld(make_scene(collisions=(WALL,))) as world:
        got = [world.cast_rays([[0.0, 0.0, 0.5]], [[1, 0, 0]], range_max)[0] for range_max in (0.59, 0.61)]
    assert got == pytest.approx([math.inf, 0.6])


def test_rays_pass_through_the_ignored_robot_and_hit_the_other(make_scene: MakeScene, robot: RobotSpec) -> None:
    other = replace(robot, name="other", start=Pose((1.0, 0.0, 0.0)))
    with PhysicsWorld(make_scene(robot, other)) as world:
        ray = ([[-1.0, 0.0, 0.05]], [[1, 0, 0]], 5.0)
        assert world.cast_rays(*ray, "robot")[0] == pytest.approx(2.0 - 0.175, abs=1e-3)
        assert world.cast_rays(*ray, "other")[0] == pytest.approx(1.0 - 0.175, abs=1e-3)


def test_many_rays_are_cast_in_order(make_scene: MakeScene) -> None:
    heights = np.linspace(0.1, 5.0, 20_001)
    with PhysicsWorld(make_scene()) as world:
        got = world.cast_rays(np.stack([0 * heights, 0 * heights, heights], -1), np.tile([0, 0, -1], (20_001, 1)), 10.0)
    np.testing.assert_allclose(got, heights, atol=1e-9)


def test_mesh_scale_is_obeyed(make_scene: MakeScene, mesh_floor: CollisionSpec) -> None:
    big = replace(mesh_floor, shape=replace(mesh_floor.shape, size=(2.0, 1.0, 1.0)))
    with PhysicsWorld(make_scene(collisions=(big,), ground_z=None)) as world:
        # The floor spans x +-12, y +-6 (its border is jagged by 0.08 m).
        got = world.cast_rays([[11.0, 0.0, 1.0], [0.0, 7.0, 1.0]], [[0, 0, -1], [0, 0, -1]], 5.0)
    assert got.tolist() == [1.0, math.inf]


def test_large_mesh_is_whole(make_scene: MakeScene, tmp_path: Path) -> None:
    # 180,000 triangles exceed PyBullet's limit: hits everywhere prove that no piece is lost.
    n = 300
    x, y = np.meshgrid(np.arange(n + 1) * 0.1, np.arange(n + 1) * 0.1, indexing="ij")
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)[None]).ravel() + 1
    lines = [f"v {a:.2f} {b:.2f} 0" for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    lines += [f"f {i} {i + n + 1} {i + n + 2}\nf {i} {i + n + 2} {i + 1}" for i in first]
    (tmp_path / "big.obj").write_text("\n".join(lines) + "\n")
    shape = Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "big.obj"))
    origins = np.random.default_rng(0).uniform([0.01, 0.01, 1.0], [29.99, 29.99, 1.0], (2000, 3))
    with PhysicsWorld(make_scene(collisions=(CollisionSpec("big", shape),), ground_z=None)) as world:
        got = world.cast_rays(origins, np.tile([0, 0, -1], (2000, 1)), 5.0)
    np.testing.assert_allclose(got, 1.0, atol=1e-9)


def test_broken_collision_mesh_is_left_out_with_a_warning(make_scene: MakeScene, tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text("v 0 0 0\n")
    bad = CollisionSpec("bad", Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "bad.obj")))
    with PhysicsWorld(make_scene(collisions=(bad, WALL))) as world:
        assert "'bad' is left out" in world.warnings[0]
        assert world.cast_rays([[0.0, 0.0, 0.5]], [[1, 0, 0]], 5.0)[0] == pytest.approx(0.6)


def test_triangles_without_area_are_dropped() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]])
    got = non_degenerate_triangles(vertices, [[0, 1, 2], [0, 1, 1], [0, 1, 3], [0, 1, 4]])
    assert got.tolist() == [[0, 1, 2]]


def test_unknown_robot_is_refused_with_the_known_ones(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world, pytest.raises(CommandError, match=r"'bob'.*known: robot"):
        world.command("bob", ZERO)


def test_robot_without_a_drive_refuses_commands(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(replace(robot, drive=None))) as world:
        with pytest.raises(CommandError, match="no drive"):
            world.command("robot", ZERO)
        world.step(10)


def test_two_robots_of_one_name_are_refused(make_scene: MakeScene, robot: RobotSpec) -> None:
    with pytest.raises(PhysicsError, match="must differ"):
        PhysicsWorld(make_scene(robot, robot))


@pytest.mark.parametrize(("setting", "value"), [("step_hz", 0), ("cmd_vel_timeout", 0.0), ("cmd_vel_timeout", math.nan)])
def test_impossible_setting_is_refused(make_scene: MakeScene, setting: str, value: float) -> None:
    with pytest.raises(ConfigError, match=setting):
        PhysicsWorld(make_scene(), **{setting: value})


def test_use_after_close_is_refused(make_scene: MakeScene, robot: RobotSpec) -> None:
    world = PhysicsWorld(make_scene(robot))
    world.state()
    world.close()
    world.close()
    for use in (world.step, world.state, lambda: world.base_pose("robot"), world.reset, lambda: world.joint_states("robot")):
        with pytest.raises(PhysicsError, match="closed"):
            use()


def test_closed_world_gives_its_client_back(make_scene: MakeScene) -> None:
    clients = set()
    for _ in range(5):
        with PhysicsWorld(make_scene()) as world:
            clients.add(world._bullet.client)
    assert len(clients) == 1


def test_nothing_is_written_to_the_terminal(root: Path) -> None:
    code = (
        "from pathlib import Path; from gibson_sim.physics.world import PhysicsWorld;"
        "from gibson_sim.robots.load import load_robot;"
        "from gibson_sim.scenes.spec import SceneSpec;"
        f"robot = load_robot({str(root / 'config/robots/gibson_bot')!r});"
        "w = PhysicsWorld(SceneSpec('s', Path('.'), '', (), (), ground_z=0.0, robots=(robot,)));"
        "w.step(10); w.close()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_a_mesh_of_a_robot_that_is_missing_is_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = '<visual><geometry><mesh filename="nothere.obj"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="base">{mesh}</link></robot>')
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nradius: 0.2\nheight: 0.3\n")
    robot = load_robot(tmp_path)
    with PhysicsWorld(SceneSpec("empty", Path("/nowhere"), "0", (), (), ground_z=0.0, robots=(robot,))) as world:
        assert any("nothere.obj" in warning for warning in world.warnings)
    assert sum("nothere.obj" in record.getMessage() for record in caplog.records) == 1
