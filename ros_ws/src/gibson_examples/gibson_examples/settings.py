"""Settings of the navigation node, each with its unit. Independent of ROS: the node declares a parameter for every field."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gibson_examples.errors import SettingError


@dataclass(frozen=True, slots=True)
class NavigationSettings:
    """Parameters of the navigation node."""

    goal: str = ""
    """Goal: x,y or x,y,yaw_deg in the map frame, metres and degrees; empty = wait for ``goal_pose``."""
    initial_pose: str = ""
    """Initial pose: x,y,yaw_deg in the map frame, metres and degrees; empty = wait for ``initialpose``."""
    initial_sigma_xy: float = 0.15
    """Standard deviation of the initial position, metres."""
    initial_sigma_yaw_deg: float = 8.0
    """Standard deviation of the initial yaw, degrees."""
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str = "base_footprint"
    stamped: bool = False
    """Send TwistStamped instead of Twist."""
    exit_at_goal: bool = False
    """End when the goal is reached (exit code 0) or failed (1)."""
    control_hz: float = 20.0
    """Commands per second of the robot's time."""
    robot_radius: float = 0.18
    """Metres."""
    max_linear: float = 0.45
    """m/s."""
    max_angular: float = 1.2
    """rad/s."""
    particles: int = 500
    seed: int = 0
    """Seed of the particles."""
    transform_tolerance: float = 0.2
    """Offset of the stamp of map -> odom after its scan, seconds: other nodes need not wait for the next scan."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, default = getattr(self, field.name), field.default
            allowed = (int, float) if isinstance(default, float) else type(default)
            if not isinstance(value, allowed) or (isinstance(value, bool) and not isinstance(default, bool)):
                raise SettingError(
                    f"parameter {field.name} is {value!r}, must be of type {type(default).__name__}, such as {default or '1.5,-2,90'!r}"
                )
        for name in ("initial_sigma_xy", "initial_sigma_yaw_deg", "transform_tolerance"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise SettingError(f"parameter {name} is {getattr(self, name):g}, must be a finite number, 0 or more")
        if not 1.0 <= self.control_hz <= 100.0:
            raise SettingError(f"parameter control_hz is {self.control_hz:g}, must be 1 to 100")
        if self.seed < 0:
            raise SettingError(f"parameter seed is {self.seed}, must be 0 or more")
