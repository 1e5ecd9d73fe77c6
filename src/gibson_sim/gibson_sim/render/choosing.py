"""What ``visibility``, ``planning``, ``pieces``, ``occlusion`` and ``solids`` do in NumPy, as loops that are compiled: for the few hundred
chunks of a picture NumPy's calls take far longer than the arithmetic. Results are equal, to the bit (the tests compare them), but for what is called
hidden: there they may differ by a rounding, where no pixel depends on it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import compiled

B1 = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]
SQUARE = 8
"""Side of the smallest squares of a pyramid of depths, pixels."""
MARGIN = 1e-5
"""Part by which a box must lie deeper than what hides it, since depths are rounded."""


class Detail(NamedTuple):
    """How coarse a chunk may be."""

    focal_px: float
    """Pixels a metre covers at 1 m; 0 = draw the finest."""
    largest_error_px: float
    """How far, pixels, a surface may be from where it is; 0 = draw the finest."""
    near: float
    """Metres; nothing counts as nearer than this."""


class Groups(NamedTuple):
    """Groups of chunks, as ``Batches`` has them."""

    error: F64
    box: F64
    link: I64


class Chunks(NamedTuple):
    """Chunks, as ``Batches`` has them."""

    group: I64
    next_group: I64
    box: F64
    link: I64


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
def chosen(eyes: F64, groups: Groups, chunks: Chunks, link_box: F64, planes: F64, detail: Detail) -> tuple[I64, F64]:
    """Returns the chunks, ascending, that stand for all triangles inside an image, (N,), and how far they are, (N,), metres.

    Args:
        eyes: (L, 3), the eye in the world and in each link, metres.
        groups: of chunks.
        chunks: all of them.
        link_box: (L', 6), box about what each link has; L' is at most L.
        planes: (L', P, 4), of the image in the frame of the world and of each link; P = 0: nothing is outside.
        detail: how coarse they may be.
    """
    count, sides = len(chunks.group), planes.shape[1]
    detailed = len(groups.error) > 0 and detail.focal_px > 0.0 and detail.largest_error_px > 0.0
    small = np.zeros(len(groups.error), dtype=np.bool_)
    if detailed:
        for g in range(len(groups.error)):
            distance = max(_distance(eyes[groups.link[g]], groups.box[g]), detail.near)
            small[g] = groups.error[g] * detail.focal_px <= detail.largest_error_px * distance
    link_inside = np.ones(len(link_box), dtype=np.bool_)
    for k in range(1, len(link_box)):
        link_inside[k] = _reaches(planes[k], sides, link_box[k])
    found, far, n = np.empty(count, dtype=np.int64), np.empty(count), 0
    for c in range(count):
        group, after, link = chunks.group[c], chunks.next_group[c], chunks.link[c]
        if group >= 0 and not (detailed and small[group]):
            continue
        if detailed and after >= 0 and small[after]:
            continue
        if not link_inside[link] or not _reaches(planes[link], sides, chunks.box[c]):
            continue
        found[n], far[n] = c, _distance(eyes[link], chunks.box[c])
        n += 1
    return found[:n], far[:n]


@compiled
def _distance(eye: F64, box: F64) -> float:
    x = max(abs(eye[0] - box[0]) - box[3], 0.0)
    y = max(abs(eye[1] - box[1]) - box[4], 0.0)
    z = max(abs(eye[2] - box[2]) - box[5], 0.0)
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def _reaches(planes: F64, sides: int, box: F64) -> bool:
    """Returns whether a box lies before all planes, or touches them."""
    for k in range(sides):
        x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
        middle = x * box[0] + y * box[1] + z * box[2]
        if middle + (abs(x) * box[3] + abs(y) * box[4] + abs(z) * box[5]) + planes[k, 3] < 0.0:
            return False
    return True


@compiled
def begins_inside(boxes: F64, links: I64, eyes: F64, T_camera_links: F64, near_corners: F64) -> bool:
    """Returns whether any box touches the near rectangle of a picture; the arguments are those of ``solids.Insides``."""
    reach = 0.0
    for c in range(4):
        x, y, z = near_corners[c, 0], near_corners[c, 1], near_corners[c, 2]
        reach = max(reach, np.sqrt(x * x + y * y + z * z))
    for k in range(len(links)):
        box, eye = boxes[k], eyes[links[k]]
        if (
            abs(eye[0] - box[0]) > box[3] + reach
            or abs(eye[1] - box[1]) > box[4] + reach
            or abs(eye[2] - box[2]) > box[5] + reach
        ):
            continue
        T, touched = T_camera_links[links[k]], True
        for axis in range(3):
            low, high = np.inf, -np.inf
            for c in range(4):
                at = 0.0
                for i in range(3):
                    at += (near_corners[c, i] - T[i, 3]) * T[i, axis]
                low, high = min(low, at), max(high, at)
            touched = touched and low <= box[axis] + box[3 + axis] and high >= box[axis] - box[3 + axis]
        if touched:
            return True
    return False


@compiled
def drawing_order(
    chunks: I64, batch_of: I64, cut: B1, has_solid: B1, has_back: B1, chunk_count: U32, near_part: float
) -> tuple[I64, int, I64, int]:
    """Returns what ``planning.Planner`` needs to know of chunks that come the nearest first.

    Returns:
        The place in ``chunks`` of each draw; how many of them, the first ones, are solid; the nearest chunks without holes, about
        ``near_part`` of all triangles; and the number of all triangles.
    """
    n, total = len(chunks), 0
    first, size = np.full(len(cut), -1, dtype=np.int64), np.zeros(len(cut), dtype=np.int64)
    for i in range(n - 1, -1, -1):
        batch = batch_of[chunks[i]]
        first[batch] = i
        if has_solid[chunks[i]]:
            size[batch] += 1
        total += int(chunk_count[chunks[i]])
    total //= 3
    # The order of batches is that of their first chunk, but what has holes comes after what has none.
    begin, drawn = np.zeros(len(cut), dtype=np.int64), 0
    for with_holes in (False, True):
        for i in range(n):
            batch = batch_of[chunks[i]]
            if first[batch] == i and cut[batch] == with_holes:
                begin[batch] = drawn
                drawn += size[batch]
    every, near, indices, kept = np.empty(2 * n, dtype=np.int64), np.empty(n, dtype=np.int64), 0, 0
    for i in range(n):
        if has_solid[chunks[i]]:
            batch = batch_of[chunks[i]]
            every[begin[batch]] = i
            begin[batch] += 1
    solid = drawn
    for i in range(n - 1, -1, -1):
        if has_back[chunks[i]]:
            every[drawn] = i
            drawn += 1
    for i in range(n):
        indices += int(chunk_count[chunks[i]])
        if indices // 3 >= total * near_part:
            break
        if not cut[batch_of[chunks[i]]]:
            near[kept] = chunks[i]
            kept += 1
    return every[:drawn], solid, near[:kept], total


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
    for v in range(height):
        row = v // SQUARE * columns
        for u in range(width):
            at = row + u // SQUARE
            if depth[v, u] < values[at]:
                values[at] = depth[v, u]
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
    chunks: I64,
    batch: I64,
    draws: U32,
    solid: int,
    pieces: PieceTable,
    chunk_link: I64,
    pixels_from_links: F64,
    shown: Shown,
    pyramid: Levels,
) -> tuple[I64, I64, U32, int]:
    """Returns the draws of the pieces of chunks that may be seen, those made one that follow each other.

    Args:
        chunks: (N,), as ``planning.Plan`` has them.
        batch: (N,), likewise.
        draws: (N, 5), likewise.
        solid: how many of them, likewise.
        pieces: of these chunks, and perhaps of others.
        chunk_link: (C,), of all chunks.
        pixels_from_links: (L, 3, 4), as ``occlusion.pixels_from_links`` returns them.
        shown: the picture.
        pyramid: of what has been drawn of it.

    Returns:
        Chunk, batch and draw of each, and how many of them are solid.
    """
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
    centre, half = np.empty(3), np.empty((3, 3))
    for k in range(3):
        centre[k] = matrix[k, 0] * box[0] + matrix[k, 1] * box[1] + matrix[k, 2] * box[2] + matrix[k, 3]
        for j in range(3):
            half[k, j] = matrix[k, j] * box[3 + j]
    nearest = centre[2] - abs(half[2, 0]) - abs(half[2, 1]) - abs(half[2, 2])
    if not nearest > shown.near:
        return False
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(8):
        x, y, z = (1.0 if corner & 1 else -1.0), (1.0 if corner & 2 else -1.0), (1.0 if corner & 4 else -1.0)
        depth = centre[2] + half[2, 0] * x + half[2, 1] * y + half[2, 2] * z
        u = (centre[0] + half[0, 0] * x + half[0, 1] * y + half[0, 2] * z) / depth
        v = (centre[1] + half[1, 0] * x + half[1, 1] * y + half[1, 2] * z) / depth
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    left, right, top, bottom = np.floor(left), np.ceil(right), np.floor(top), np.ceil(bottom)
    if right < 0 or bottom < 0 or left >= shown.width or top >= shown.height:
        return True
    x0, x1 = int(max(left, 0.0)) // SQUARE, int(min(right, shown.width - 1.0)) // SQUARE
    y0, y1 = int(max(top, 0.0)) // SQUARE, int(min(bottom, shown.height - 1.0)) // SQUARE
    # The level at which the rectangle touches two squares a side at most.
    level, reach = 0, max(x1 - x0, y1 - y0) - 1
    while reach > 0 and level < len(pyramid.widths) - 1:
        level += 1
        reach >>= 1
    upper = pyramid.firsts[level] + (y0 >> level) * pyramid.widths[level]
    lower = pyramid.firsts[level] + (y1 >> level) * pyramid.widths[level]
    left_column, right_column, values = x0 >> level, x1 >> level, pyramid.values
    least = min(
        min(values[upper + left_column], values[upper + right_column]),
        min(values[lower + left_column], values[lower + right_column]),
    )
    return bool(shown.near / nearest < least * (1.0 - MARGIN))
