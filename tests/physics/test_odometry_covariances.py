"""Covariances of odometry against the true errors in the engine, for robots whose files give no errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import VelocityCommand
from support.odometry import nees

RUNS = 6
HIGHEST = 37.16 / RUNS
"""Bound of the mean normalised error squared (three dimensions) of six runs, 99.5 %: chi-square with 18 degrees of freedom."""


def _drive(world: PhysicsWorld, seed: int) -> tuple[float, float]:
    """Returns the normalised error squared of the pose after half a minute of arcs, and the mean of that of the twist."""
    rng = np.random.default_rng(seed)
    world.step(60)
    twists = []
    for _ in range(12):
        linear, angular, seconds = rng.uniform(-0.15, 0.4), rng.uniform(-0.7, 0.7), rng.uniform(1.0, 4.0)
        for _ in range(round(seconds * 20)):
            world.command("robot", VelocityCommand((linear, 0.0, 0.0), (0.0, 0.0, angular), world.stamp_ns))
            world.step(12)
        odometry, (true_linear, true_angular) = world.odometry("robot"), world.base_twist("robot")
        error = odometry.linear - true_linear[0], odometry.lateral - true_linear[1], odometry.angular - true_angular[2]
        twists.append(nees(np.array(error), world.odometry_covariance("robot").twist))
    pose = world.base_pose("robot")
    turned = math.remainder(odometry.yaw - yaw_from_quat(pose.quat_xyzw), 2 * math.pi)
    error = odometry.x - pose.position[0], odometry.y - pose.position[1], turned
    return nees(np.array(error), world.odometry_covariance("robot").pose), float(np.mean(twists))


@pytest.mark.parametrize("name", ["gibson_bot", "ackermann_bot", "husky"])
def test_no_robot_has_overconfident_odometry_covariance(root: Path, make_scene: Callable[..., SceneSpec], name: str) -> None:
    scene = make_scene(load_robot(root / "config/robots" / name))
    found = []
    for seed in range(RUNS):
        with PhysicsWorld(scene) as world:
            found.append(_drive(world, seed))
    pose, twist = np.mean(found, axis=0)
    assert pose < HIGHEST, found
    assert twist < HIGHEST, found
