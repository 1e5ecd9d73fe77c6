"""Converts the inertial frames that an engine moves (centre of mass, principal axes) to link frames, for many bodies at once. Pure arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, compiled
from gibson_sim.types import Quat

F64 = NDArray[np.float64]
_YZX, _ZXY = np.array([1, 2, 0]), np.array([2, 0, 1])
"""Orders of the axes in a cross product."""


def _rotation() -> F64:
    """Returns the coefficients, (3, 3, 16), of the products q_i q_j, row by row, in the rotation matrix of a unit quaternion q = (x, y, z, w)."""
    x, y, z, w = range(4)
    out = np.zeros((3, 3, 4, 4))
    for i, j, k in ((x, y, z), (y, z, x), (z, x, y)):
        out[i, i, [w, i, j, k], [w, i, j, k]] = 1.0, 1.0, -1.0, -1.0
        out[i, j, i, j], out[i, j, k, w] = 2.0, -2.0
        out[j, i, i, j], out[j, i, k, w] = 2.0, 2.0
    return out.reshape(3, 3, 16)


_ROTATION = _rotation()


@dataclass(frozen=True, slots=True, eq=False)
class FrameTable:
    """Poses of the links of some bodies relative to the inertial frames that the engine moves. G rigid groups, N links."""

    in_inertial: F64
    """(G, 3): origin of each group's frame in its inertial frame, metres."""
    group_rotations: F64
    """(G, 4, 4): matrices from a quaternion of the inertial frame to that of the group's frame."""
    rows: NDArray[np.intp]
    """(N,): index of the group of each link."""
    offsets: F64
    """(N, 3): origin of each link in its group's frame, metres."""
    link_rotations: F64
    """(N, 4, 4): matrices from a quaternion of the group's frame to that of the link."""
    _lever_arms: F64 = field(init=False)
    """(16, N, 3): coefficients of the products q_i q_j of an inertial frame's quaternion in the vector from its origin to the link's origin."""
    _rotations: F64 = field(init=False)
    """(4, N, 4): coefficients of the components of an inertial frame's quaternion in the link's quaternion."""

    def __post_init__(self) -> None:
        group_rotations = self.group_rotations[self.rows]
        arms = self.in_inertial[self.rows] + rotate(group_rotations[:, :, 3], self.offsets)
        object.__setattr__(self, "_lever_arms", np.ascontiguousarray(np.einsum("xyp,ny->pnx", _ROTATION, arms)))
        object.__setattr__(
            self, "_rotations", np.ascontiguousarray(np.matmul(self.link_rotations, group_rotations).transpose(2, 0, 1))
        )

    @staticmethod
    def joined(tables: Sequence[FrameTable]) -> FrameTable:
        """Concatenates tables of several bodies."""
        starts = np.cumsum([0, *(len(table.in_inertial) for table in tables)])
        return FrameTable(
            np.concatenate([np.zeros((0, 3)), *(table.in_inertial for table in tables)]),
            np.concatenate([np.zeros((0, 4, 4)), *(table.group_rotations for table in tables)]),
            np.concatenate([np.zeros(0, np.intp), *(table.rows + start for table, start in zip(tables, starts, strict=False))]),
            np.concatenate([np.zeros((0, 3)), *(table.offsets for table in tables)]),
            np.concatenate([np.zeros((0, 4, 4)), *(table.link_rotations for table in tables)]),
        )

    @property
    def root(self) -> FrameTable:
        """The table of the first group, without links."""
        return FrameTable(
            self.in_inertial[:1], self.group_rotations[:1], self.rows[:0], self.offsets[:0], self.link_rotations[:0]
        )

    def groups(self, raw: F64) -> tuple[F64, F64, F64, F64]:
        """Returns positions (G, 3), quaternions (G, 4), linear (G, 3) and angular (G, 3) velocities of the groups' frames.

        Args:
            raw: (G, 13) of the inertial frames, world frame: position, quaternion, linear and angular velocity.
        """
        spin = raw[:, 10:]
        to_frames = rotate(raw[:, 3:7], self.in_inertial)
        quats = np.matmul(self.group_rotations, raw[:, 3:7, None])[:, :, 0]
        return raw[:, :3] + to_frames, quats, raw[:, 7:10] + cross(spin, to_frames), spin

    def links(self, raw: F64, *, loops: bool = CAN_COMPILE) -> tuple[F64, F64, F64]:
        """Returns positions (N, 3), quaternions (N, 4) and twists (N, 6) of all links, world frame.

        Args:
            raw: See ``groups``.
            loops: Use compiled loops instead of NumPy; the results are bit-identical.
        """
        if loops:
            return _links(raw, self.rows, self._lever_arms, self._rotations)
        raw = raw.take(self.rows, 0)
        quats, spin = raw[:, 3:7], raw[:, 10:]
        products = (quats[:, :, None] * quats[:, None]).reshape(-1, 16)
        # Sums over the first axis add in the same order on every machine.
        arms = (self._lever_arms * products.T[:, :, None]).sum(axis=0)
        twists = np.concatenate([raw[:, 7:10] + cross(spin, arms), spin], axis=1)
        return raw[:, :3] + arms, (self._rotations * quats.T[:, :, None]).sum(axis=0), twists


