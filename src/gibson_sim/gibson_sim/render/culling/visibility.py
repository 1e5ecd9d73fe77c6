"""Selects the clusters that one picture draws: level-of-detail selection, frustum culling, sorting by distance.

In NumPy, level-of-detail selection takes time proportional to the number of cluster groups, the rest to the number of selected clusters.
Sums are written out, so that they are added in the same order as in the compiled loops.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, fixed
from gibson_sim.geometry.transforms import Mat4, matrices_from_poses
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.lod import lod_selection
from gibson_sim.render.lod.lod_selection import ClusterTable, DetailLimits, GroupTable

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Visibility:
    """Selects clusters of one scene."""

    def __init__(self, geometry: SceneGeometry) -> None:
        self._geometry = geometry
        batch_of = np.zeros(len(geometry.cluster_first), dtype=np.int64)
        for k, batch in enumerate(geometry.batches):
            batch_of[batch.first_cluster : batch.end_cluster] = k
        self.batch_of = batch_of
        """(C,), batch of each cluster."""
        self._finest = np.flatnonzero(geometry.cluster_group < 0)
        self._group_moves = bool((geometry.group_link > 0).any())
        self._cluster_moves = bool((geometry.cluster_link > 0).any())
        self.link_box = fixed(_link_boxes(geometry.cluster_link, geometry.cluster_box))
        """(L', 6), bounding box of the clusters of each link, the world first; L' may be less than the number of links."""
        b = geometry
        self.groups = GroupTable(fixed(b.group_error), fixed(b.group_box), fixed(b.group_link))
        """All cluster groups, for the compiled loops."""
        self.clusters = ClusterTable(
            fixed(b.cluster_group), fixed(b.cluster_next_group), fixed(b.cluster_box), fixed(b.cluster_link)
        )
        """All clusters, for the compiled loops."""

    def select(self, eyes: F64, detail: DetailLimits) -> I64:
        """Returns the clusters, ascending, that represent all triangles seen from an eye.

        Args:
            eyes: (L + 1, 3), the eye in the world, then in each link, metres.
            detail: limits of the level of detail.
        """
        b = self._geometry
        if not (detail.focal_px > 0.0 and detail.largest_error_px > 0.0) or not len(b.group_error):
            return self._finest
        eye = eyes[b.group_link] if self._group_moves else eyes[0]
        distance = np.maximum(_distances(eye, b.group_box), detail.near)
        small = np.empty(len(b.group_error) + 1, dtype=bool)
        small[:-1] = b.group_error * detail.focal_px <= detail.largest_error_px * distance
        # Index -1 is no group: a missing coarser group is never accurate enough, and the finest clusters always are.
        small[-1] = False
        fine = small[b.cluster_group] | (b.cluster_group < 0)
        return np.flatnonzero(fine & ~small[b.cluster_next_group])

    def select_for_error(self, largest_error: float) -> I64:
        """Returns the clusters, ascending, that represent all triangles with a geometric error of at most ``largest_error`` metres."""
        b = self._geometry
        small = np.append(b.group_error <= largest_error, False)
        fine = small[b.cluster_group] | (b.cluster_group < 0)
        return np.flatnonzero(fine & ~small[b.cluster_next_group])

    def bounds(self, T_world_links: F64) -> F64:
        """Returns the bounding box of the scene, (2, 3), minimum and maximum corner, world frame, metres."""
        box = self._geometry.cluster_box[self._finest]
        if not len(box):
            return np.zeros((2, 3))
        centre, half = box[:, :3], box[:, 3:]
        if self._cluster_moves:
            T = T_world_links[self._geometry.cluster_link[self._finest]]
            centre = np.einsum("cij,cj->ci", T[:, :3, :3], centre) + T[:, :3, 3]
            half = np.einsum("cij,cj->ci", np.abs(T[:, :3, :3]), half)
        return np.stack([(centre - half).min(axis=0), (centre + half).max(axis=0)])

    def nearest_first(self, eyes: F64, detail: DetailLimits, planes: F64, T_camera_links: F64) -> I64:
        """Returns the clusters that represent all triangles inside the image, nearest first.

        Args:
            eyes: (L + 1, 3), the eye in the world, then in each link, metres.
            detail: limits of the level of detail.
            planes: (P, 4), optical frame: a point x is inside where ``planes @ (x, 1) >= 0`` for all.
            T_camera_links: (L + 1, 4, 4): optical frame from the world, then from each link.
        """
        clusters = self.select(eyes, detail)
        clusters = clusters[self._inside(clusters, planes_of_links(planes, T_camera_links[: len(self.link_box)]))]
        eye = eyes[self._geometry.cluster_link[clusters]] if self._cluster_moves else eyes[0]
        return clusters[np.argsort(_distances(eye, self._geometry.cluster_box[clusters]), kind="stable")]

    def _inside(self, clusters: I64, planes: F64) -> NDArray[np.bool_]:
        """Returns a mask of the clusters at least partly in front of all planes, (L + 1, P, 4), of the world and of each link."""
        box, link = self._geometry.cluster_box[clusters], self._geometry.cluster_link[clusters]
        if not self._cluster_moves:
            return _in_front_of(planes[0], box)
        # Few links are in the image: clusters of other links need no test.
        link_inside = _in_front_of(planes, self.link_box)[link]
        static, moving = np.flatnonzero(link == 0), np.flatnonzero(link_inside & (link > 0))
        inside = np.zeros(len(clusters), dtype=bool)
        inside[static] = _in_front_of(planes[0], box[static])
        inside[moving] = _in_front_of(planes[link[moving]], box[moving])
        return inside


def _link_boxes(link: I64, box: F64) -> F64:
    """Returns the bounding box of all boxes of each link, (L + 1, 6), centre and half extents; zero for a link without boxes."""
    low, high = (np.full((int(link.max(initial=0)) + 1, 3), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, link, box[:, :3] - box[:, 3:])
    np.maximum.at(high, link, box[:, :3] + box[:, 3:])
    empty = low[:, 0] > high[:, 0]
    low[empty], high[empty] = 0.0, 0.0
    return np.hstack([(low + high) / 2, (high - low) / 2])


def _distances(eye: F64, boxes: F64) -> F64:
    """Returns the distances, (N,), of boxes, (N, 6), from one eye, (3,), or from one eye for each box, (N, 3); metres."""
    gap = np.maximum(np.abs(eye - boxes[:, :3]) - boxes[:, 3:], 0.0)
    x, y, z = gap[:, 0], gap[:, 1], gap[:, 2]
    distances: F64 = np.sqrt(x * x + y * y + z * z)
    return distances


def _in_front_of(planes: F64, boxes: F64) -> NDArray[np.bool_]:
    """Returns a mask, (N,), of the boxes, (N, 6), at least partly in front of all planes, (P, 4), or (N, P, 4) for a set per box."""
    (x, y, z, d), (cx, cy, cz, hx, hy, hz) = np.moveaxis(planes, -1, 0), boxes.T[:, :, None]
    reach = x * cx + y * cy + z * cz + (np.abs(x) * hx + np.abs(y) * hy + np.abs(z) * hz) + d
    return np.asarray((reach >= 0.0).all(axis=1))


def world_from_links(positions: F64, quats_xyzw: F64, *, loops: bool = CAN_COMPILE) -> F64:
    """Returns T_world_links, (L + 1, 4, 4): the identity for the world, then the transform of every link.

    Args:
        positions: (L, 3), positions of links, metres.
        quats_xyzw: (L, 4), unit quaternions.
        loops: use compiled loops.
    """
    if loops:
        return lod_selection.world_from_links(fixed(positions), fixed(quats_xyzw))
    return np.concatenate([np.eye(4)[None], matrices_from_poses(positions, quats_xyzw)])


def link_frames(T_world_camera: Mat4, T_world_links: F64, *, loops: bool = CAN_COMPILE) -> tuple[F64, F64]:
    """Returns T_camera_links, (L, 4, 4), and the eye in each link, (L, 3).

    Args:
        T_world_camera: (4, 4).
        T_world_links: (L, 4, 4).
        loops: use compiled loops.
    """
    if loops:
        return lod_selection.link_frames(fixed(T_world_camera), fixed(T_world_links))
    (a, b, c), t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    W = T_world_links
    T_camera_links = np.zeros_like(W)
    T_camera_links[:, :3] = a[:, None] * W[:, 0, None] + b[:, None] * W[:, 1, None] + c[:, None] * W[:, 2, None]
    T_camera_links[:, :3, 3] -= a * t[0] + b * t[1] + c * t[2]
    T_camera_links[:, 3, 3] = 1.0
    x, y, z = (t[k] - W[:, k, 3, None] for k in range(3))
    eyes = W[:, 0, :3] * x + W[:, 1, :3] * y + W[:, 2, :3] * z
    return T_camera_links, eyes


def planes_of_links(planes: F64, T_camera_links: F64) -> F64:
    """Returns planes, (P, 4), optical frame, in the frame of each link, (L, P, 4)."""
    a, b, c, d = (planes[:, k, None] for k in range(4))
    x, y, z, w = (T_camera_links[:, None, k] for k in range(4))
    link_planes: F64 = a * x + b * y + c * z + d * w
    return link_planes
