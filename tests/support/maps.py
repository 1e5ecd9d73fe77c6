"""Maps, scans and fixed transforms as a client sees them, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.types import Pose


def cells_of(grid: Any) -> NDArray[np.int8]:
    """Returns the values of an OccupancyGrid, (H, W), row 0 at the lowest y."""
    return np.array(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)


def rows_columns(grid: Any, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns rows and columns, (N, 2), of points (N, 2), metres, map frame."""
    origin = np.array([grid.info.origin.position.x, grid.info.origin.position.y])
    return np.floor((points - origin) / grid.info.resolution).astype(np.int64)[:, ::-1]


def cells_to_occupied(grid: Any, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Returns how many cells, along the axes, points (N, 2) of the map frame are from the nearest occupied one, (N,)."""
    occupied = np.argwhere(cells_of(grid) > 50)
    away: NDArray[np.int64] = np.abs(rows_columns(grid, points)[:, None, :] - occupied[None]).max(axis=-1).min(axis=1)
    return away


def hits_of(scan: Any) -> NDArray[np.float64]:
    """Returns where the rays of a LaserScan met something, (N, 4), metres and a 1, in the scan's frame."""
    ranges = np.array(scan.ranges)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * ranges, 1 + 0 * ranges], axis=-1)
    return points[np.isfinite(ranges)]


def fixed_transform(static: Any, parent: str, child: str) -> NDArray[np.float64]:
    """Returns T_parent_child, (4, 4), along the fixed transforms of a TFMessage."""
    by_child = {t.child_frame_id: t for t in static.transforms}
    T = np.eye(4)
    while child != parent:
        p, q = by_child[child].transform.translation, by_child[child].transform.rotation
        T = matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))) @ T
        child = by_child[child].header.frame_id
    return T
