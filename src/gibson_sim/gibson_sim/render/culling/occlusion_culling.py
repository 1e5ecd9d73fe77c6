"""Compiled loops of ``subclusters`` and ``occlusion``: cull subclusters of a plan that are hidden behind a depth image.

By rounding, the culled subclusters may differ from those of the NumPy code, but never so that a pixel changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import compiled

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]
TILE_PX = 8
"""Side of the smallest tiles of a depth pyramid, pixels."""
DEPTH_MARGIN = 1e-5
"""Relative depth by which a box must lie behind its occluder, since depths are rounded."""


class SubclusterTable(NamedTuple):
    """The arrays of ``Subclusters``."""

    row: I64
    number: I64
    box: F64
    span: U32


class ImageSize(NamedTuple):
    """Size and near plane of a picture."""

    width: float
    """Width, pixels."""
    height: float
    near: float
    """Depth of the near plane, metres."""


class PyramidLevels(NamedTuple):
    """A pyramid of minima over tiles."""

    values: F32
    """Values of all levels, concatenated."""
    firsts: I64
    """Offset of the first value of each level."""
    widths: I64
    """Number of columns of each level."""


@compiled
def depth_pyramid(depth: F32) -> PyramidLevels:
    """Returns the levels of ``occlusion.DepthPyramid`` for a depth image, (H, W)."""
    height, width = depth.shape
    rows, columns, total, levels = (height + TILE_PX - 1) // TILE_PX, (width + TILE_PX - 1) // TILE_PX, 1, 1
    r, c = rows, columns
    while r * c > 1:
        total += r * c
        r, c, levels = (r + 1) // 2, (c + 1) // 2, levels + 1
    values = np.full(total, np.inf, dtype=np.float32)
    firsts, widths = np.zeros(levels, dtype=np.int64), np.empty(levels, dtype=np.int64)
    widths[0] = columns
    least = np.empty(width, dtype=np.float32)  # minima over the rows of a tile, since whole rows are fast to traverse
    for row in range(rows):
        top = row * TILE_PX
        for u in range(width):
            least[u] = depth[top, u]
        for v in range(top + 1, min(top + TILE_PX, height)):
            for u in range(width):
                least[u] = min(least[u], depth[v, u])
        for u in range(width):
            tile = row * columns + u // TILE_PX
            values[tile] = min(values[tile], least[u])
    for level in range(1, levels):
        finer, coarser, width = firsts[level - 1], firsts[level - 1] + rows * columns, (columns + 1) // 2
        for v in range(rows):
            for u in range(columns):
                tile, value = coarser + v // 2 * width + u // 2, values[finer + v * columns + u]
                if value < values[tile]:
                    values[tile] = value
        firsts[level], widths[level], rows, columns = coarser, width, (rows + 1) // 2, width
    return PyramidLevels(values, firsts, widths)


@compiled
def cull_hidden(
    depth: F32,
    clusters: I64,
    batch: I64,
    draws: U32,
    opaque: int,
    subclusters: SubclusterTable,
    cluster_link: I64,
    T_camera_links: F64,
    intrinsics: F64,
    near: float,
) -> tuple[I64, I64, U32, int]:
    """Returns the draws of potentially visible subclusters, with consecutive draws merged.

    Args:
        depth: (H, W), depth image of the picture, ``near / depth``, 0 = nothing.
        clusters: (N,), as in ``draw_plan.DrawPlan``.
        batch: (N,), as in ``DrawPlan``.
        draws: (N, 5), as in ``DrawPlan``.
        opaque: number of opaque draws, as in ``DrawPlan``.
        subclusters: table with the subclusters of at least these clusters.
        cluster_link: (C,), link number of all clusters.
        T_camera_links: (L, 4, 4), optical frame from the world and from each link.
        intrinsics: K, (3, 3), pixels.
        near: depth of the near plane, metres.

    Returns:
        Cluster, batch and draw command of each draw, and the number of opaque draws.
    """
    size, pyramid = ImageSize(float(depth.shape[1]), float(depth.shape[0]), near), depth_pyramid(depth)
    pixels_from_links = np.empty((len(T_camera_links), 3, 4))
    for link in range(len(T_camera_links)):
        T = T_camera_links[link]
        for j in range(4):
            for i in range(2):
                pixels_from_links[link, i, j] = (
                    intrinsics[i, 0] * T[0, j] + intrinsics[i, 1] * T[1, j] + intrinsics[i, 2] * T[2, j]
                )
            pixels_from_links[link, 2, j] = T[2, j]
    total = 0
    for cluster in clusters:
        total += subclusters.number[cluster]
    out_cluster, out_batch = np.empty(total, dtype=np.int64), np.empty(total, dtype=np.int64)
    out, n, opaque_draws = np.empty((total, 5), dtype=np.uint32), 0, 0
    last = -1  # the draw that the next subcluster may extend
    for i in range(len(clusters)):
        if i == opaque:
            last = -1
        cluster = clusters[i]
        matrix = pixels_from_links[cluster_link[cluster]]
        for row in range(subclusters.row[cluster], subclusters.row[cluster] + subclusters.number[cluster]):
            if _is_hidden(subclusters.box[row], matrix, size, pyramid):
                continue
            count, first = subclusters.span[row, 0], subclusters.span[row, 1]
            if last >= 0 and first == out[last, 2] + out[last, 0] and draws[i, 4] == out[last, 4] and batch[i] == out_batch[last]:
                out[last, 0] += count
                continue
            for k in range(5):
                out[n, k] = draws[i, k]
            out[n, 0], out[n, 2] = count, first
            out_cluster[n], out_batch[n], last = cluster, batch[i], n
            n += 1
        if i < opaque:
            opaque_draws = n
    return out_cluster[:n], out_batch[:n], out[:n], opaque_draws


@compiled
def _is_hidden(box: F64, matrix: F64, size: ImageSize, pyramid: PyramidLevels) -> bool:
    """Returns whether a box is behind the depths of the pyramid or outside the picture; False if it is not entirely beyond the near plane."""
    x, y, z = _coordinate(matrix[0], box), _coordinate(matrix[1], box), _coordinate(matrix[2], box)
    x0, x1, x2 = matrix[0, 0] * box[3], matrix[0, 1] * box[4], matrix[0, 2] * box[5]
    y0, y1, y2 = matrix[1, 0] * box[3], matrix[1, 1] * box[4], matrix[1, 2] * box[5]
    z0, z1, z2 = matrix[2, 0] * box[3], matrix[2, 1] * box[4], matrix[2, 2] * box[5]
    nearest = z - abs(z0) - abs(z1) - abs(z2)
    if not nearest > size.near:
        return False
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for a in (-1.0, 1.0):
        for b in (-1.0, 1.0):
            for c in (-1.0, 1.0):
                scale = 1.0 / (z + z0 * a + z1 * b + z2 * c)
                u, v = (x + x0 * a + x1 * b + x2 * c) * scale, (y + y0 * a + y1 * b + y2 * c) * scale
                left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    left, right, top, bottom = np.floor(left), np.ceil(right), np.floor(top), np.ceil(bottom)
    if right < 0 or bottom < 0 or left >= size.width or top >= size.height:
        return True
    first_column, last_column = int(max(left, 0.0)) // TILE_PX, int(min(right, size.width - 1.0)) // TILE_PX
    first_row, last_row = int(max(top, 0.0)) // TILE_PX, int(min(bottom, size.height - 1.0)) // TILE_PX
    # The level at which the rectangle touches at most two tiles per side.
    level, reach = 0, max(last_column - first_column, last_row - first_row) - 1
    while reach > 0 and level < len(pyramid.widths) - 1:
        level += 1
        reach >>= 1
    upper = pyramid.firsts[level] + (first_row >> level) * pyramid.widths[level]
    lower = pyramid.firsts[level] + (last_row >> level) * pyramid.widths[level]
    left_column, right_column, values = first_column >> level, last_column >> level, pyramid.values
    least = min(
        min(values[upper + left_column], values[upper + right_column]),
        min(values[lower + left_column], values[lower + right_column]),
    )
    return bool(size.near / nearest < least * (1.0 - DEPTH_MARGIN))


@compiled
def _coordinate(row: F64, box: F64) -> float:
    """Returns one coordinate of the transformed centre of a box, for one row of the matrix."""
    return float(row[0] * box[0] + row[1] * box[1] + row[2] * box[2] + row[3])
