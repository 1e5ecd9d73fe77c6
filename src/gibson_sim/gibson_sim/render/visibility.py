"""Which chunks of a scene to draw for one picture, and in which order: detail, frustum, distance. Pure numpy.

The cost follows the number of groups of chunks for the choice of detail, and what was chosen for all that comes after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4
from gibson_sim.render.batches import Batches

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Detail:
    """How coarse a chunk may be."""

    focal_px: float
    """Pixels a metre covers at 1 m; 0 = draw the finest."""
    largest_error_px: float
    """How far, pixels, a surface may be from where it is; 0 = draw the finest."""
    near: float
    """Metres; nothing counts as nearer than this."""


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
        self._link_box = _link_boxes(batches.chunk_link, batches.chunk_box)

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
        gap = np.maximum(np.abs(eye - b.group_box[:, :3]) - b.group_box[:, 3:], 0.0)
        distance = np.maximum(np.sqrt(np.einsum("gk,gk->g", gap, gap)), detail.near)
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

    def inside(self, chunks: I64, planes: F64, T_camera_links: F64) -> NDArray[np.bool_]:
        """Returns which of the chunks may be in the image, (N,).

        Args:
            chunks: (N,).
            planes: (P, 4), optical frame: a point x is inside where ``planes @ (x, 1) >= 0`` for all.
            T_camera_links: (L + 1, 4, 4): optical frame from the world, then from each link.
        """
        box, link = self._b.chunk_box[chunks], self._b.chunk_link[chunks]
        p = planes @ T_camera_links[0]
        if not self._chunk_moves:
            return _before(p, box)
        # Few links are in the image: what belongs to the others need not be looked at.
        of_links = planes @ T_camera_links[: len(self._link_box)]
        near = _each_before(of_links, self._link_box)[link]
        still, moving = np.flatnonzero(link == 0), np.flatnonzero(near & (link > 0))
        inside = np.zeros(len(chunks), dtype=bool)
        inside[still] = _before(p, box[still])
        inside[moving] = _each_before(of_links[link[moving]], box[moving])
        return inside

    def distances(self, chunks: I64, eyes: F64) -> F64:
        """Returns how far the box of each chunk is from the eye, (N,), metres."""
        box = self._b.chunk_box[chunks]
        eye = eyes[self._b.chunk_link[chunks]] if self._chunk_moves else eyes[0]
        gap = np.maximum(np.abs(eye - box[:, :3]) - box[:, 3:], 0.0)
        distance: F64 = np.sqrt(np.einsum("ck,ck->c", gap, gap))
        return distance


def _link_boxes(link: I64, box: F64) -> F64:
    """Returns the box about all boxes of each link, (L + 1, 6), centre and half the size; those of links without any are nowhere."""
    low, high = (np.full((int(link.max(initial=0)) + 1, 3), end) for end in (np.inf, -np.inf))
    np.minimum.at(low, link, box[:, :3] - box[:, 3:])
    np.maximum.at(high, link, box[:, :3] + box[:, 3:])
    empty = low[:, 0] > high[:, 0]
    low[empty], high[empty] = 0.0, 0.0
    return np.hstack([(low + high) / 2, (high - low) / 2])


def _before(planes: F64, boxes: F64) -> NDArray[np.bool_]:
    """Returns which boxes, (N, 6), lie before all planes, (P, 4), or touch them, (N,)."""
    nearest = boxes[:, :3] @ planes[:, :3].T + boxes[:, 3:] @ np.abs(planes[:, :3]).T + planes[:, 3]
    return np.asarray((nearest >= 0.0).all(axis=1))


def _each_before(planes: F64, boxes: F64) -> NDArray[np.bool_]:
    """The same with planes of each box, (N, P, 4)."""
    normals = planes[:, :, :3]
    nearest = np.matmul(normals, boxes[:, :3, None]) + np.matmul(np.abs(normals), boxes[:, 3:, None])
    return np.asarray((nearest[:, :, 0] + planes[:, :, 3] >= 0.0).all(axis=1))


def link_frames(T_world_camera: Mat4, T_world_links: F64) -> tuple[F64, F64]:
    """Returns T_camera_links, (L, 4, 4), and the eye in each link, (L, 3)."""
    R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    T_camera_links = np.zeros_like(T_world_links)
    T_camera_links[:, :3] = R.T @ T_world_links[:, :3]
    T_camera_links[:, :3, 3] -= R.T @ t
    T_camera_links[:, 3, 3] = 1.0
    eyes = np.einsum("lji,lj->li", T_world_links[:, :3, :3], t - T_world_links[:, :3, 3])
    return T_camera_links, eyes
