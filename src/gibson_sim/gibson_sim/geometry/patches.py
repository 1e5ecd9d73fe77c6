"""The flat pieces that a mesh consists of: points spread over its triangles, and a plane through those of each small cube.

What counts is where surface is, not how it was cut into triangles: a floor of two triangles, one of a million bumpy ones and a soup of
specks that face anywhere give the same pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.triangles import spread_over, unit_normals

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

POINTS = 40_000
"""Points that stand for a mesh."""
_POINTS_EACH = 25.0
"""Points in a cube, on average over the points."""
_FEWEST = 8
"""Points that a plane is laid through."""
_FLAT = 0.08
"""Variance across a flat piece, against the lesser one along it."""
_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Points on a mesh, and the flat pieces that they lie on. All lengths are in the unit of the mesh."""

    points: F64
    """(N, 3), spread evenly: each square metre has as many."""
    normals: F64
    """(N, 3), unit length: of the triangles that the points lie on."""
    cube: I64
    """(N,), the row below of each point."""
    centres: F64
    """(P, 3), of the points in each cube."""
    directions: F64
    """(P, 3), unit length, across the piece; the sign means nothing."""
    weights: F64
    """(P,), points on the piece; 0 where the cube's points are on no plane."""
    size: float
    """Edge of a cube."""


def flat_patches(vertices: F64, triangles: NDArray[np.integer], rng: np.random.Generator, count: int = POINTS) -> Patches | None:
    """Returns the flat pieces of a mesh; None if its triangles have no area.

    Args:
        vertices: (V, 3).
        triangles: (F, 3), rows of ``vertices``.
        rng: decides where the points lie.
        count: of the points.
    """
    corners = np.asarray(vertices, dtype=np.float64)[triangles]
    points, which = spread_over(corners, count, rng)
    if not len(points):
        return None
    return _pieces(points, unit_normals(corners[which]), np.eye(3))


def in_other_cubes(patches: Patches, rotation: F64) -> Patches:
    """Returns the flat pieces of the same points in the cubes of a grid that is turned, (3, 3); the frame stays that of the mesh."""
    return _pieces(patches.points, patches.normals, rotation)


def _pieces(points: F64, normals: F64, rotation: F64) -> Patches:
    turned = points @ rotation
    size = max(float(np.ptp(turned, axis=0).max()) / 30.0, 1e-12)
    for _ in range(_ROUNDS):
        cube, numbers = _cubes(turned, size)
        mean = float((numbers.astype(np.float64) ** 2).sum() / numbers.sum())
        if 0.9 < mean / _POINTS_EACH < 1.1:
            break
        size *= (_POINTS_EACH / mean) ** 0.5
    cube, numbers = _cubes(turned, size)
    centres = np.stack([np.bincount(cube, points[:, k]) for k in range(3)], axis=1) / numbers[:, None]
    offsets = points - centres[cube]
    spread = np.empty((len(numbers), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(cube, offsets[:, i] * offsets[:, j]) / numbers
    values, vectors = np.linalg.eigh(spread)
    flat = (numbers >= _FEWEST) & (values[:, 1] > 0.0) & (values[:, 0] < _FLAT * values[:, 1])
    return Patches(points, normals, cube, centres, vectors[:, :, 0], np.where(flat, numbers, 0).astype(np.float64), size)


def _cubes(points: F64, size: float) -> tuple[I64, I64]:
    """Returns the number of the cube of each point, (N,), and the points in each cube."""
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    sides = cells.max(axis=0) + 1
    codes = (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2]
    _, inverse, counts = np.unique(codes, return_inverse=True, return_counts=True)
    return inverse.reshape(-1).astype(np.int64), counts.astype(np.int64)
