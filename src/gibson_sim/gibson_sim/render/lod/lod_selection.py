"""What ``visibility``, ``planning`` and ``solids`` do in NumPy, as loops that are compiled: for the few hundred chunks of a picture NumPy's calls
take far longer than the arithmetic. Results are equal, to the bit (the tests compare them).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import compiled

B1 = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]


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


class Solids(NamedTuple):
    """Boxes of closed solids, as ``Batches`` has them."""

    box: F64
    link: I64


class Rules(NamedTuple):
    """What decides where chunks come in the order of drawing."""

    batch_of: I64
    """(C,), batch of each chunk."""
    cut: B1
    """(B,), whether a batch may have holes."""
    has_solid: B1
    """(C,), whether something of a chunk may be solid."""
    has_back: B1
    """(C,), whether something may shine through it."""
    table: U32
    """(C, 5), the draw of each chunk, ``planning.draw_table``."""


@compiled
def world_from_links(positions: F64, quats_xyzw: F64) -> F64:
    """Returns ``visibility.world_from_links``."""
    T = np.zeros((len(positions) + 1, 4, 4))
    for i in range(3):
        T[0, i, i] = 1.0
    for k in range(len(positions)):
        x, y, z, w = quats_xyzw[k, 0], quats_xyzw[k, 1], quats_xyzw[k, 2], quats_xyzw[k, 3]
        M = T[k + 1]
        M[0, 0], M[0, 1], M[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
        M[1, 0], M[1, 1], M[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
        M[2, 0], M[2, 1], M[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
        for i in range(3):
            M[i, 3] = positions[k, i]
    for k in range(len(T)):
        T[k, 3, 3] = 1.0
    return T


@compiled
def link_frames(T_world_camera: F64, T_world_links: F64) -> tuple[F64, F64]:
    """Returns ``visibility.link_frames``."""
    T, eyes, C = np.zeros((len(T_world_links), 4, 4)), np.empty((len(T_world_links), 3)), T_world_camera
    for k in range(len(T_world_links)):
        W = T_world_links[k]
        for i in range(3):
            for j in range(4):
                T[k, i, j] = C[0, i] * W[0, j] + C[1, i] * W[1, j] + C[2, i] * W[2, j]
            T[k, i, 3] -= C[0, i] * C[0, 3] + C[1, i] * C[1, 3] + C[2, i] * C[2, 3]
            eyes[k, i] = W[0, i] * (C[0, 3] - W[0, 3]) + W[1, i] * (C[1, 3] - W[1, 3]) + W[2, i] * (C[2, 3] - W[2, 3])
        T[k, 3, 3] = 1.0
    return T, eyes


@compiled
def planes_of_links(planes: F64, T_camera_links: F64, count: int) -> F64:
    """Returns ``visibility.planes_of_links`` of the first ``count`` links."""
    found = np.empty((count, len(planes), 4))
    for k in range(count):
        T = T_camera_links[k]
        for p in range(len(planes)):
            for j in range(4):
                found[k, p, j] = planes[p, 0] * T[0, j] + planes[p, 1] * T[1, j] + planes[p, 2] * T[2, j] + planes[p, 3] * T[3, j]
    return found


@compiled
def planned(
    eyes: F64,
    T_camera_links: F64,
    planes: F64,
    near_corners: F64,
    detail: Detail,
    groups: Groups,
    chunks: Chunks,
    link_box: F64,
    solids: Solids,
    rules: Rules,
    near_part: float,
) -> tuple[I64, U32, I64, int, I64, int, bool]:
    """Returns what ``planning.Plan`` holds of a picture: chunks, draws, batch, solid, near, triangles and fronts.

    Args:
        eyes: (L, 3), the eye in the world and in each link, metres.
        T_camera_links: (L, 4, 4), optical frame from each of these.
        planes: (P, 4), of the image, optical frame; P = 0: nothing is outside.
        near_corners: (4, 3), of the picture at its near distance, optical frame, metres.
        detail: how coarse chunks may be.
        groups: of chunks.
        chunks: all of them.
        link_box: as for ``chosen``.
        solids: all of them.
        rules: of the order.
        near_part: as for ``drawing_order``.
    """
    inside, far = chosen(eyes, groups, chunks, link_box, planes_of_links(planes, T_camera_links, len(link_box)), detail)
    nearest = inside[np.argsort(far, kind="mergesort")]
    every, solid, near, total = drawing_order(nearest, rules, near_part)
    drawn, batch, draws = np.empty(len(every), np.int64), np.empty(len(every), np.int64), np.empty((len(every), 5), np.uint32)
    for i in range(len(every)):
        drawn[i] = nearest[every[i]]
        batch[i] = rules.batch_of[drawn[i]]
        for k in range(5):
            draws[i, k] = rules.table[drawn[i], k]
    fronts = not begins_inside(solids, eyes, T_camera_links, near_corners)
    return drawn, draws, batch, solid, near, total, fronts


@compiled
def by_kind(chunks: I64, table: U32, batch_of: I64, kind_of: I64, kinds: int) -> tuple[U32, I64]:
    """Returns ``planning.by_kind``."""
    first, kept = np.zeros(kinds + 1, dtype=np.int64), 0
    for chunk in chunks:
        if table[chunk, 0] > 0:
            first[kind_of[batch_of[chunk]] + 1] += 1
            kept += 1
    count = first[1:].copy()
    for k in range(kinds):
        first[k + 1] += first[k]
    draws = np.empty((kept, 5), dtype=np.uint32)
    for chunk in chunks:
        if table[chunk, 0] > 0:
            kind = kind_of[batch_of[chunk]]
            for k in range(5):
                draws[first[kind], k] = table[chunk, k]
            first[kind] += 1
    return draws, count


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
def begins_inside(solids: Solids, eyes: F64, T_camera_links: F64, near_corners: F64) -> bool:
    """Returns whether any box touches the near rectangle of a picture; the arguments are those of ``solids.Insides``."""
    boxes, links, reach = solids.box, solids.link, 0.0
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
def drawing_order(chunks: I64, rules: Rules, near_part: float) -> tuple[I64, int, I64, int]:
    """Returns what ``planning.Planner`` needs to know of chunks that come the nearest first.

    Returns:
        The place in ``chunks`` of each draw; how many of them, the first ones, are solid; the nearest chunks without holes, about
        ``near_part`` of all triangles; and the number of all triangles.
    """
    batch_of, cut, has_solid, has_back, table = rules
    n, total = len(chunks), 0
    first, size = np.full(len(cut), -1, dtype=np.int64), np.zeros(len(cut), dtype=np.int64)
    for i in range(n - 1, -1, -1):
        batch = batch_of[chunks[i]]
        first[batch] = i
        if has_solid[chunks[i]]:
            size[batch] += 1
        total += int(table[chunks[i], 0])
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
        indices += int(table[chunks[i], 0])
        if indices // 3 >= total * near_part:
            break
        if not cut[batch_of[chunks[i]]]:
            near[kept] = chunks[i]
            kept += 1
    return every[:drawn], solid, near[:kept], total
