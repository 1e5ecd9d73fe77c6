"""Closed surfaces. From outside only their front faces are visible, so half of their triangles need not be drawn. No OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import MeshPart
from gibson_sim.geometry.compiling import CAN_COMPILE, fixed
from gibson_sim.geometry.triangle_meshes import at_a_border, components
from gibson_sim.render.lod import lod_selection
from gibson_sim.render.lod.clusters import weld

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_WRONG_PART = 1e-3
"""Largest fraction of a surface's area whose normals may point inward, due to rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedSurfaces:
    """The closed surfaces of a mesh."""

    triangles: tuple[Bools, ...]
    """Mask, (F,), of the triangles in closed surfaces, for each mesh part."""
    boxes: F64
    """(S, 6), box of each surface: centre and half extents, metres, frame of the mesh."""


def find_closed_surfaces(parts: Sequence[MeshPart], opaque: Sequence[bool]) -> ClosedSurfaces:
    """Finds the closed surfaces of a mesh: connected opaque triangles without a border, wound counter-clockwise seen from outside.

    Args:
        parts: parts of the mesh; a surface may extend over several of them.
        opaque: whether each part is opaque.
    """
    ends = np.cumsum([len(part.triangles) for part in parts])
    firsts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    positions = np.concatenate([part.vertices for part in parts])
    rows = np.concatenate([part.triangles + np.int64(first) for part, first in zip(parts, firsts, strict=False)])
    welded = weld(positions)
    corners, count = welded[rows], int(welded.max(initial=-1)) + 1
    owner = components(corners, count)
    number = int(owner.max(initial=-1)) + 1
    closed = np.ones(number, dtype=bool)
    closed[owner[at_a_border(corners, count)]] = False
    closed[owner[np.repeat(~np.array(opaque, dtype=bool), [len(part.triangles) for part in parts])]] = False
    if closed.any():
        closed &= _outward(positions, np.concatenate([part.normals for part in parts]), rows, owner, number)
    in_closed = closed[owner]
    return ClosedSurfaces(
        tuple(np.split(in_closed, ends[:-1])), _boxes(positions, rows[in_closed], owner[in_closed], number)[closed]
    )


def _outward(positions: NDArray[np.float32], normals: NDArray[np.float32], rows: I64, owner: I64, number: int) -> Bools:
    """Returns a mask, (number,), of the borderless surfaces that enclose a volume and whose normals point out of it."""
    middle = positions.mean(axis=0, dtype=np.float64)
    a, b, c = (positions[rows[:, k]] - middle for k in range(3))
    face_normal = np.cross(b - a, c - a)
    volume = np.bincount(owner, np.einsum("fk,fk->f", a, face_normal), minlength=number)
    area = np.linalg.norm(face_normal, axis=1)
    inward = np.einsum("fk,fk->f", face_normal, normals[rows].sum(axis=1, dtype=np.float64)) < 0.0
    wrong = np.bincount(owner, np.where(inward, area, 0.0), minlength=number)
    return np.asarray((volume > 0.0) & (wrong <= _WRONG_PART * np.bincount(owner, area, minlength=number)))


def _boxes(positions: NDArray[np.float32], rows: I64, owner: I64, number: int) -> F64:
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, owner, positions[rows[:, k]])
        np.maximum.at(high, owner, positions[rows[:, k]])
    with np.errstate(invalid="ignore"):  # surfaces that are not closed have no box
        return np.hstack([(low + high) / 2, (high - low) / 2])


def transformed_boxes(boxes: F64, T: F64) -> F64:
    """Returns the axis-aligned bounding boxes, (S, 6), of boxes transformed by T, (4, 4)."""
    return np.hstack([boxes[:, :3] @ T[:3, :3].T + T[:3, 3], boxes[:, 3:] @ np.abs(T[:3, :3]).T])


class NearPlaneTest:
    """Tests whether the near plane of a picture intersects the box of a closed surface: if so, back faces may be visible.

    Args:
        boxes: (S, 6), boxes of closed surfaces: centre and half extents, metres, frame of the link.
        links: (S,), link number of each, 0 = the world.
        loops: use compiled loops instead of NumPy; the results are equal.
    """

    def __init__(self, boxes: F64, links: I64, *, loops: bool = CAN_COMPILE) -> None:
        self._boxes, self._links, self._loops = fixed(boxes), fixed(links), loops
        self.table = lod_selection.ClosedSurfaceTable(self._boxes, self._links)
        """Boxes for the compiled loops."""

    def touches(self, eyes: F64, T_camera_links: F64, near_corners: F64) -> bool:
        """Returns whether the near plane intersects any box.

        Args:
            eyes: (L, 3), the eye in the world, then in each link, metres.
            T_camera_links: (L, 4, 4), optical frame from each of these.
            near_corners: (4, 3), corners of the picture in the near plane, optical frame, metres.
        """
        if self._loops:
            return lod_selection.near_plane_touches(self.table, eyes, T_camera_links, near_corners)
        reach = np.sqrt(np.einsum("ck,ck->c", near_corners, near_corners).max())
        far = (np.abs(eyes[self._links] - self._boxes[:, :3]) > self._boxes[:, 3:] + reach).any(axis=1)
        T = T_camera_links[self._links[~far]]
        corners = (near_corners - T[:, None, :3, 3]) @ T[:, :3, :3]
        centre, half = self._boxes[~far, :3], self._boxes[~far, 3:]
        touched = (corners.min(axis=1) <= centre + half) & (corners.max(axis=1) >= centre - half)
        return bool(touched.all(axis=1).any())
