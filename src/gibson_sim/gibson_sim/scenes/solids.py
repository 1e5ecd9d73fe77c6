"""Where a floor is inside of something: beneath a wardrobe that stands on it nothing is in the way, and yet no robot can be there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.triangles import unit_normals
from gibson_sim.scenes.rasterise import Grid

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_LEVEL = 0.9
"""Undersides and floors face down and up to within this cosine."""
_STEEP = 0.05
"""What is steeper than the angle of this cosine neither covers nor bears anything."""
_MOST_COVERED = 0.9
"""Part of a floor that things stand on; where more faces down, the faces themselves are wrong."""
_TIE = 0.002
"""Metres: an underside that lies no lower below a floor than this stands on it."""


def inside_solids(corners: F64, grid: Grid, floor_z: float, low: float, high: float, *, ground_plane: bool = False) -> Bools:
    """Returns (H, W): cells whose centre has an underside at the height of the floor, and above it first the top of something.

    A room has its ceiling above it, which faces down, and a table's underside lies higher. Meshes whose faces are turned, or doubled,
    have as much floor that faces down as up: nothing is said of these.

    Args:
        corners: (F, 3, 3), triangles, counter-clockwise seen from outside, world frame, metres.
        grid: the cells.
        floor_z: height of the floor, world metres.
        low: what is lower is no part of it.
        high: nor is what is higher.
        ground_plane: there is a floor everywhere, although no triangle says so.
    """
    bottoms, tops = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    at_floor = (bottoms >= low) & (tops <= high)
    facing = unit_normals(corners)[:, 2]
    down, up = corners[at_floor & (facing < -_LEVEL)], corners[at_floor & (facing > _LEVEL)]
    down = down[down[:, :, 2].max(axis=1) >= floor_z - _TIE]
    floor_area = max(_area(up), 0.5 * grid.resolution**2 * grid.shape[0] * grid.shape[1] if ground_plane else 0.0)
    if not len(down) or _area(down) > _MOST_COVERED * floor_area:
        return np.zeros(grid.shape, dtype=bool)
    underside = grid.heights(down, np.maximum)
    standing = underside > -np.inf
    # Elsewhere nobody asks what is above.
    first, last = (np.asarray(grid.origin) + end * grid.resolution for end in _rim(standing))
    over = (corners[:, :, :2].max(axis=1) > first).all(axis=1) & (corners[:, :, :2].min(axis=1) < last).all(axis=1)
    above = over & (bottoms > high)
    roof = grid.heights(corners[above & (facing < -_STEEP)], np.minimum)
    top = grid.heights(corners[above & (facing > _STEEP)], np.minimum)
    return np.asarray(standing & (underside >= grid.heights(up, np.maximum) - _TIE) & (top < roof))


def _area(corners: F64) -> float:
    """Returns the area of triangles (F, 3, 3) seen from above, square metres."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def _rim(cells: Bools) -> tuple[I64, I64]:
    """Returns the first and last column and row, (2,) each, of the rectangle about cells."""
    found = np.argwhere(cells)[:, ::-1]
    return (found.min(axis=0), found.max(axis=0) + 1) if len(found) else (np.zeros(2, np.int64), np.zeros(2, np.int64))
