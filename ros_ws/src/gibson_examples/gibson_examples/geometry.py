"""Planar poses and transform matrices. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_examples.errors import SettingError

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
I64 = NDArray[np.int64]


def wrap_angle(angle: float) -> float:
    """Returns the same angle in [-pi, pi), radians."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angles(angles: ArrayLike) -> F64:
    """Returns the same angles in [-pi, pi), radians."""
    return np.asarray((np.asarray(angles, dtype=np.float64) + math.pi) % (2.0 * math.pi) - math.pi)


@dataclass(frozen=True, slots=True)
class Pose2D:
    """A planar pose; as a transform T_a_b it maps coordinates in b to coordinates in a."""

    x: float
    """Metres."""
    y: float
    """Metres."""
    yaw: float
    """Radians, counter-clockwise."""

    def __matmul__(self, other: Pose2D) -> Pose2D:
        """Returns T_a_c of this T_a_b and the other's T_b_c."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, wrap_angle(self.yaw + other.yaw))

    def inverse(self) -> Pose2D:
        """Returns T_b_a of this T_a_b."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2D(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw))

    def transform(self, points: ArrayLike) -> F64:
        """Returns points (N, 2), metres, given in b, in the coordinates of a."""
        p = np.asarray(points, dtype=np.float64)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.column_stack([self.x + c * p[:, 0] - s * p[:, 1], self.y + s * p[:, 0] + c * p[:, 1]])

    def distance(self, other: Pose2D) -> float:
        """Returns the distance between the origins, metres."""
        return math.hypot(self.x - other.x, self.y - other.y)


def parse_pose(text: str, what: str) -> Pose2D:
    """Parses ``x,y`` or ``x,y,yaw_deg`` (metres, degrees).

    Raises:
        SettingError: ``text`` is neither.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
        raise SettingError(f"{what} is {text!r}, must be x,y or x,y,yaw_deg in metres and degrees, such as 1.5,-2,90")
    return Pose2D(numbers[0], numbers[1], math.radians(numbers[2]) if len(numbers) == 3 else 0.0)


def format_pose(pose: Pose2D) -> str:
    """Returns ``x,y,yaw_deg`` as ``parse_pose`` reads it."""
    return f"{pose.x:.2f},{pose.y:.2f},{math.degrees(pose.yaw):.0f}"


def matrix_from(translation: ArrayLike, quat_xyzw: ArrayLike) -> F64:
    """Returns the (4, 4) matrix of a translation (3,), metres, and a unit quaternion (4,)."""
    x, y, z, w = (float(v) for v in np.asarray(quat_xyzw, dtype=np.float64))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = np.asarray(translation, dtype=np.float64)
    return matrix


def invert(matrix: F64) -> F64:
    """Returns the inverse of a rigid transform (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse


def planar(matrix: F64) -> Pose2D:
    """Returns the planar part of a transform (4, 4): x, y, and the direction of its x axis as yaw."""
    return Pose2D(float(matrix[0, 3]), float(matrix[1, 3]), math.atan2(matrix[1, 0], matrix[0, 0]))
