"""Compiled loops of ``visibility``, ``draw_plan`` and ``closed_surfaces``: level-of-detail selection, culling and draw order of clusters.

For the few hundred clusters of a picture, the overhead of NumPy's calls exceeds the arithmetic by far. Results are bit-identical to those
of the NumPy code (tests compare them).
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


class DetailLimits(NamedTuple):
    """Limits of the level of detail."""

    focal_px: float
    """Focal length, pixels; 0 = draw the finest level."""
    largest_error_px: float
    """Largest screen-space error of a surface, pixels; 0 = draw the finest level."""
    near: float
    """Minimum distance, metres: smaller distances are replaced by it."""


class GroupTable(NamedTuple):
    """Cluster groups: the arrays ``group_...`` of ``SceneGeometry``."""

    error: F64
    box: F64
    link: I64


class ClusterTable(NamedTuple):
    """Clusters: arrays ``cluster_...`` of ``SceneGeometry``."""

    group: I64
    next_group: I64
    box: F64
    link: I64


class ClosedSurfaceTable(NamedTuple):
    """Boxes of closed surfaces: the arrays ``closed_...`` of ``SceneGeometry``."""

    box: F64
    link: I64


class DrawOrderRules(NamedTuple):
    """Properties of clusters and batches that determine the draw order."""

    batch_of: I64
    """(C,), batch of each cluster."""
    has_holes: B1
    """(B,), whether a batch may have alpha-tested holes: its alpha mode is not opaque."""
    has_opaque: B1
    """(C,), whether a cluster may have opaque parts."""
    has_translucent: B1
    """(C,), whether a cluster may have translucent parts."""
    draws: U32
    """(C, 5), draw command of each cluster, see ``draw_plan.draw_table``."""


@compiled
def world_from_links(positions: F64, quats_xyzw: F64) -> F64:
    """Computes ``visibility.world_from_links``."""
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
    """Computes ``visibility.link_frames``."""
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
    """Computes ``visibility.planes_of_links`` for the first ``count`` links."""
    out = np.empty((count, len(planes), 4))
    for k in range(count):
        T = T_camera_links[k]
        for p in range(len(planes)):
            for j in range(4):
                out[k, p, j] = planes[p, 0] * T[0, j] + planes[p, 1] * T[1, j] + planes[p, 2] * T[2, j] + planes[p, 3] * T[3, j]
    return out


@compiled
def plan_picture(
    eyes: F64,
    T_camera_links: F64,
    planes: F64,
    near_corners: F64,
    detail: DetailLimits,
    groups: GroupTable,
    clusters: ClusterTable,
    link_box: F64,
    closed: ClosedSurfaceTable,
    rules: DrawOrderRules,
    near_part: float,
) -> tuple[I64, U32, I64, int, I64, int, bool]:
    """Returns the fields of a picture's ``draw_plan.DrawPlan``: clusters, draws, batch, opaque, near, triangles and cull_back_faces.

    Args:
        eyes: (L, 3), the eye in the world and in each link, metres.
        T_camera_links: (L, 4, 4), optical frame from each of these.
        planes: (P, 4), frustum planes, optical frame; P = 0 disables frustum culling.
        near_corners: (4, 3), corners of the near plane, optical frame, metres.
        detail: limits of the level of detail.
        groups: all cluster groups.
        clusters: all clusters.
        link_box: see ``select_clusters``.
        closed: all closed surfaces.
        rules: properties that determine the draw order.
        near_part: see ``draw_order``.
    """
    inside, distances = select_clusters(
        eyes, groups, clusters, link_box, planes_of_links(planes, T_camera_links, len(link_box)), detail
    )
    nearest = inside[np.argsort(distances, kind="mergesort")]
    order, opaque, near, total = draw_order(nearest, rules, near_part)
    drawn, batch, draws = np.empty(len(order), np.int64), np.empty(len(order), np.int64), np.empty((len(order), 5), np.uint32)
    for i in range(len(order)):
        drawn[i] = nearest[order[i]]
        batch[i] = rules.batch_of[drawn[i]]
        for k in range(5):
            draws[i, k] = rules.draws[drawn[i], k]
    cull_back_faces = not near_plane_touches(closed, eyes, T_camera_links, near_corners)
    return drawn, draws, batch, opaque, near, total, cull_back_faces


@compiled
def depth_draws(clusters: I64, table: U32, batch_of: I64, kind_of: I64, kinds: int) -> tuple[U32, I64]:
    """Computes ``draw_plan.DrawPlanner.depth_draws``."""
    first, kept = np.zeros(kinds + 1, dtype=np.int64), 0
    for cluster in clusters:
        if table[cluster, 0] > 0:
            first[kind_of[batch_of[cluster]] + 1] += 1
            kept += 1
    count = first[1:].copy()
    for k in range(kinds):
        first[k + 1] += first[k]
    draws = np.empty((kept, 5), dtype=np.uint32)
    for cluster in clusters:
        if table[cluster, 0] > 0:
            kind = kind_of[batch_of[cluster]]
            for k in range(5):
                draws[first[kind], k] = table[cluster, k]
            first[kind] += 1
    return draws, count


@compiled
def select_clusters(
    eyes: F64, groups: GroupTable, clusters: ClusterTable, link_box: F64, planes: F64, detail: DetailLimits
) -> tuple[I64, F64]:
    """Returns the clusters, ascending, that represent all triangles inside an image, (N,), and their distances, (N,), metres.

    Args:
        eyes: (L, 3), the eye in the world and in each link, metres.
        groups: all cluster groups.
        clusters: all clusters.
        link_box: (L', 6), bounding box of the clusters of each link; L' is at most L.
        planes: (L', P, 4), frustum planes in the frame of the world and of each link; P = 0 disables frustum culling.
        detail: limits of the level of detail.
    """
    count, sides = len(clusters.group), planes.shape[1]
    detailed = len(groups.error) > 0 and detail.focal_px > 0.0 and detail.largest_error_px > 0.0
    small = np.zeros(len(groups.error), dtype=np.bool_)
    if detailed:
        for g in range(len(groups.error)):
            distance = max(_distance(eyes[groups.link[g]], groups.box[g]), detail.near)
            small[g] = groups.error[g] * detail.focal_px <= detail.largest_error_px * distance
    link_inside = np.ones(len(link_box), dtype=np.bool_)
    for k in range(1, len(link_box)):
        link_inside[k] = _is_inside(planes[k], sides, link_box[k])
    selected, distances, n = np.empty(count, dtype=np.int64), np.empty(count), 0
    for c in range(count):
        group, next_group, link = clusters.group[c], clusters.next_group[c], clusters.link[c]
        if group >= 0 and not (detailed and small[group]):
            continue
        if detailed and next_group >= 0 and small[next_group]:
            continue
        if not link_inside[link] or not _is_inside(planes[link], sides, clusters.box[c]):
            continue
        selected[n], distances[n] = c, _distance(eyes[link], clusters.box[c])
        n += 1
    return selected[:n], distances[:n]


@compiled
def _distance(eye: F64, box: F64) -> float:
    x = max(abs(eye[0] - box[0]) - box[3], 0.0)
    y = max(abs(eye[1] - box[1]) - box[4], 0.0)
    z = max(abs(eye[2] - box[2]) - box[5], 0.0)
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def _is_inside(planes: F64, sides: int, box: F64) -> bool:
    """Returns whether a box is at least partly in front of every plane."""
    for k in range(sides):
        x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
        middle = x * box[0] + y * box[1] + z * box[2]
        if middle + (abs(x) * box[3] + abs(y) * box[4] + abs(z) * box[5]) + planes[k, 3] < 0.0:
            return False
    return True


@compiled
def near_plane_touches(closed: ClosedSurfaceTable, eyes: F64, T_camera_links: F64, near_corners: F64) -> bool:
    """Returns whether any box intersects the near plane of a picture; for the arguments see ``closed_surfaces.NearPlaneTest``."""
    boxes, links, reach = closed.box, closed.link, 0.0
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
                coordinate = 0.0
                for i in range(3):
                    coordinate += (near_corners[c, i] - T[i, 3]) * T[i, axis]
                low, high = min(low, coordinate), max(high, coordinate)
            touched = touched and low <= box[axis] + box[3 + axis] and high >= box[axis] - box[3 + axis]
        if touched:
            return True
    return False


@compiled
def draw_order(clusters: I64, rules: DrawOrderRules, near_part: float) -> tuple[I64, int, I64, int]:
    """Returns the draw order of clusters sorted nearest first.

    Returns:
        The position in ``clusters`` of each draw; the number of opaque draws, which come first; the nearest clusters without alpha-tested
        holes, about the fraction ``near_part`` of all triangles; and the number of all triangles.
    """
    batch_of, has_holes, has_opaque, has_translucent, table = rules
    n, total = len(clusters), 0
    first, size = np.full(len(has_holes), -1, dtype=np.int64), np.zeros(len(has_holes), dtype=np.int64)
    for i in range(n - 1, -1, -1):
        batch = batch_of[clusters[i]]
        first[batch] = i
        if has_opaque[clusters[i]]:
            size[batch] += 1
        total += int(table[clusters[i], 0])
    total //= 3
    # Batches are sorted by their nearest cluster; batches with alpha-tested holes come after the others.
    begin, drawn = np.zeros(len(has_holes), dtype=np.int64), 0
    for with_holes in (False, True):
        for i in range(n):
            batch = batch_of[clusters[i]]
            if first[batch] == i and has_holes[batch] == with_holes:
                begin[batch] = drawn
                drawn += size[batch]
    order, near, indices, kept = np.empty(2 * n, dtype=np.int64), np.empty(n, dtype=np.int64), 0, 0
    for i in range(n):
        if has_opaque[clusters[i]]:
            batch = batch_of[clusters[i]]
            order[begin[batch]] = i
            begin[batch] += 1
    opaque = drawn
    for i in range(n - 1, -1, -1):
        if has_translucent[clusters[i]]:
            order[drawn] = i
            drawn += 1
    for i in range(n):
        indices += int(table[clusters[i], 0])
        if indices // 3 >= total * near_part:
            break
        if not has_holes[batch_of[clusters[i]]]:
            near[kept] = clusters[i]
            kept += 1
    return order[:drawn], opaque, near[:kept], total
