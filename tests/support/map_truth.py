"""Compares a floor map with rays that physics casts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.maps.floor_map import FLOOR_CLEARANCE, FloorMap

F64 = NDArray[np.float64]
CastRays = Callable[[F64, F64, float], F64]
HEIGHTS = 12
"""Rays above each other between the floor and the robot's height."""


def agreement(floor: FloorMap, robot_height: float, cast: CastRays, *, cells: int, seed: int = 0) -> tuple[float, float]:
    """Returns which part of cells said to be free are empty, and which part of those at the rim of what is occupied are not.

    Horizontal rays at several heights cross each cell along both axes and both diagonals, both ways; faces of triangles are seen from
    one side only by some. What is level lies between them: rays from above and below find it.

    Args:
        floor: the map.
        robot_height: that it was made for, metres.
        cast: origins (N, 3), directions (N, 3), length, metres; returns distances (N,), +inf = no hit.
        cells: how many of each kind, at random.
        seed: of the choice.
    """
    rng = np.random.default_rng(seed)
    shares = []
    # No ray meets anything in the middle of what is solid.
    rim = floor.occupied & ~ndimage.binary_erosion(floor.occupied, np.ones((3, 3)))
    for chosen, hit_is_right in ((np.argwhere(floor.free), False), (np.argwhere(rim), True)):
        some = chosen[rng.choice(len(chosen), min(cells, len(chosen)), replace=False)]
        hits = _anything_in(floor.centers(some), floor, robot_height, cast, 1.004 if hit_is_right else 0.996)
        shares.append(float((hits == hit_is_right).mean()))
    return shares[0], shares[1]


def _anything_in(centers: F64, floor: FloorMap, robot_height: float, cast: CastRays, part: float) -> NDArray[np.bool_]:
    """Returns whether rays through ``part`` of the width of cells (N, 2) hit anything, (N,); what lies on a border is in one cell alone."""
    half = floor.resolution / 2 * part
    low, high = floor.floor_z + FLOOR_CLEARANCE + 1e-3, floor.floor_z + robot_height - 1e-3
    starts, ends = [], []
    for z in np.linspace(low, high, HEIGHTS):
        for t in (-0.99, 0.0, 0.99):
            starts += [(-half, t * half, z), (t * half, -half, z)]
            ends += [(half, t * half, z), (t * half, half, z)]
        starts += [(-half, -half, z), (-half, half, z)]
        ends += [(half, half, z), (half, -half, z)]
    for x in np.linspace(-half, half, 4):
        for y in np.linspace(-half, half, 4):
            starts.append((x, y, high))
            ends.append((x, y, low))
    lines = np.array([[a, b] for a, b in zip(starts, ends, strict=True)])
    lines = np.concatenate([lines, lines[:, ::-1]])
    hits = np.zeros(len(centers), dtype=bool)
    offset = np.pad(centers, ((0, 0), (0, 1)))
    for start, end in lines:
        ray = end - start
        length = float(np.linalg.norm(ray))
        left = np.flatnonzero(~hits)
        hits[left] = np.isfinite(cast(offset[left] + start, np.tile(ray / length, (len(left), 1)), length))
    return hits
