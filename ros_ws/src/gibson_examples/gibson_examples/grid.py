"""The map as an array, with the content of ``nav_msgs/OccupancyGrid``. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_examples.errors import MapError
from gibson_examples.geometry import F64, I64, Bools

OCCUPIED_FROM = 65
"""Occupancy from which a cell is an obstacle, per cent."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """An occupancy grid: row 0 is at the lowest y, column 0 at the lowest x."""

    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """x, y of the lower left corner of cell [0, 0], map frame, metres."""
    occupancy: NDArray[np.int8]
    """(H, W), per cent, -1 = unknown."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise MapError(f"map: resolution is {self.resolution:g} m, must be a finite number above 0")
        if self.occupancy.ndim != 2 or not self.occupancy.size:
            raise MapError(f"map: its cells have shape {self.occupancy.shape}, must be (rows, columns) with at least one cell")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (along y), columns (along x)."""
        rows, columns = self.occupancy.shape
        return rows, columns

    @property
    def occupied(self) -> Bools:
        """(H, W): obstacles."""
        return np.asarray(self.occupancy >= OCCUPIED_FROM)

    @property
    def unknown(self) -> Bools:
        """(H, W): cells of unknown occupancy."""
        return np.asarray(self.occupancy < 0)

    def cells(self, xy: ArrayLike) -> I64:
        """Returns row and column, (..., 2), of points (..., 2) in the map frame; they may be outside the grid."""
        points = np.asarray(xy, dtype=np.float64)
        return np.floor((points - self.origin) / self.resolution).astype(np.int64)[..., ::-1]

    def centers(self, cells: ArrayLike) -> F64:
        """Returns x, y, (..., 2), map frame, of the centres of cells given as row, column, (..., 2)."""
        return np.asarray((np.asarray(cells, dtype=np.float64)[..., ::-1] + 0.5) * self.resolution + np.asarray(self.origin))

    def inside(self, cells: I64) -> Bools:
        """Returns (...), whether cells (..., 2) lie in the grid."""
        return np.asarray(((cells >= 0) & (cells < np.array(self.shape))).all(axis=-1))

    def values(self, array: NDArray[np.generic], xy: ArrayLike, outside: float) -> F64:
        """Returns the values of an array (H, W) at points (..., 2) in the map frame; ``outside`` where there is no cell."""
        cells = self.cells(xy)
        inside = self.inside(cells)
        safe = np.where(inside[..., None], cells, 0)
        return np.where(inside, array[safe[..., 0], safe[..., 1]], outside)


def distance_to(blocked: Bools, resolution: float) -> F64:
    """Returns (H, W): metres from the centre of a cell to the rim of the nearest blocked cell; 0 in blocked cells, inf if there are none.

    A blocked cell counts as a disc with half its edge as radius: an error of at most a fifth of the edge, at the corners.
    """
    if not blocked.any():
        return np.full(blocked.shape, np.inf)
    distance = ndimage.distance_transform_edt(~blocked) * resolution
    return np.asarray(np.maximum(distance - resolution / 2, 0.0))
