"""Checks poses and velocities from clients, which are untrusted."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.types import FARTHEST_M, Pose, Quat, Vec3

MAX_SPEED = 1e3
"""Maximum magnitude of each component of a velocity, m/s and rad/s."""
NORM_TOLERANCE = 0.01
"""Maximum deviation of a quaternion's norm from 1: clients round to two digits."""
WORLD_FRAMES = ("", "world", "map")
"""Names of the world frame in requests."""


def checked_pose(position: Vec3, quat_xyzw: Quat, code: IntEnum) -> Pose:
    """Returns the pose with a normalised quaternion; four zeros, the default of some clients' messages, mean no rotation.

    Args:
        position: x, y, z, m.
        quat_xyzw: orientation.
        code: result code of an invalid pose.

    Raises:
        SimulationError: with ``code``.
    """
    if not all(map(math.isfinite, (*position, *quat_xyzw))):
        raise SimulationError(code, f"the pose holds a NaN or an infinity: position {position}, orientation {quat_xyzw}")
    if any(abs(c) > FARTHEST_M for c in position):
        raise SimulationError(
            code, f"position {position} is too far away; each coordinate must be -{FARTHEST_M:g} to {FARTHEST_M:g} m"
        )
    norm = math.hypot(*quat_xyzw)
    if norm == 0.0:
        return Pose(position)
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise SimulationError(code, f"orientation {quat_xyzw} (x, y, z, w) has length {norm:g}, must be 1: normalise it")
    x, y, z, w = (c / norm for c in quat_xyzw)
    return Pose(position, (x, y, z, w))


def checked_velocity(kind: str, velocity: Vec3, unit: str) -> Vec3:
    """Returns the velocity if it is valid, or raises SimulationError(OPERATION_FAILED); ``kind`` and ``unit`` are for the message."""
    if not all(math.isfinite(c) and abs(c) <= MAX_SPEED for c in velocity):
        raise SimulationError(
            Result.OPERATION_FAILED,
            f"{kind} velocity is {velocity}, each component must be -{MAX_SPEED:g} to {MAX_SPEED:g} {unit}",
        )
    return velocity


def vec3(values: ArrayLike) -> Vec3:
    """Returns an array (3,) as a tuple of floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z)
