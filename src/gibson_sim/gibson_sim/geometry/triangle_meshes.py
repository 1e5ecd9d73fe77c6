"""Welds, measures, smooths and simplifies triangle meshes, the last with meshoptimizer. Independent of file formats.

Areas, normals and random points are those of triangles given by their corners (F, 3, 3).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gibson_sim.errors import MeshError

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_ERROR_IN_METRES = 4
"""meshopt_SimplifyErrorAbsolute."""
_PRUNE = 8
"""meshopt_SimplifyPrune: removes parts smaller than the error."""
_NO_LIMIT = 1000.0
"""Error limit without effect, metres."""
_ROUNDS = 10
"""Number of smoothing rounds."""
_NEAREST = (4, 64)
"""Number of nearest sample points whose triangles a point is compared with: in the first pass, and in the second for doubtful points."""
_DOUBTFUL = 0.02
"""Distance above which the result of the first pass is doubtful, metres."""
_AT_ONCE = 20_000
"""Number of points processed at a time, to limit memory."""


def weld(vertices: ArrayLike, triangles: ArrayLike) -> tuple[F64, I64]:
    """Returns the mesh, vertices (V, 3) and triangles (F, 3), with coincident vertices merged and without degenerate triangles."""
    points = np.ascontiguousarray(np.asarray(vertices, dtype=np.float32).reshape(-1, 3) + np.float32(0.0))
    corners = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    corners = corners[np.isfinite(points[corners]).all(axis=(1, 2))]
    rows = points.view(np.dtype((np.void, points.dtype.itemsize * 3))).ravel()
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    corners = which.reshape(-1)[corners]
    distinct = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    return compact(points[first].astype(np.float64), corners[distinct])


def compact(vertices: F64, triangles: I64) -> tuple[F64, I64]:
    """Returns the mesh, vertices (V, 3) and triangles (F, 3), without unreferenced vertices."""
    used, corners = np.unique(triangles, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3).astype(np.int64)


def components(triangles: NDArray[np.integer], vertex_count: int) -> I64:
    """Returns the connected component of each triangle (F, 3), numbers (F,); triangles with a common vertex are connected."""
    if not len(triangles):
        return np.zeros(0, dtype=np.int64)
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]])
    graph = sparse.coo_matrix((np.ones(len(ends), dtype=bool), tuple(ends.T)), shape=(vertex_count, vertex_count))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1][triangles[:, 0]], dtype=np.int64)


def at_a_border(triangles: I64, vertex_count: int) -> Bools:
    """Returns a mask, (F,), of the triangles (F, 3) with an edge that is not traversed equally often in both directions."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    edge, which = np.unique(np.minimum(start, end) * vertex_count + np.maximum(start, end), return_inverse=True)
    balance = np.bincount(which, np.sign(end - start), minlength=len(edge))
    return np.asarray((balance[which] != 0.0).reshape(-1, 3).any(axis=1))


def distances(points: F64, corners: F64, rng: np.random.Generator, density: float = 500.0) -> F64:
    """Returns the distances (N,) of points (N, 3) from triangles (F, 3, 3), metres: upper bounds, exact for nearly all points.

    Each point is compared with the triangles of the nearest sample points.

    Args:
        points: (N, 3), metres.
        corners: (F, 3, 3), metres.
        rng: source of randomness for the sample points.
        density: sample points per square metre.
    """
    if not len(corners):
        return np.full(len(points), np.inf)
    count = int(np.clip(areas_of(corners).sum() * density, 10_000, 300_000))
    samples, owner = spread_over(corners, count, rng)
    # Triangles too small for a sample are represented by their centroids.
    samples = np.concatenate([samples, corners.mean(axis=1)])
    owner = np.concatenate([owner, np.arange(len(corners))])
    tree = cKDTree(samples)
    out = np.full(len(points), np.inf)
    doubtful = np.arange(len(points))
    for count in _NEAREST:
        for start in range(0, len(doubtful), _AT_ONCE):
            part = doubtful[start : start + _AT_ONCE]
            _, near = tree.query(points[part], k=count)
            for k in range(count):
                out[part] = np.minimum(out[part], _to_triangle(points[part], corners[owner[near[:, k]]]))
        doubtful = np.flatnonzero(out > _DOUBTFUL)
    return out


