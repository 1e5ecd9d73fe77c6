"""Cuts triangle meshes into pieces that PyBullet takes. Pure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_VERTEX_LIMIT = 131_000
"""Vertices of one collision shape; PyBullet refuses arrays above 131,072 vertices or 524,288 indices."""
_TRIANGLE_LIMIT = 174_000


def mesh_pieces(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Yields (vertices, triangles) of pieces below the size limit, cut across the longest axis so that each is compact."""
    if len(triangles) <= _TRIANGLE_LIMIT:
        used, corners = np.unique(triangles, return_inverse=True)
        if len(used) <= _VERTEX_LIMIT:
            yield vertices[used], corners.reshape(-1, 3)
            return
    centers = vertices[triangles].mean(axis=1)
    axis = int(np.argmax(np.ptp(centers, axis=0)))
    order = np.argsort(centers[:, axis], kind="stable")
    half = len(order) // 2
    yield from mesh_pieces(vertices, triangles[order[:half]])
    yield from mesh_pieces(vertices, triangles[order[half:]])
