"""What ``pieces`` and ``occlusion`` do in NumPy, as loops that are compiled: which parts of a plan are hidden behind a depth image.

What is called hidden may differ by a rounding from what NumPy says, where no pixel depends on it.
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
SQUARE = 8
"""Side of the smallest squares of a pyramid of depths, pixels."""
MARGIN = 1e-5
"""Part by which a box must lie deeper than what hides it, since depths are rounded."""


class PieceTable(NamedTuple):
    """Pieces of chunks, as ``Pieces`` has them."""

    row: I64
    number: I64
    box: F64
    span: U32


class Shown(NamedTuple):
    """A picture."""

    width: float
    """Pixels."""
    height: float
    near: float
    """Metres."""


class Levels(NamedTuple):
    """A pyramid of least values."""

    values: F32
    """Of all levels, one after the other."""
    firsts: I64
    """Where each level begins."""
    widths: I64
    """Columns of each level."""


@compiled
def depth_pyramid(depth: F32) -> Levels:
    """Returns the levels of ``occlusion.DepthPyramid`` for a depth image, (H, W)."""
    height, width = depth.shape
    rows, columns, size, levels = (height + SQUARE - 1) // SQUARE, (width + SQUARE - 1) // SQUARE, 1, 1
    r, c = rows, columns
    while r * c > 1:
        size += r * c
        r, c, levels = (r + 1) // 2, (c + 1) // 2, levels + 1
    values = np.full(size, np.inf, dtype=np.float32)
    firsts, widths = np.zeros(levels, dtype=np.int64), np.empty(levels, dtype=np.int64)
    widths[0] = columns
    least = np.empty(width, dtype=np.float32)  # of the rows of a square: whole rows are quick to go over
    for row in range(rows):
        top = row * SQUARE
        for u in range(width):
            least[u] = depth[top, u]
        for v in range(top + 1, min(top + SQUARE, height)):
            for u in range(width):
                least[u] = min(least[u], depth[v, u])
        for u in range(width):
            at = row * columns + u // SQUARE
            values[at] = min(values[at], least[u])
    for level in range(1, levels):
        finer, here, width = firsts[level - 1], firsts[level - 1] + rows * columns, (columns + 1) // 2
        for v in range(rows):
            for u in range(columns):
                at, value = here + v // 2 * width + u // 2, values[finer + v * columns + u]
                if value < values[at]:
                    values[at] = value
        firsts[level], widths[level], rows, columns = here, width, (rows + 1) // 2, width
    return Levels(values, firsts, widths)


@compiled
def without_hidden(
    depth: F32,
    chunks: I64,
    batch: I64,
    draws: U32,
    solid: int,
    pieces: PieceTable,
    chunk_link: I64,
    T_camera_links: F64,
    intrinsics: F64,
    near: float,
) -> tuple[I64, I64, U32, int]:
    """Returns the draws of the pieces of chunks that may be seen, those made one that follow each other.

    Args:
        depth: (H, W), what has been drawn of the picture, ``near / depth``, 0 = nothing.
        chunks: (N,), as ``planning.Plan`` has them.
        batch: (N,), likewise.
        draws: (N, 5), likewise.
        solid: how many of them, likewise.
        pieces: of these chunks, and perhaps of others.
        chunk_link: (C,), of all chunks.
        T_camera_links: (L, 4, 4), optical frame from the world and from each link.
        intrinsics: K, (3, 3), pixels.
        near: metres.

    Returns:
        Chunk, batch and draw of each, and how many of them are solid.
    """
    shown, pyramid = Shown(float(depth.shape[1]), float(depth.shape[0]), near), depth_pyramid(depth)
    pixels_from_links = np.empty((len(T_camera_links), 3, 4))
    for link in range(len(T_camera_links)):
        T = T_camera_links[link]
        for j in range(4):
            for i in range(2):
                pixels_from_links[link, i, j] = (
                    intrinsics[i, 0] * T[0, j] + intrinsics[i, 1] * T[1, j] + intrinsics[i, 2] * T[2, j]
                )
            pixels_from_links[link, 2, j] = T[2, j]
    most = 0
    for chunk in chunks:
        most += pieces.number[chunk]
    found_chunk, found_batch = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    found, n, solid_draws = np.empty((most, 5), dtype=np.uint32), 0, 0
    last = -1  # the draw that may go on
    for i in range(len(chunks)):
        if i == solid:
            last = -1
        chunk = chunks[i]
        matrix = pixels_from_links[chunk_link[chunk]]
        for row in range(pieces.row[chunk], pieces.row[chunk] + pieces.number[chunk]):
            if _hidden(pieces.box[row], matrix, shown, pyramid):
                continue
            count, first = pieces.span[row, 0], pieces.span[row, 1]
            if (
                last >= 0
                and first == found[last, 2] + found[last, 0]
                and draws[i, 4] == found[last, 4]
                and batch[i] == found_batch[last]
            ):
                found[last, 0] += count
                continue
            for k in range(5):
                found[n, k] = draws[i, k]
            found[n, 0], found[n, 2] = count, first
            found_chunk[n], found_batch[n], last = chunk, batch[i], n
            n += 1
        if i < solid:
            solid_draws = n
    return found_chunk[:n], found_batch[:n], found[:n], solid_draws


@compiled
def _hidden(box: F64, matrix: F64, shown: Shown, pyramid: Levels) -> bool:
    """Returns whether a box cannot be seen past what the pyramid holds, or lies beside the picture; what is not ahead is not hidden."""
    x, y, z = _place(matrix[0], box), _place(matrix[1], box), _place(matrix[2], box)
    x0, x1, x2 = matrix[0, 0] * box[3], matrix[0, 1] * box[4], matrix[0, 2] * box[5]
    y0, y1, y2 = matrix[1, 0] * box[3], matrix[1, 1] * box[4], matrix[1, 2] * box[5]
    z0, z1, z2 = matrix[2, 0] * box[3], matrix[2, 1] * box[4], matrix[2, 2] * box[5]
    nearest = z - abs(z0) - abs(z1) - abs(z2)
    if not nearest > shown.near:
        return False
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for a in (-1.0, 1.0):
        for b in (-1.0, 1.0):
            for c in (-1.0, 1.0):
                scale = 1.0 / (z + z0 * a + z1 * b + z2 * c)
                u, v = (x + x0 * a + x1 * b + x2 * c) * scale, (y + y0 * a + y1 * b + y2 * c) * scale
                left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    left, right, top, bottom = np.floor(left), np.ceil(right), np.floor(top), np.ceil(bottom)
    if right < 0 or bottom < 0 or left >= shown.width or top >= shown.height:
        return True
    first_column, last_column = int(max(left, 0.0)) // SQUARE, int(min(right, shown.width - 1.0)) // SQUARE
    first_row, last_row = int(max(top, 0.0)) // SQUARE, int(min(bottom, shown.height - 1.0)) // SQUARE
    # The level at which the rectangle touches two squares a side at most.
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
    return bool(shown.near / nearest < least * (1.0 - MARGIN))


@compiled
def _place(row: F64, box: F64) -> float:
    """Returns one coordinate of the middle of a box, by a row of a matrix."""
    return float(row[0] * box[0] + row[1] * box[1] + row[2] * box[2] + row[3])
