"""Checks where robots and objects start: on a floor, and inside the building."""

from __future__ import annotations

import logging

import numpy as np

from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.types import Pose

_log = logging.getLogger(__name__)
_RAY_START_HEIGHT = 0.1
"""Height above a spawned entity's origin at which the ray that searches for a floor starts, m: the origin may lie slightly below the floor."""
_RAY_LENGTH = 1000.0
"""Length of the ray that searches for a floor, m."""


def warn_of_misplaced_robots(world: PhysicsWorld) -> None:
    """Logs a warning for each robot whose start has no floor, or is outside the building."""
    for robot in world.scene.robots:
        if misplaced := _misplacement(world, robot):
            x, y, _ = robot.start.position
            hint = "`gibson-sim scene inspect` shows the floors of a scene and the names of its start poses"
            _log.warning("%s starts at %.2f,%.2f, %s; %s", robot.name, x, y, misplaced, hint)


def _misplacement(world: PhysicsWorld, robot: RobotSpec) -> str:
    """Returns what is wrong with a robot's start: it would fall, or is outside a building on infinite ground; empty = nothing."""
    if has_nothing_below(world, robot.start, robot.name):
        return "where there is nothing below it: it falls"
    bounds = world.static_bounds()
    if bounds is None or not world.scene.starts:  # without start poses, open ground may be all there is
        return ""
    (low_x, low_y, _), (high_x, high_y, _) = bounds
    x, y, _ = robot.start.position
    if low_x <= x <= high_x and low_y <= y <= high_y:
        return ""
    return f"outside the scene, which is from x {low_x:.1f} to {high_x:.1f} and y {low_y:.1f} to {high_y:.1f} m"


def has_nothing_below(world: PhysicsWorld, pose: Pose, robot: str | None = None) -> bool:
    """Returns whether a downward ray from a pose hits neither floor nor object; it ignores ``robot``."""
    x, y, z = pose.position
    ranges = world.cast_rays([(x, y, z + _RAY_START_HEIGHT)], [(0.0, 0.0, -1.0)], _RAY_LENGTH, robot)
    return bool(np.isinf(ranges[0]))
