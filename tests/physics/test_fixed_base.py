"""Robots whose base is fixed, such as an arm on a table, or a robot with legs that is held."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.spec import SceneSpec

ARM = """<robot name="arm"><link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<link name="bar"><collision><origin xyz="0.5 0 0"/><geometry><mesh filename="bar.obj"/></geometry></collision><inertial><origin xyz="0.5 0 0"/>
<mass value="5"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="lift" type="revolute"><parent link="base"/><child link="bar"/><origin xyz="0 0 0.05"/><axis xyz="0 -1 0"/>
<limit lower="-1" upper="1" effort="100" velocity="2"/></joint></robot>"""


def test_an_arm_whose_base_is_fixed_stands_where_a_free_one_falls(make_scene: Callable[..., SceneSpec], tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(ARM)
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.02, 0.02) for z in (-0.02, 0.02)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    text = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, face)) for face in faces]
    (tmp_path / "bar.obj").write_text("\n".join(text) + "\n")
    for fixed in (True, False):
        (tmp_path / "robot.yaml").write_text(f"urdf: arm.urdf\nbase_height: 0.05\nfixed_base: {str(fixed).lower()}\n")
        robot = load_robot(tmp_path)
        with PhysicsWorld(make_scene(robot)) as world:
            assert world.is_static("robot") is fixed
            world.command_joints("robot", JointPositions((0.5,), ("lift",)))
            world.step(480)
            if fixed:
                assert world.joint_states("robot").positions[0] == pytest.approx(0.5, abs=0.01)
                assert world.body_pose("robot").position == (0.0, 0.0, 0.0)
                world.reset()
                assert world.joint_states("robot").positions[0] == pytest.approx(0.0, abs=1e-6)
            else:
                _, _, _, w = world.body_pose("robot").quat_xyzw
                assert abs(w) < 0.999, "it has tipped over"
