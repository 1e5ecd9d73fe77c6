"""What the settings of the physics node say of arms, as the world takes it."""

from __future__ import annotations

import math
from typing import cast

from gibson_sim.config import PhysicsConfig
from gibson_sim.robots.joints.grasping import GraspMode, GraspSettings
from gibson_sim.robots.joints.servo import ServoSettings


def grasp_settings(config: PhysicsConfig) -> GraspSettings:
    """Returns how grippers hold."""
    return GraspSettings(
        # The settings allow these three alone.
        cast(GraspMode, config.grasp_mode),
        config.grasp_distance,
        config.grasp_force,
        config.grasp_release_force,
        math.radians(config.grasp_release_angle_deg),
    )


def servo_settings(config: PhysicsConfig) -> ServoSettings:
    """Returns how tools move at a velocity."""
    return ServoSettings(config.servo_max_linear, config.servo_max_angular, config.servo_timeout)
