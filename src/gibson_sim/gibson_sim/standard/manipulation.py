"""Converts the gripper and servo settings of the physics node for ``PhysicsWorld``."""

from __future__ import annotations

import math
from typing import cast

from gibson_sim.config import PhysicsConfig
from gibson_sim.robots.joints.grasping import GraspMode, GraspSettings
from gibson_sim.robots.joints.servo import ServoSettings


def grasp_settings(config: PhysicsConfig) -> GraspSettings:
    """Returns the grasp settings of all grippers; distance in m, forces in N, angle converted to rad."""
    return GraspSettings(
        cast(GraspMode, config.grasp_mode),  # ``PhysicsConfig`` has checked it
        config.grasp_distance,
        config.grasp_force,
        config.grasp_release_force,
        math.radians(config.grasp_release_angle_deg),
    )


def servo_settings(config: PhysicsConfig) -> ServoSettings:
    """Returns the settings of the Cartesian servo."""
    return ServoSettings(config.servo_max_linear, config.servo_max_angular, config.servo_timeout)
