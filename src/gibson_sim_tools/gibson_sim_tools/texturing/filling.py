"""Colours for triangles that no photograph shows: from their neighbours, or from the mesh's own colours, adjusted to their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.texturing.solving import solve

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_GREY = 0.5
"""Colour of parts that are connected to nothing with a colour, sRGB."""


def fill_vertices(triangles: I64, known: Bools, colors: F32, own: F32 | None) -> F32:
    """Returns the colours of all vertices, (V, 3), sRGB, 0 to 1: those that are known, and smooth ones between them.

    Args:
        triangles: (F, 3).
        known: (V,), whether a vertex has a colour.
        colors: (V, 3), the colours that are known.
        own: (V, 3), colours of the mesh, or None; what is filled is then the difference from them.
    """
    count = len(known)
    base = np.zeros((count, 3)) if own is None else own.astype(np.float64)
    rest = np.where(known[:, None], colors - base, 0.0 if own is not None else _GREY)
    free = ~known
    if free.any() and known.any():
        ends = np.unique(
            np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1), axis=0
        )
        ones = np.ones(len(ends))
        graph = sparse.csr_matrix((ones, (ends[:, 0], ends[:, 1])), shape=(count, count))
        graph = graph + graph.T
        degree = np.asarray(graph.sum(axis=1)).ravel()
        # The small addition pulls islands without any known colour to what they have.
        matrix = (sparse.diags(degree + 1e-6) - graph).tocsr()[free]
        inside = matrix[:, free].tocsr()
        start = rest[free]
        right = -(matrix[:, known] @ rest[known]) + 1e-6 * start
        rest[free] = solve(inside, right, start=start, most=1000)
    return np.asarray(np.clip(base + rest, 0.0, 1.0), dtype=np.float32)
