"""Length of the shortest path to a goal from any point of the floor. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.tasks.ground import Ground

F64 = NDArray[np.float64]
_AHEAD = 0.5
"""Distance at which the direction of the shortest path is determined, metres."""
_DIRECTIONS = 64


class DrivingDistance:
    """Length of the shortest path around static obstacles to one goal, as a function of the robot's position; movable objects are ignored.

    The function is continuous: it is interpolated between centres of cells, and at positions without a path (too close to an obstacle) it is
    the distance to the nearest position with a path plus the length of that path. Its decrease is therefore suitable as the reward of a step.

    Args:
        ground: the floor and the robot.
        goal: x, y, world frame, metres.

    Raises:
        SceneError: the goal is not reachable.
    """

    def __init__(self, ground: Ground, goal: tuple[float, float]) -> None:
        self._floor = ground.floor
        lengths = ground.space.planner.distances(goal)
        reachable = np.isfinite(lengths)
        gap, nearest = ndimage.distance_transform_edt(~reachable, sampling=ground.floor.resolution, return_indices=True)
        self._lengths: F64 = lengths[tuple(nearest)] + gap

    def __call__(self, xy: tuple[float, float]) -> float:
        """Returns the distance from a position, world frame, metres."""
        floor = self._floor
        column, row = (np.asarray(xy, dtype=np.float64) - floor.origin) / floor.resolution - 0.5
        return float(ndimage.map_coordinates(self._lengths, [[row], [column]], order=1, mode="nearest")[0])

    def direction(self, xy: tuple[float, float]) -> tuple[float, float]:
        """Returns the direction of the shortest path at a position: unit vector, world frame; close to the goal, the direction to it."""
        ahead = min(_AHEAD, max(self(xy), self._floor.resolution))
        angles = np.arange(_DIRECTIONS) * (2.0 * math.pi / _DIRECTIONS)
        ring = np.stack([np.cos(angles), np.sin(angles)])
        points = np.asarray(xy, dtype=np.float64)[:, None] + ahead * ring
        columns, rows = (points - np.asarray(self._floor.origin)[:, None]) / self._floor.resolution - 0.5
        best = int(np.argmin(ndimage.map_coordinates(self._lengths, [rows, columns], order=1, mode="nearest")))
        return float(ring[0, best]), float(ring[1, best])
