"""Maps drawn with characters, and a lidar on them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_examples.geometry import Pose2D
from gibson_examples.grid import Grid

CELLS = {"#": 100, ".": 0, "?": -1}


def grid_of(*rows: str, resolution: float = 0.1, origin: tuple[float, float] = (0.0, 0.0)) -> Grid:
    """Returns the map that lines of '#', '.' and '?' draw, the topmost line at the greatest y."""
    cells = np.array([[CELLS[c] for c in row] for row in reversed(rows)], dtype=np.int8)
    return Grid(resolution, origin, cells)


def empty_room(width: float, height: float, resolution: float = 0.05) -> Grid:
    """Returns a room with a wall of one cell about it, metres, its lower left corner at 0, 0."""
    cells = np.zeros((round(height / resolution), round(width / resolution)), dtype=np.int8)
    cells[0] = cells[-1] = 100
    cells[:, 0] = cells[:, -1] = 100
    return Grid(resolution, (0.0, 0.0), cells)


def ranges_at(grid: Grid, pose: Pose2D, beams: int = 90, step: float = 0.01) -> NDArray[np.float64]:
    """Returns what a lidar at a pose measures, (beams,), metres, to within ``step``: counter-clockwise from straight ahead."""
    angles = pose.yaw + np.arange(beams) * 2 * math.pi / beams
    along = np.arange(step, 8.0, step)
    points = np.array([pose.x, pose.y]) + along[None, :, None] * np.column_stack([np.cos(angles), np.sin(angles)])[:, None, :]
    hit = grid.values(grid.occupied, points, 0.0) > 0
    return np.where(hit.any(axis=1), along[hit.argmax(axis=1)], np.inf)
