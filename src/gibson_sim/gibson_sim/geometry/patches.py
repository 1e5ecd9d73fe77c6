"""Flat patches of a mesh: points sampled on its triangles, and a plane fitted to the points in each small cube.

Patches depend on the surface, not on its triangulation: a floor of two triangles, a floor of a million bumpy triangles and a soup of
triangles with arbitrary winding give the same patches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.triangle_meshes import spread_over, unit_normals

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

POINTS = 40_000
"""Number of points sampled on a mesh."""
_POINTS_PER_CUBE = 25.0
"""Number of points in the cube of a point, on average over all points."""
_MIN_POINTS = 8
"""Minimum number of points of a plane."""
_FLAT = 0.08
"""Largest variance along the normal of a flat patch, relative to the smaller variance in its plane."""
_ROUNDS = 4
"""Number of adjustments of the size of the cubes."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Points on a mesh and their flat patches, in the frame and unit of the mesh."""

    points: F64
    """(N, 3), points of uniform density."""
    normals: F64
    """(N, 3), unit normals of the triangles of the points."""
    cube: I64
    """(N,), index of the cube of each point: a row of the following arrays."""
    centres: F64
    """(P, 3), centroids of the points in each cube."""
    directions: F64
    """(P, 3), unit normals of the patches, of arbitrary sign."""
    weights: F64
    """(P,), number of points of each patch; 0 = the points of the cube are not on a plane."""
    size: float
    """Edge length of a cube."""


def flat_patches(vertices: F64, triangles: NDArray[np.integer], rng: np.random.Generator, count: int = POINTS) -> Patches | None:
    """Returns the flat patches of a mesh; None if its triangles have no area.

    Args:
        vertices: (V, 3).
        triangles: (F, 3), rows in ``vertices``.
        rng: source of randomness for the points.
        count: number of points.
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    points, which = spread_over(corners, count, rng)
    if not len(points):
        return None
    return _patches(points, unit_normals(corners[which]), np.eye(3))


def in_other_cubes(patches: Patches, rotation: F64) -> Patches:
    """Returns the patches of the same points, still in the frame of the mesh, in the cubes of a grid rotated by ``rotation`` (3, 3)."""
    return _patches(patches.points, patches.normals, rotation)


def _patches(points: F64, normals: F64, rotation: F64) -> Patches:
    """Returns the patches of points (N, 3) with normals (N, 3) in the cubes of a rotated grid."""
    in_grid = points @ rotation
    size = max(float(np.ptp(in_grid, axis=0).max()) / 30.0, 1e-12)
    for _ in range(_ROUNDS):
        cube, numbers = _cubes(in_grid, size)
        mean = float((numbers.astype(np.float64) ** 2).sum() / numbers.sum())
        if 0.9 < mean / _POINTS_PER_CUBE < 1.1:
            break
        size *= (_POINTS_PER_CUBE / mean) ** 0.5
    cube, numbers = _cubes(in_grid, size)
    centres = np.stack([np.bincount(cube, points[:, k]) for k in range(3)], axis=1) / numbers[:, None]
    offsets = points - centres[cube]
    spread = np.empty((len(numbers), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(cube, offsets[:, i] * offsets[:, j]) / numbers
    values, vectors = np.linalg.eigh(spread)
    flat = (numbers >= _MIN_POINTS) & (values[:, 1] > 0.0) & (values[:, 0] < _FLAT * values[:, 1])
    return Patches(points, normals, cube, centres, vectors[:, :, 0], np.where(flat, numbers, 0).astype(np.float64), size)


def _cubes(points: F64, size: float) -> tuple[I64, I64]:
    """Returns the number of the cube of each point, (N,), and the number of points in each cube, (P,)."""
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    sides = cells.max(axis=0) + 1
    _, cube, counts = occupied_cells((cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2])
    return cube, counts


def occupied_cells(codes: I64) -> tuple[I64, I64, I64]:
    """Returns the codes that occur, ascending; of each of the given codes (N,), 0 or more, its index among them; and how often each occurs."""
    if not len(codes) or int(codes.max()) > 8 * len(codes):
        found, inverse, counts = np.unique(codes, return_inverse=True, return_counts=True)
        return found, inverse.reshape(-1).astype(np.int64), counts.astype(np.int64)
    # Counting is several times as fast as sorting.
    counts = np.bincount(codes)
    found = np.flatnonzero(counts)
    return found, (np.cumsum(counts > 0) - 1)[codes], counts[found]
