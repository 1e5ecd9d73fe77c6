"""Slip in the engine: the true motion falls behind odometry by the slip in the robot's file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.drive_spec import DifferentialSpec
from gibson_sim.scenes.spec import SceneSpec

Drive = Callable[[PhysicsWorld, float, float, float], None]


@pytest.fixture
def slipping(flat: SceneSpec) -> SceneSpec:
    (robot,) = flat.robots
    assert isinstance(robot.drive, DifferentialSpec)
    return replace(flat, robots=(replace(robot, drive=replace(robot.drive, slip=0.1, turn_slip=0.2)),))


def test_truth_is_shorter_than_odometry_by_the_slip(slipping: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(slipping) as world:
        drive(world, 0.4, 0.0, 3.0)
        drive(world, 0.0, 0.0, 1.0)
        wheels, truth = world.odometry("robot").x, world.base_pose("robot").position[0]
    assert wheels == pytest.approx(1.2, rel=0.02)
    assert truth / wheels == pytest.approx(0.9, abs=0.005)


def test_truth_turns_less_than_odometry_by_the_turn_slip(slipping: SceneSpec, drive: Drive) -> None:
    with PhysicsWorld(slipping) as world:
        drive(world, 0.0, 1.0, 2.0)
        drive(world, 0.0, 0.0, 1.0)
        wheels, truth = world.odometry("robot").yaw, yaw_from_quat(world.base_pose("robot").quat_xyzw)
    assert wheels == pytest.approx(2.0, rel=0.02)
    assert truth / wheels == pytest.approx(0.8, abs=0.02)
