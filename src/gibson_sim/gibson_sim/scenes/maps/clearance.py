"""How far places are from what stands around them: exact, from triangles and not from a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.scenes.rasterise import clip_to_slab

F64 = NDArray[np.float64]


def clearances(corners: ArrayLike, places: ArrayLike, low: float, high: float, *, reach: float = 1.0) -> F64:
    """Returns the level distance, metres, from places to the nearest triangle between two heights, (N,); at most ``reach``.

    Args:
        corners: (F, 3, 3), world frame, metres.
        places: (N, 2), world x, y.
        low: what is lower is no obstacle, metres.
        high: nor is what is higher.
        reach: metres.
    """
    triangles = np.asarray(corners, dtype=np.float64).reshape(-1, 3, 3)
    between = (triangles[:, :, 2].max(axis=1) > low) & (triangles[:, :, 2].min(axis=1) < high)
    polygons = clip_to_slab(triangles[between], low, high)
    points = np.asarray(places, dtype=np.float64).reshape(-1, 2)
    out = np.full(len(points), reach)
    first, last = polygons.min(axis=1), polygons.max(axis=1)
    for number, point in enumerate(points):
        near = ((first < point + reach) & (last > point - reach)).all(axis=1)
        if near.any():
            out[number] = min(reach, float(_distances(polygons[near], point).min()))
    return out


def _distances(polygons: F64, point: F64) -> F64:
    """Returns the distances (P,) of convex polygons (P, K, 2), corners repeated, from a point (2,); 0 in them."""
    edges = np.roll(polygons, -1, axis=1) - polygons
    to = point - polygons
    length = np.einsum("pki,pki->pk", edges, edges)
    along = np.clip(np.einsum("pki,pki->pk", to, edges) / np.maximum(length, 1e-30), 0.0, 1.0)
    distance = np.linalg.norm(to - along[:, :, None] * edges, axis=2).min(axis=1)
    side = edges[:, :, 0] * to[:, :, 1] - edges[:, :, 1] * to[:, :, 0]
    inside = ((side >= 0).all(axis=1) | (side <= 0).all(axis=1)) & (np.abs(side).max(axis=1) > 0)
    return np.asarray(np.where(inside, 0.0, distance))
