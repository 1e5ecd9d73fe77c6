"""Puts a robot at many places of a scene and lets it come to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.traversability import RobotSize, floor_maps
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import with_robots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

SPARE = 0.02
"""Metres: the robot is put down with this much room beside it."""
_ABOVE = 0.003
_STEPS = 30
"""Of 1/240 s: it falls 3 mm in 0.025 s."""


def free_poses(scene: SceneSpec, robot: RobotSpec, count: int, seed: int) -> tuple[Pose, ...]:
    """Returns ``count`` random free poses in all, shared out among the floors of a scene."""
    rng = np.random.default_rng(seed)
    floors = floor_maps(scene, RobotSize(robot.radius, robot.height))
    parts = [len(part) for part in np.array_split(np.arange(count), len(floors))]
    return tuple(
        pose
        for floor, part in zip(floors, parts, strict=True)
        for pose in random_free_poses(floor, part, rng, clearance=robot.radius + SPARE)
    )


def what_goes_wrong(scene: SceneSpec, robot: RobotSpec, poses: Sequence[Pose]) -> list[str]:
    """Returns one line for each pose at which a robot does not rest within 1 cm of the floor or touches anything but the floor."""
    problems = []
    with PhysicsWorld(with_robots(scene, [replace(robot, start=poses[0])])) as world:
        for pose in poses:
            x, y, z = pose.position
            world.set_state(robot.name, replace(pose, position=(x, y, z + _ABOVE)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            world.step(_STEPS)
            away = world.base_pose(robot.name).position[2] - z
            # The floor lies below and pushes up.
            touched = {c.body_b for c in world.contacts(robot.name) if c.normal[2] < 0.9 or c.position[2] > z + 0.02}
            if abs(away) > 0.01:
                problems.append(f"({x:.2f}, {y:.2f}): {1000 * away:.0f} mm from the floor at {z:g} m")
            if touched:
                problems.append(f"({x:.2f}, {y:.2f}): touches {', '.join(sorted(touched))}")
    return problems
