"""Which moments of two recordings have nearly the same pose. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.bags.comparison.recording import F64

FARTHEST, FARTHEST_TURN = 0.15, np.radians(6.0)
"""Metres and radians: poses farther apart do not match."""


def from_start(poses: F64, start: F64) -> F64:
    """Returns poses (N, 3), x, y, yaw, in the frame of the pose ``start``, (3,)."""
    dx, dy = poses[:, 0] - start[0], poses[:, 1] - start[1]
    cos, sin = np.cos(start[2]), np.sin(start[2])
    return np.stack([dx * cos + dy * sin, dy * cos - dx * sin, poses[:, 2] - start[2]], axis=1)


def matches(a: F64, b: F64, farthest: float = FARTHEST, farthest_turn: float = FARTHEST_TURN) -> NDArray[np.intp]:
    """Returns (K, 2): rows of ``a`` with the nearest row of ``b``, no row of ``b`` twice, in the order of ``a``.

    Args:
        a: (N, 3), x, y (m), yaw (rad); rows with NaN match nothing.
        b: (M, 3), in the same frame.
        farthest: Metres.
        farthest_turn: Radians.
    """
    rows_a, rows_b = (np.flatnonzero(np.isfinite(poses).all(axis=1)) for poses in (a, b))
    if not len(rows_a) or not len(rows_b):
        return np.zeros((0, 2), dtype=np.intp)
    # A turn of farthest_turn counts as much as a way of farthest.
    lever = farthest / (2 * np.sin(farthest_turn / 2))
    points = [
        np.stack([p[:, 0], p[:, 1], lever * np.cos(p[:, 2]), lever * np.sin(p[:, 2])], axis=1) for p in (a[rows_a], b[rows_b])
    ]
    distance, nearest = cKDTree(points[1]).query(points[0], distance_upper_bound=1.5 * farthest)
    pairs, used = [], set()
    for i in np.argsort(distance, kind="stable"):
        if np.isfinite(distance[i]) and nearest[i] not in used:
            used.add(nearest[i])
            pairs.append((rows_a[i], rows_b[nearest[i]]))
    return np.array(sorted(pairs), dtype=np.intp).reshape(-1, 2)
