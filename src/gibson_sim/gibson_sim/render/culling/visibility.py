"""Which chunks of a scene to draw for one picture, and in which order: detail, frustum, distance.

In NumPy the cost follows the number of groups of chunks for the choice of detail, and what was chosen for all that comes after. Sums are
written out, so that their order is that of the compiled loops.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.compiling import CAN_COMPILE, fixed
from gibson_sim.geometry.transforms import Mat4, matrices_from_poses
from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.lod import lod_selection
from gibson_sim.render.lod.lod_selection import Chunks, Detail, Groups

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Visibility:
    """Chooses chunks of one scene."""

    def __init__(self, batches: Batches) -> None:
        self._b = batches
        batch_of = np.zeros(len(batches.chunk_first), dtype=np.int64)
        for k, batch in enumerate(batches.batches):
            batch_of[batch.first_chunk : batch.end_chunk] = k
        self.batch_of = batch_of
        """(C,), batch of each chunk."""
        self._finest = np.flatnonzero(batches.chunk_group < 0)
        self._group_moves = bool((batches.group_link > 0).any())
        self._chunk_moves = bool((batches.chunk_link > 0).any())
        self.link_box = fixed(_link_boxes(batches.chunk_link, batches.chunk_box))
        """(L', 6), box about what each link has, the world first; L' may be less than the links are."""
        b = batches
        self.groups = Groups(fixed(b.group_error), fixed(b.group_box), fixed(b.group_link))
        """All groups, as loops take them."""
        self.chunks = Chunks(fixed(b.chunk_group), fixed(b.chunk_next_group), fixed(b.chunk_box), fixed(b.chunk_link))
        """All chunks, as loops take them."""

    def choose(self, eyes: F64, detail: Detail) -> I64:
        """Returns the chunks, ascending, that stand for all triangles at a distance.

        Args:
            eyes: (L + 1, 3), the eye in the world, then in each link, metres.
            detail: how coarse they may be.
        """
        b = self._b
        if not (detail.focal_px > 0.0 and detail.largest_error_px > 0.0) or not len(b.group_error):
            return self._finest
        eye = eyes[b.group_link] if self._group_moves else eyes[0]
        distance = np.maximum(_distances(eye, b.group_box), detail.near)
        small = np.empty(len(b.group_error) + 1, dtype=bool)
        small[:-1] = b.group_error * detail.focal_px <= detail.largest_error_px * distance
        # Index -1: no coarser group is never good enough, and the finest chunks always are.
        small[-1] = False
        fine = small[b.chunk_group] | (b.chunk_group < 0)
        return np.flatnonzero(fine & ~small[b.chunk_next_group])

    def choose_for(self, largest_error: float) -> I64:
        """Returns the chunks, ascending, that stand for all triangles where surfaces may be so far off, metres."""
        b = self._b
        small = np.append(b.group_error <= largest_error, False)
        fine = small[b.chunk_group] | (b.chunk_group < 0)
        return np.flatnonzero(fine & ~small[b.chunk_next_group])

    def bounds(self, T_world_links: F64) -> F64:
        """Returns the box of everything, (2, 3), world frame, metres."""
        box = self._b.chunk_box[self._finest]
        if not len(box):
            return np.zeros((2, 3))
        centre, half = box[:, :3], box[:, 3:]
        if self._chunk_moves:
            T = T_world_links[self._b.chunk_link[self._finest]]
            centre = np.einsum("cij,cj->ci", T[:, :3, :3], centre) + T[:, :3, 3]
            half = np.einsum("cij,cj->ci", np.abs(T[:, :3, :3]), half)
        return np.stack([(centre - half).min(axis=0), (centre + half).max(axis=0)])

    def nearest_first(self, eyes: F64, detail: Detail, planes: F64, T_camera_links: F64) -> I64:
        """Returns the chunks that stand for all triangles inside the image, the nearest first.

        Args:
            eyes: (L + 1, 3), the eye in the world, then in each link, metres.
            detail: how coarse they may be.
            planes: (P, 4), optical frame: a point x is inside where ``planes @ (x, 1) >= 0`` for all.
            T_camera_links: (L + 1, 4, 4): optical frame from the world, then from each link.
        """
        chunks = self.choose(eyes, detail)
        chunks = chunks[self._inside(chunks, planes_of_links(planes, T_camera_links[: len(self.link_box)]))]
        eye = eyes[self._b.chunk_link[chunks]] if self._chunk_moves else eyes[0]
        return chunks[np.argsort(_distances(eye, self._b.chunk_box[chunks]), kind="stable")]

    def _inside(self, chunks: I64, planes: F64) -> NDArray[np.bool_]:
        """Returns which of the chunks may be before all planes, (L + 1, P, 4), of the world and of each link."""
        box, link = self._b.chunk_box[chunks], self._b.chunk_link[chunks]
        if not self._chunk_moves:
            return _before(planes[0], box)
        # Few links are in the image: what belongs to the others need not be looked at.
        near = _before(planes, self.link_box)[link]
        still, moving = np.flatnonzero(link == 0), np.flatnonzero(near & (link > 0))
        inside = np.zeros(len(chunks), dtype=bool)
        inside[still] = _before(planes[0], box[still])
        inside[moving] = _before(planes[link[moving]], box[moving])
        return inside


def _link_boxes(link: I64, box: F64) -> F64:
    """Returns the box about all boxes of each link, (L + 1, 6), centre and half the size; those of links without any are nowhere."""
    low, high = (np.full((int(link.max(initial=0)) + 1, 3), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, link, box[:, :3] - box[:, 3:])
    np.maximum.at(high, link, box[:, :3] + box[:, 3:])
    empty = low[:, 0] > high[:, 0]
    low[empty], high[empty] = 0.0, 0.0
    return np.hstack([(low + high) / 2, (high - low) / 2])


def _distances(eye: F64, boxes: F64) -> F64:
    """Returns how far boxes, (N, 6), are from an eye, (3,), or from one each, (N, 3); metres."""
    gap = np.maximum(np.abs(eye - boxes[:, :3]) - boxes[:, 3:], 0.0)
    x, y, z = gap[:, 0], gap[:, 1], gap[:, 2]
    distances: F64 = np.sqrt(x * x + y * y + z * z)
    return distances


def _before(planes: F64, boxes: F64) -> NDArray[np.bool_]:
    """Returns which boxes, (N, 6), lie before all planes, (P, 4) or of each box (N, P, 4), or touch them, (N,)."""
    (x, y, z, d), (cx, cy, cz, hx, hy, hz) = np.moveaxis(planes, -1, 0), boxes.T[:, :, None]
    reach = x * cx + y * cy + z * cz + (np.abs(x) * hx + np.abs(y) * hy + np.abs(z) * hz) + d
    return np.asarray((reach >= 0.0).all(axis=1))


def world_from_links(positions: F64, quats_xyzw: F64, *, loops: bool = CAN_COMPILE) -> F64:
    """Returns T_world_links, (L + 1, 4, 4): the identity for the world itself, then every link.

    Args:
        positions: (L, 3), of links, metres.
        quats_xyzw: (L, 4), unit.
        loops: by compiled loops.
    """
    if loops:
        return lod_selection.world_from_links(fixed(positions), fixed(quats_xyzw))
    return np.concatenate([np.eye(4)[None], matrices_from_poses(positions, quats_xyzw)])


def link_frames(T_world_camera: Mat4, T_world_links: F64, *, loops: bool = CAN_COMPILE) -> tuple[F64, F64]:
    """Returns T_camera_links, (L, 4, 4), and the eye in each link, (L, 3).

    Args:
        T_world_camera: (4, 4).
        T_world_links: (L, 4, 4).
        loops: by compiled loops.
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
    """Returns planes, (P, 4), optical frame, as each link sees them, (L, P, 4)."""
    a, b, c, d = (planes[:, k, None] for k in range(4))
    x, y, z, w = (T_camera_links[:, None, k] for k in range(4))
    found: F64 = a * x + b * y + c * z + d * w
    return found
