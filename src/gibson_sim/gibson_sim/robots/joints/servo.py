"""Cartesian servo: from a velocity of the tool to velocities of the joints. Pure arithmetic.

``PhysicsWorld.arms.servo`` applies it, and ``docs/manipulation.md`` explains it.
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
"""Fraction of the greatest singular value below which a direction counts as impossible."""


@dataclass(frozen=True, slots=True)
class ToolTwist:
    """A commanded velocity of an arm's tool relative to the robot's base."""

    linear: Vec3
    """Velocity of the tool's origin, m/s."""
    angular: Vec3
    """rad/s."""
    frame: str = ""
    """Link of the robot along whose axes they are; empty = its base."""

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
    """m/s; a faster twist is slowed down as a whole, so that its direction stays."""
    max_angular: float = 1.5
    """rad/s; the same."""
    timeout: float = 0.25
    """Seconds of simulation time after which a command is stale and the arm stops."""
    damping: float = 0.05
    """Maximum damping, at a singularity; metres and radians."""
    singular: float = 0.08
    """Singular value of the Jacobian below which damping begins."""
    homing: float = 0.5
    """Fraction of the way to the home pose that joints move per second, as far as the tool leaves them free."""

    def __post_init__(self) -> None:
        for name in ("max_linear", "max_angular", "timeout", "damping", "singular"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(f"servo {name} is {value}, must be a finite number above 0")
        if not (math.isfinite(self.homing) and self.homing >= 0.0):
            raise ConfigError(f"servo homing is {self.homing}, must be a finite number, 0 or more")


def limited_twist(twist: F64, settings: ServoSettings) -> F64:
    """Returns a twist, (6,), linear then angular, slowed down to the limits; its direction stays."""
    factor = max(
        float(np.linalg.norm(twist[:3])) / settings.max_linear, float(np.linalg.norm(twist[3:])) / settings.max_angular, 1.0
    )
    return np.asarray(twist / factor)


def servo_speeds(
    jacobian: F64, twist: F64, positions: F64, home: F64, lower: F64, upper: F64, fastest: F64, dt: float, settings: ServoSettings
) -> F64:
    """Returns the velocities of the joints, (J,), that move the tool by a twist, as far as they can.

    Near a singularity they are damped. A joint at its limit is left out, and the others make up for it if they can. Joints that the task leaves
    free move towards the home pose. All are slowed down together if one would be too fast.

    Args:
        jacobian: (6, J), from joint velocities to the twist of the tool.
        twist: (6,), linear m/s, angular rad/s, in the axes of the Jacobian.
        positions: (J,), radians or metres.
        home: (J,), the pose towards which free joints move; NaN = none.
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
    """Returns the velocities of the free joints; ``homing`` is projected to motions that do not move the tool."""
    u, sizes, rows = np.linalg.svd(jacobian, full_matrices=True)
    count = len(sizes)
    least = np.minimum(sizes / settings.singular, 1.0)
    damping = settings.damping**2 * (1.0 - least**2)
    gains = np.where(sizes > _RANK * max(float(sizes[0]), _RANK), sizes / (sizes**2 + damping + _RANK**2), 0.0)
    task = rows[:count].T @ (gains * (u[:, :count].T @ twist))
    rank = int((sizes > _RANK * max(float(sizes[0]), _RANK)).sum())
    rest = rows[rank:]
    return np.asarray(task + rest.T @ (rest @ homing))