@compiled
def _links(raw: F64, rows: NDArray[np.intp], arms: F64, rotations: F64) -> tuple[F64, F64, F64]:
    """Computes ``FrameTable.links``."""
    count = len(rows)
    positions, quats, twists = np.empty((count, 3)), np.empty((count, 4)), np.empty((count, 6))
    for i in range(count):
        row = raw[rows[i]]
        for k in range(4):
            total = rotations[0, i, k] * row[3]
            for j in range(1, 4):
                total += rotations[j, i, k] * row[3 + j]
            quats[i, k] = total
        x, y, z = _lever_arm(arms, i, 0, row), _lever_arm(arms, i, 1, row), _lever_arm(arms, i, 2, row)
        p, q, r = row[10], row[11], row[12]
        positions[i, 0], positions[i, 1], positions[i, 2] = row[0] + x, row[1] + y, row[2] + z
        twists[i, 0] = row[7] + (q * z - r * y)
        twists[i, 1] = row[8] + (r * x - p * z)
        twists[i, 2] = row[9] + (p * y - q * x)
        twists[i, 3], twists[i, 4], twists[i, 5] = p, q, r
    return positions, quats, twists


@compiled
def _lever_arm(arms: F64, link: int, axis: int, row: F64) -> float:
    """Returns one component of the vector from an inertial frame, a row of ``raw``, to the origin of a link."""
    total = arms[0, link, axis] * (row[3] * row[3])
    for k in range(1, 16):
        total += arms[k, link, axis] * (row[3 + k // 4] * row[3 + k % 4])
    return float(total)


def cross(a: F64, b: F64) -> F64:
    """Returns a x b, (N, 3); several times faster than ``np.cross`` for few rows."""
    return a.take(_YZX, 1) * b.take(_ZXY, 1) - a.take(_ZXY, 1) * b.take(_YZX, 1)


def rotate(quats_xyzw: F64, vectors: F64) -> F64:
    """Returns vectors, (N, 3), rotated by unit quaternions, (N, 4)."""
    axis, scalar = quats_xyzw[:, :3], quats_xyzw[:, 3:]
    return vectors + 2.0 * cross(axis, cross(axis, vectors) + scalar * vectors)


def right_multiplication(quat_xyzw: Quat) -> F64:
    """Returns the (4, 4) matrix M with ``M @ q`` = the quaternion product of q and ``quat_xyzw``."""
    x, y, z, w = quat_xyzw
    return np.array([[w, z, -y, x], [-z, w, x, y], [y, -x, w, z], [-x, -y, -z, w]])


def quat_product(a: Quat, b: Quat) -> Quat:
    """Returns the quaternion product a b."""
    x, y, z, w = (right_multiplication(b) @ np.array(a)).tolist()
    return (x, y, z, w)
