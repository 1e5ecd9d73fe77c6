"""Cartesian servo: computes joint velocities from a tool velocity. Pure arithmetic.

``PhysicsWorld.arms.servo`` applies it, and ``docs/manipulation.md`` describes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
_RANK = 1e-6
"""Fraction of the largest singular value below which a direction counts as impossible."""


@dataclass(frozen=True, slots=True)
class ToolTwist:
    """A commanded velocity of an arm's tool relative to the robot's base."""

    linear: Vec3
    """Velocity of the tool's origin, m/s."""
    angular: Vec3
    """Angular velocity, rad/s."""
    frame: str = ""
    """Link of the robot in whose axes the velocities are given; empty = the base."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.linear, *self.angular))):
            raise CommandError(
                f"tool velocity linear={self.linear} angular={self.angular} holds a NaN or an infinity; it is ignored, "
                "send finite m/s and rad/s"
            )


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """Limits and damping of a servo."""

    max_linear: float = 0.5
    """Maximum linear speed, m/s; a faster twist is scaled down as a whole, with the same direction."""
    max_angular: float = 1.5
    """Maximum angular speed, rad/s; a faster twist is scaled down as a whole."""
    timeout: float = 0.25
    """Command timeout after which the arm stops, seconds of simulation time."""
    damping: float = 0.05
    """Maximum damping, at a singularity, in metres and radians."""
    singular: float = 0.08
    """Singular value of the Jacobian below which damping begins."""
    homing: float = 0.5
    """Fraction of the distance to the home pose that joints move per second, in the null space of the task."""

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "timeout", "damping", "singular"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"servo {name} is {value}, must be a finite number above 0")
        if not (math.isfinite(self.homing) and self.homing >= 0.0):
            raise ConfigError(f"servo homing is {self.homing}, must be a finite number, 0 or more")


def limited_twist(twist: F64, settings: ServoSettings) -> F64:
    """Returns a twist, (6,), linear then angular, scaled down to the limits, with the same direction."""
    factor = max(
        float(np.linalg.norm(twist[:3])) / settings.max_linear, float(np.linalg.norm(twist[3:])) / settings.max_angular, 1.0
    )
    return np.asarray(twist / factor)


def servo_speeds(
    jacobian: F64, twist: F64, positions: F64, home: F64, lower: F64, upper: F64, fastest: F64, dt: float, settings: ServoSettings
) -> F64:
    """Returns the joint velocities, (J,), that move the tool with a twist, as far as possible.

    They are damped near a singularity. A joint at its limit is excluded, and the other joints compensate if possible. In the null space of the task,
    joints move towards the home pose. All velocities are scaled down together if one exceeds its limit.

    Args:
        jacobian: (6, J), maps joint velocities to the twist of the tool.
        twist: (6,), linear m/s, angular rad/s, in the axes of the Jacobian.
        positions: (J,), joint positions, radians or metres.
        home: (J,), home pose; NaN = none.
        lower: (J,), lower position limits; -inf = none.
        upper: (J,), upper position limits; inf = none.
        fastest: (J,), velocity limits; inf = none.
        dt: Length of the step, seconds.
        settings: Damping and homing.
    """
    free = np.ones(len(positions), dtype=bool)
    speeds = np.zeros(len(positions))
    homing = np.where(np.isnan(home), 0.0, settings.homing * (home - positions))
    for _ in range(len(positions)):
        speeds = np.zeros(len(positions))
        speeds[free] = _least_squares(jacobian[:, free], twist, homing[free], settings)
        speeds = speeds / max(float((np.abs(speeds) / fastest).max()), 1.0)
        after = positions + speeds * dt
        stopped = free & (((after > upper) & (speeds > 0.0)) | ((after < lower) & (speeds < 0.0)))
        if not stopped.any():
            return speeds
        free &= ~stopped
        if not free.any():
            break
    return np.zeros(len(positions))


def _least_squares(jacobian: F64, twist: F64, homing: F64, settings: ServoSettings) -> F64:
    """Returns the velocities of the free joints; ``homing`` is projected onto the null space of the task."""
    u, sizes, rows = np.linalg.svd(jacobian, full_matrices=True)
    count = len(sizes)
    least = np.minimum(sizes / settings.singular, 1.0)
    damping = settings.damping**2 * (1.0 - least**2)
    gains = np.where(sizes > _RANK * max(float(sizes[0]), _RANK), sizes / (sizes**2 + damping + _RANK**2), 0.0)
    task = rows[:count].T @ (gains * (u[:, :count].T @ twist))
    rank = int((sizes > _RANK * max(float(sizes[0]), _RANK)).sum())
    rest = rows[rank:]
    return np.asarray(task + rest.T @ (rest @ homing))
