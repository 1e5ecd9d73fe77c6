"""Areas, normals and random points of triangles, given by their corners (F, 3, 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


def areas_of(corners: F64) -> F64:
    """Returns the areas (F,) of triangles (F, 3, 3), square metres for corners in metres."""
    return np.asarray(np.linalg.norm(_crosses(corners), axis=1) / 2)


def unit_normals(corners: F64) -> F64:
    """Returns the unit normals (F, 3) of triangles (F, 3, 3), on the side where the corners are counter-clockwise; 0 for degenerate triangles."""
    crosses = _crosses(corners)
    lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
    return np.asarray(np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0))


def spread_over(corners: F64, count: int, rng: np.random.Generator) -> tuple[F64, NDArray[np.int64]]:
    """Samples ``count`` points (N, 3) uniformly on triangles (F, 3, 3); returns them with the index of their triangles, (N,).

    Returns empty arrays if the triangles have no area.
    """
    areas = areas_of(corners)
    if not areas.sum() > 0:
        return np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    which = np.asarray(rng.choice(len(corners), size=count, p=areas / areas.sum()), dtype=np.int64)
    root, v = np.sqrt(rng.random(count))[:, None], rng.random(count)[:, None]
    a, b, c = (corners[which, k] for k in range(3))
    return np.asarray((1 - root) * a + root * (1 - v) * b + root * v * c), which


def _crosses(corners: F64) -> F64:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