def smooth(vertices: F64, triangles: I64, fixed: Bools, farthest: float) -> F64:
    """Smooths the noise of a scan and returns its vertices (V, 3), each moved by at most ``farthest`` metres.

    Alternating signs prevent shrinkage: Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.

    Args:
        vertices: (V, 3), welded, metres.
        triangles: (F, 3), rows in ``vertices``.
        fixed: (V,), mask of vertices that must not move.
        farthest: largest displacement, metres.
    """
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    ones = np.ones(len(ends))
    adjacency = sparse.coo_matrix((ones, (ends[:, 0], ends[:, 1])), shape=(len(vertices), len(vertices))).tocsr()
    adjacency = adjacency + adjacency.T
    weights = np.asarray(adjacency.sum(axis=1)).ravel()
    moving = (~fixed & (weights > 0))[:, None]
    mean = sparse.diags(1.0 / np.maximum(weights, 1.0)) @ adjacency
    out = vertices
    for factor in (0.5, -0.53) * _ROUNDS:
        out = np.where(moving, out + factor * (mean @ out - out), out)
    displacement = out - vertices
    length = np.linalg.norm(displacement, axis=1, keepdims=True)
    return np.asarray(vertices + displacement * np.minimum(1.0, farthest / np.maximum(length, 1e-12)))


def simplify(vertices: F64, triangles: I64, error: float, fixed: Bools) -> tuple[F64, I64]:
    """Returns a mesh with fewer triangles, between some of the same vertices, within about ``error`` metres of the given one.

    Args:
        vertices: (V, 3), welded, metres.
        triangles: (F, 3), rows in ``vertices``.
        error: error limit, metres; meshoptimizer's measure is a mean over adjacent planes, so the actual error must be measured.
        fixed: (V,), mask of vertices that must not be removed.

    Raises:
        MeshError: meshoptimizer is not installed.
    """
    return compact(vertices, simplified_triangles(vertices, triangles, error=error, fixed=fixed))


def simplified_triangles(
    vertices: NDArray[Any], triangles: NDArray[Any], *, error: float = _NO_LIMIT, least: int = 0, fixed: Bools | None = None
) -> I64:
    """Returns fewer triangles (F, 3) between the same vertices, most of which are then unused.

    Args:
        vertices: (V, 3), welded, metres.
        triangles: (F, 3), rows in ``vertices``.
        error: error limit, metres, as for ``simplify``.
        least: approximate number of triangles at which simplification stops.
        fixed: (V,), mask of vertices that must not be removed; None = none.

    Raises:
        MeshError: meshoptimizer is not installed.
    """
    if not len(triangles):
        return np.zeros((0, 3), dtype=np.int64)
    points = np.ascontiguousarray(vertices, dtype=np.float32)
    indices = np.ascontiguousarray(triangles, dtype=np.uint32)
    locks = np.ascontiguousarray(np.zeros(len(points)) if fixed is None else fixed, dtype=np.uint8)
    out = np.empty(indices.size, dtype=np.uint32)
    reached = ctypes.c_float()
    count = _simplifier()(
        out.ctypes.data, indices.ctypes.data, indices.size, points.ctypes.data, len(points), 12, None, 0, None, 0,
        locks.ctypes.data, 3 * least, error, _ERROR_IN_METRES | _PRUNE, ctypes.byref(reached),
    )  # fmt: skip
    return out[:count].astype(np.int64).reshape(-1, 3)


def _simplifier() -> Callable[..., int]:
    """Returns meshoptimizer's function with its C argument types."""
    try:
        from meshoptimizer.simplifier import lib
    except ImportError as error:
        raise MeshError(
            f"scans are simplified with meshoptimizer, which cannot be loaded ({error}); pip install meshoptimizer"
        ) from error
    # The package's wrapper declares no argument types: sizes beyond the sixth argument would have garbage in their upper half.
    size, pointer = ctypes.c_size_t, ctypes.c_void_p
    function: Callable[..., int] = ctypes.CFUNCTYPE(
        size, pointer, pointer, size, pointer, size, size, pointer, size, pointer, size, pointer, size, ctypes.c_float,
        ctypes.c_uint, pointer,
    )(("meshopt_simplifyWithAttributes", lib))  # fmt: skip
    return function


def _to_triangle(points: F64, corners: F64) -> F64:
    """Returns the distances (N,) of points (N, 3) from one triangle each, (N, 3, 3), metres."""
    a, b, c = (corners[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    square = np.einsum("ij,ij->i", normal, normal)
    height = np.einsum("ij,ij->i", points - a, normal)
    inside = square > 0
    out = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.einsum("ij,ij->i", np.cross(edge, points - start), normal) >= 0
        along = np.einsum("ij,ij->i", points - start, edge) / np.maximum(np.einsum("ij,ij->i", edge, edge), 1e-30)
        nearest = start + np.clip(along, 0.0, 1.0)[:, None] * edge
        out = np.minimum(out, np.linalg.norm(points - nearest, axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(inside, np.abs(height) / np.sqrt(square), out))


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
