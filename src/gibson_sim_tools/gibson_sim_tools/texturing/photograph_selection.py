"""Selects a subset of photographs with the best coverage of the mesh, from poses and geometry alone; reads no image.

Greedy maximum coverage with diminishing returns. (View selection per triangle is another step: ``labelling``.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.scanning.posed_images import Photographs
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.rasteriser import rasterise

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_IMAGE_WIDTH_PX = 64
"""Width of the rasterised views, pixels."""
_GRID_CELLS = 24
"""Grid cells along the longest side of the mesh; coverage is counted per cell."""
_COARSE_TRIANGLES = 6000
"""Approximate number of triangles of the rasterised mesh."""


def select_photographs(
    surface: TriangleMesh, photographs: Photographs, max_count: int, progress: Callable[[float], None] = lambda _: None
) -> I64:  # fmt: skip
    """Returns the numbers of at most ``max_count`` photographs, ascending, selected greedily by their gain in coverage.

    A cell that n selected photographs show already counts 1 / (1 + n), so that large parts of the surface are covered several times before a
    small part gets another photograph.

    Args:
        surface: mesh, world frame.
        photographs: posed in the same frame.
        max_count: largest number of photographs.
        progress: called with the fraction that is done, 0 to 1.
    """
    count = len(photographs)
    if count <= max_count:
        return np.arange(count)
    cell_size = float(np.ptp(surface.vertices, axis=0).max()) / _GRID_CELLS + 1e-9
    coarse = _decimated(surface)
    # The axis that a triangle faces is part of its cell's key, so that the two sides of a wall lie in different cells.
    corners = coarse.corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing_axis = np.abs(normal).argmax(axis=1) * 2 + (
        np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)[:, 0] > 0
    )
    keys = np.concatenate([np.floor(corners.mean(axis=1) / cell_size).astype(np.int64), facing_axis[:, None]], axis=1)
    triangle_cell = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    cell_coverage = np.zeros((count, int(triangle_cell.max()) + 1), dtype=np.float32)
    for number, item in enumerate(photographs.items):
        intrinsics = photographs.intrinsics(number)
        small = intrinsics.resized(_IMAGE_WIDTH_PX, max(round(_IMAGE_WIDTH_PX * intrinsics.height / intrinsics.width), 1))
        face = rasterise(coarse, small, item.T_world_camera).face
        faces, pixels = np.unique(face[face >= 0], return_counts=True)
        is_front = np.einsum("ij,ij->i", normal[faces], item.T_world_camera[:3, 3] - corners[faces, 0]) > 0.0
        np.add.at(cell_coverage[number], triangle_cell[faces[is_front]], pixels[is_front] / face.size)
        progress((number + 1) / count)
    view_counts = np.zeros(cell_coverage.shape[1])
    selected: list[int] = []
    for _ in range(max_count):
        gain = cell_coverage @ (1.0 / (1.0 + view_counts)).astype(np.float32)
        gain[selected] = -1.0
        best = int(gain.argmax())
        selected.append(best)
        # A cell counts as covered once if it fills 1 % of a photograph.
        view_counts += np.minimum(100.0 * cell_coverage[best], 1.0)
    return np.sort(np.array(selected))


def _decimated(surface: TriangleMesh) -> TriangleMesh:
    """Returns the surface with about ``_COARSE_TRIANGLES`` triangles, simplified by vertex clustering on a grid."""
    if len(surface.triangles) <= _COARSE_TRIANGLES:
        return surface
    # The number of triangles falls with the square of the cell size.
    corners = surface.corners
    area = float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()) / 2.0
    cell_size = 2.0 * np.sqrt(area / _COARSE_TRIANGLES)
    occupied, vertex_cell = np.unique(np.floor(surface.vertices / cell_size).astype(np.int64), axis=0, return_inverse=True)
    vertex_cell = vertex_cell.ravel()
    vertex_counts = np.bincount(vertex_cell, minlength=len(occupied))
    centroids = np.stack(
        [np.bincount(vertex_cell, surface.vertices[:, k], len(occupied)) / vertex_counts for k in range(3)], axis=1
    )
    triangles = vertex_cell[surface.triangles]
    is_valid = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return TriangleMesh(centroids, np.unique(triangles[is_valid], axis=0))
