"""Rigid transforms as (4, 4) matrices, poses and unit quaternions ``(x, y, z, w)``.

``T_a_b`` takes homogeneous column vectors in frame b to frame a. Roll, pitch and yaw are those of URDF and SDF: rotations about the fixed
axes x, y, z in that order, ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.types import Pose, Quat, Vec3

Mat3 = NDArray[np.float64]
Mat4 = NDArray[np.float64]

UpAxis = Literal["x", "y", "z"]
TO_Z_UP: dict[UpAxis, Mat3] = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
}
"""Up axis of the file -> R_zup_file, (3, 3) (COLLADA 1.4.1, up_axis); exact, without rounding."""
R_LINK_OPTICAL: Mat3 = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""R_link_optical: from optical axes (x right, y down, z forward) to those of a link with x forward, y left, z up (REP 103)."""


def quat_from_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Returns the unit quaternion (x, y, z, w) of ``Rz(yaw) Ry(pitch) Rx(roll)``, angles in radians."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def yaw_from_quat(quat_xyzw: ArrayLike) -> float:
    """Returns the yaw of a unit quaternion (x, y, z, w), the heading of its x axis in the x-y plane, radians in (-pi, pi]."""
    x, y, z, w = (float(c) for c in np.asarray(quat_xyzw, dtype=np.float64))
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def matrix_from_quat(quat_xyzw: ArrayLike) -> NDArray[np.float64]:
    """Returns rotation matrices, shape (..., 3, 3), of unit quaternions, shape (..., 4)."""
    q = np.asarray(quat_xyzw, dtype=np.float64)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty((*q.shape[:-1], 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    return out


def camera_pose(eye: Vec3, look_at: Vec3) -> Pose:
    """Returns T_world_optical of a camera without roll that looks at a point; straight up or down, the image's x axis is the world's.

    Args:
        eye: position of the camera, world metres.
        look_at: point at the centre of the image, world metres.

    Raises:
        ConfigError: the points coincide, or are not finite.
    """
    forward = np.subtract(look_at, eye).astype(np.float64)
    if not (np.isfinite(forward).all() and np.linalg.norm(forward) > 1e-9):
        raise ConfigError(f"camera at {eye} looks at {look_at}: must be another point, with finite coordinates")
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward):
        forward, right = np.array([0.0, 0.0, np.sign(forward[2])]), np.array([1.0, 0.0, 0.0])
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return Pose(eye, quat_from_matrix(np.stack([right, np.cross(forward, right), forward], axis=1)))


def rotated(quat_xyzw: Quat, vector: Vec3) -> Vec3:
    """Rotates a vector by a unit quaternion, in plain floats, which for one vector takes a tenth of the time of arrays."""
    x, y, z, w = quat_xyzw
    a, b, c = vector
    u, v, t = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * u + y * t - z * v, b + w * v + z * u - x * t, c + w * t + x * v - y * u


def quat_from_matrix(rotation: ArrayLike) -> Quat:
    """Returns the unit quaternion (x, y, z, w), w >= 0, of a rotation matrix, shape (3, 3) (Shepperd's method)."""
    r = np.asarray(rotation, dtype=np.float64)
    trace = float(np.trace(r))
    candidates = np.array([r[0, 0], r[1, 1], r[2, 2], trace])
    best = int(np.argmax(candidates))
    q = np.empty(4)
    if best == 3:
        q[:] = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1.0 + trace)
    else:
        i, j, k = best, (best + 1) % 3, (best + 2) % 3
        q[i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        q[j] = r[j, i] + r[i, j]
        q[k] = r[k, i] + r[i, k]
        q[3] = r[k, j] - r[j, k]
    q /= np.linalg.norm(q)
    if q[3] < 0:
        q = -q
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3]))


def pose_from_xyz_rpy(xyz: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0)) -> Pose:
    """Returns the pose at ``xyz`` (metres) rotated by roll, pitch, yaw (radians)."""
    return Pose((float(xyz[0]), float(xyz[1]), float(xyz[2])), quat_from_rpy(*rpy))


def matrix_from_pose(pose: Pose) -> Mat4:
    """Returns T_parent_child, shape (4, 4), of a pose in its parent frame."""
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quat(pose.quat_xyzw)
    matrix[:3, 3] = pose.position
    return matrix


def pose_from_matrix(matrix: ArrayLike) -> Pose:
    """Returns the pose of a rigid T_parent_child, shape (4, 4)."""
    m = np.asarray(matrix, dtype=np.float64)
    return Pose((float(m[0, 3]), float(m[1, 3]), float(m[2, 3])), quat_from_matrix(m[:3, :3]))


def matrices_from_poses(positions: ArrayLike, quats_xyzw: ArrayLike) -> NDArray[np.float64]:
    """Returns T_parent_child, shape (N, 4, 4), of positions (N, 3) and unit quaternions (N, 4)."""
    p = np.asarray(positions, dtype=np.float64)
    out = np.zeros((len(p), 4, 4))
    out[:, :3, :3] = matrix_from_quat(quats_xyzw)
    out[:, :3, 3] = p
    out[:, 3, 3] = 1.0
    return out


def invert(matrix: ArrayLike) -> Mat4:
    """Returns T_b_a of a rigid T_a_b, shape (4, 4)."""
    m = np.asarray(matrix, dtype=np.float64)
    out = np.eye(4)
    out[:3, :3] = m[:3, :3].T
    out[:3, 3] = -m[:3, :3].T @ m[:3, 3]
    return out


def transform_points(matrix: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Transforms points (N, 3) from frame b to frame a by T_a_b (4, 4), which may scale."""
    m = np.asarray(matrix, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ m[:3, :3].T + m[:3, 3]


def wrap_angle(angle: float) -> float:
    """Returns the angle in (-pi, pi], radians."""
    wrapped = math.remainder(angle, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped
