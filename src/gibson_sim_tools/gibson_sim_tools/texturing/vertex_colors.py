"""Vertex colours of unseen triangles, by harmonic (Laplace) interpolation over the mesh; the mesh's own colours serve as a guide if it has any."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.texturing.linear_solvers import conjugate_gradients

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_GREY = 0.5
"""Colour of components without any known vertex, sRGB, 0 to 1."""


def interpolate_vertex_colors(triangles: I64, known: Bools, colors: F32, prior_colors: F32 | None) -> F32:
    """Returns the colours of all vertices, (V, 3) float32, sRGB, 0 to 1: the known ones, and harmonic interpolation between them.

    Args:
        triangles: (F, 3), vertex indices.
        known: (V,), mask of the vertices with a known colour.
        colors: (V, 3), colours of the known vertices, sRGB, 0 to 1.
        prior_colors: (V, 3), the mesh's own colours, sRGB, 0 to 1; then the difference to them is interpolated. None = there are none.
    """
    count = len(known)
    base = np.zeros((count, 3)) if prior_colors is None else prior_colors.astype(np.float64)
    difference = np.where(known[:, None], colors - base, 0.0 if prior_colors is not None else _GREY)
    is_unknown = ~known
    if is_unknown.any() and known.any():
        edges = np.unique(
            np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1), axis=0
        )
        ones = np.ones(len(edges))
        graph = sparse.csr_matrix((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
        graph = graph + graph.T
        degree = np.asarray(graph.sum(axis=1)).ravel()
        # The small diagonal term keeps components without any known vertex at their initial values.
        matrix = (sparse.diags(degree + 1e-6) - graph).tocsr()[is_unknown]
        interior = matrix[:, is_unknown].tocsr()
        initial = difference[is_unknown]
        rhs = -(matrix[:, known] @ difference[known]) + 1e-6 * initial
        difference[is_unknown] = conjugate_gradients(interior, rhs, start=initial, max_iterations=1000)
    return np.asarray(np.clip(base + difference, 0.0, 1.0), dtype=np.float32)
