"""How a robot drives: pure values."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gibson_sim.errors import ConfigError


@dataclass(frozen=True, slots=True)
class DriveSpec:
    """A differential drive: two wheels on one axle, driven by velocity."""

    left_joint: str
    right_joint: str
    wheel_radius: float
    """Metres."""
    wheel_separation: float
    """Metres between the contact points of the wheels."""
    max_linear: float = 0.5
    """m/s."""
    max_angular: float = 2.0
    """rad/s."""
    max_linear_acceleration: float = 1.0
    """m/s^2, speeding up and slowing down."""
    max_angular_acceleration: float = 4.0
    """rad/s^2."""
    max_wheel_torque: float = 10.0
    """N m."""
    left_sign: float = 1.0
    """+1 when a positive turn of the left joint rolls the robot forward, -1 when its axis points the other way."""
    right_sign: float = 1.0

    def __post_init__(self) -> None:
        for name in (
            "wheel_radius", "wheel_separation", "max_linear", "max_angular",
            "max_linear_acceleration", "max_angular_acceleration", "max_wheel_torque",
        ):  # fmt: skip
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ConfigError(f"drive: {name} is {value!r}, must be a finite number above 0")
