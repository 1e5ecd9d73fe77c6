"""Cuts polygons of mesh files into triangles. Convex polygons become fans; all others are cut by ear clipping (mapbox-earcut) in their best plane."""

from __future__ import annotations

from collections.abc import Sequence

import mapbox_earcut
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.formats.mesh import F64, I64

_CONCAVE = -1e-6
"""Turn of a corner, as a share of the polygon's area, below which the corner is concave: more than the rounding of float32 coordinates."""


def triangulate(points: ArrayLike, corners: ArrayLike, counts: ArrayLike) -> tuple[I64, I64]:
    """Returns the triangles of simple polygons.

    Args:
        points: (V, 3), any unit; not finite or collinear ones are allowed.
        corners: rows of ``points``, the corners of all polygons one after another, (C,); others than 0 to V - 1 count as the nearest of these.
        counts: number of corners of each polygon, (P,); polygons of fewer than three have no triangles.

    Returns:
        Triangles (F, 3) int64, indices into ``corners``, with the orientation of their polygon; and the polygon of each triangle, (F,) int64,
        ascending. A convex polygon is a fan around its first corner. A concave polygon with collinear corners may have fewer than
        ``count - 2`` triangles.
    """
    counts = np.asarray(counts, dtype=np.int64)
    triangles, polygon = fan(counts), np.repeat(np.arange(len(counts)), np.maximum(counts - 2, 0))
    if not len(triangles) or counts.max() < 4:
        return triangles, polygon
    points = np.asarray(points, dtype=np.float64)
    corners = np.clip(np.asarray(corners, dtype=np.int64), 0, len(points) - 1)
    starts = np.cumsum(counts) - counts
    cut: list[I64] = []
    owners: list[I64] = []
    for count in np.unique(counts[counts > 3]):
        members = np.flatnonzero(counts == count)
        loops = points[corners[starts[members][:, None] + np.arange(count)]]
        for k in np.flatnonzero(_is_concave(loops)):
            ears = _ears([loops[k]])
            if len(ears):
                cut.append(ears + starts[members[k]])
                owners.append(np.full(len(ears), members[k]))
    if cut:
        kept = ~np.isin(polygon, np.concatenate(owners))
        triangles, polygon = np.concatenate([triangles[kept], *cut]), np.concatenate([polygon[kept], *owners])
        order = np.argsort(polygon, kind="stable")
        triangles, polygon = triangles[order], polygon[order]
    return triangles, polygon


def triangulate_with_holes(loops: Sequence[ArrayLike]) -> I64:
    """Returns the triangles (F, 3) int64 of one polygon with holes, with the orientation of its outline.

    Args:
        loops: points of the outline, (N, 3), then those of each hole in either orientation; the result has indices into their concatenation.
    """
    rings = [np.asarray(loop, dtype=np.float64).reshape(-1, 3) for loop in loops]
    ears = _ears(rings)
    return ears if len(ears) else fan(np.array([len(rings[0])]))


def fan(counts: ArrayLike) -> I64:
    """Returns the triangle fans (F, 3) of polygons with ``counts`` (P,) corners, as indices into the concatenated corners of all polygons."""
    counts = np.asarray(counts, dtype=np.int64)
    per_polygon = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, per_polygon)
    within = np.arange(int(per_polygon.sum())) - np.repeat(np.cumsum(per_polygon) - per_polygon, per_polygon)
    return np.stack([first, first + within + 1, first + within + 2], axis=1)


def _normals(loops: F64) -> F64:
    """Returns the normals of polygons (P, N, 3), as long as twice their area, (P, 3) (Newell's method)."""
    relative = loops - loops[:, :1]
    return np.asarray(np.cross(relative, np.roll(relative, -1, axis=1)).sum(axis=1))


def _is_concave(loops: F64) -> NDArray[np.bool_]:
    """Returns which polygons (P, N, 3) have a corner that turns against the others, seen along their normals, (P,) bool."""
    with np.errstate(invalid="ignore", over="ignore"):
        normals = _normals(loops)
        edges = np.roll(loops, -1, axis=1) - loops
        turns = np.einsum("pni,pi->pn", np.cross(edges, np.roll(edges, -1, axis=1)), normals)
        return np.asarray((turns < _CONCAVE * np.einsum("pi,pi->p", normals, normals)[:, None]).any(axis=1))


def _ears(rings: Sequence[F64]) -> I64:
    """Returns the triangles (F, 3) of a polygon with holes; none if its area is zero or not finite."""
    ring = rings[0]
    if len(ring) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    with np.errstate(invalid="ignore", over="ignore"):
        normal = _normals(ring[None])[0]
        length = float(np.linalg.norm(normal))
    points = np.concatenate(rings)
    if not (np.isfinite(points).all() and np.isfinite(length) and length > 0.0):
        return np.zeros((0, 3), dtype=np.int64)
    normal /= length
    # Axes of the plane: right-handed with the normal, so that the outline runs counter-clockwise in it.
    right = np.cross(np.eye(3)[np.argmin(np.abs(normal))], normal)
    right /= np.linalg.norm(right)
    flat = (points - ring[0]) @ np.stack([right, np.cross(normal, right)], axis=1)
    ends = np.cumsum([len(r) for r in rings]).astype(np.uint32)
    ears = np.asarray(mapbox_earcut.triangulate_float64(flat, ends), dtype=np.int64).reshape(-1, 3)
    a, b, c = (flat[ears[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0.0
    ears[clockwise] = ears[clockwise][:, ::-1]
    return ears
