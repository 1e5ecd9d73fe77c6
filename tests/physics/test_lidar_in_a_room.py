"""The lidar of our robot in a room whose four walls are at four different distances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.sensors.lidar import Scan, measure_scan
from gibson_sim.types import Pose


def block(name: str, x: float, y: float, size: tuple[float, float, float]) -> CollisionSpec:
    return CollisionSpec(name, Shape("box", size), Pose((x, y, 0.5)))


MakeScene = Callable[..., SceneSpec]
# Faces at x = 3 and -1.5, y = 2 and -1.
ROOM = (
    block("front", 3.1, 0.0, (0.2, 10.0, 1.0)),
    block("back", -1.6, 0.0, (0.2, 10.0, 1.0)),
    block("left", 0.0, 2.1, (10.0, 0.2, 1.0)),
    block("right", 0.0, -1.1, (10.0, 0.2, 1.0)),
)


def scan_at(make_scene: MakeScene, robot: RobotSpec, x: float, y: float, yaw: float) -> Scan:
    start = pose_from_xyz_rpy((x, y, 0.0), (0.0, 0.0, yaw))
    with PhysicsWorld(make_scene(replace(robot, start=start), collisions=ROOM)) as world:
        return measure_scan(robot.sensors.lidars[0], world.state(), world.cast_rays)


def test_front_left_back_right(make_scene: MakeScene, robot: RobotSpec) -> None:
    ranges = scan_at(make_scene, robot, 0.0, 0.0, 0.0).ranges
    assert ranges[[0, 90, 180, 270]].tolist() == pytest.approx([3.0, 2.0, 1.5, 1.0], abs=1e-3)


def test_rays_between_the_axes_turn_counter_clockwise(make_scene: MakeScene, robot: RobotSpec) -> None:
    # 30 degrees to the left meets the front wall at y = 3 tan 30 = 1.73; to the right the right wall at 1 / sin 30.
    ranges = scan_at(make_scene, robot, 0.0, 0.0, 0.0).ranges
    assert ranges[30] == pytest.approx(3.0 / math.cos(math.radians(30)), abs=1e-3)
    assert ranges[330] == pytest.approx(1.0 / math.sin(math.radians(30)), abs=1e-3)


def test_scan_turns_with_the_robot(make_scene: MakeScene, robot: RobotSpec) -> None:
    # At (1, 0.5), facing left: the left wall is ahead, the back wall to the left.
    ranges = scan_at(make_scene, robot, 1.0, 0.5, math.pi / 2).ranges
    assert ranges[[0, 90, 180, 270]].tolist() == pytest.approx([1.5, 2.5, 1.5, 2.0], abs=1e-3)


def test_open_space_is_infinite(make_scene: MakeScene, robot: RobotSpec) -> None:
    with PhysicsWorld(make_scene(robot)) as world:
        assert set(measure_scan(robot.sensors.lidars[0], world.state(), world.cast_rays).ranges.tolist()) == {math.inf}


def test_wall_nearer_than_the_minimum_is_minus_infinity(make_scene: MakeScene, robot: RobotSpec) -> None:
    lidar = replace(robot.sensors.lidars[0], range_min=1.2)
    near = replace(robot, sensors=replace(robot.sensors, lidars=(lidar,)))
    ranges = scan_at(make_scene, near, 0.0, 0.0, 0.0).ranges
    assert ranges[270] == -math.inf
    assert ranges[180] == pytest.approx(1.5, abs=1e-3)
