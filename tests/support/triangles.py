"""Measures of triangles that tests of mesh readers compare."""

from __future__ import annotations

import numpy as np

from gibson_sim.formats.mesh import MeshPart

CONCAVE_L = ((2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0), (0.0, 0.0))
"""Corners of an L of area 3, counter-clockwise; a fan around the first covers an area of 4."""


def area(part: MeshPart) -> float:
    """Returns the area of the triangles of a part, square metres: overlaps count twice."""
    a, b, c = (part.vertices[part.triangles[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def corners(part: MeshPart) -> list[list[list[float]]]:
    """Returns the corners of all triangles of a part, metres, (F, 3, 3) as lists."""
    found: list[list[list[float]]] = (part.vertices[part.triangles].astype(np.float64).round(6) + 0.0).tolist()
    return found
