"""Which triangles a photograph shows as a whole, by a depth image of the surface, and by one that was measured with the photograph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from gibson_sim.geometry.triangles import unit_normals
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics
from gibson_sim_tools.texturing.drawing import NEAR, draw
from gibson_sim_tools.texturing.surface import Surface, project

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_LARGEST = 640
"""Longer side of the depth image, pixels."""
_STEEPEST = 0.1
"""Least cosine between the normal of a triangle and the direction to the camera."""
_MARGIN = 1.5
"""Distance of a triangle from the edge of its photograph, pixels."""
_BEFORE, _BEFORE_SHARE = 0.01, 0.005
"""A surface hides what lies behind it by more than this: metres, and metres per metre of depth."""
_GAP, _GAP_SHARE = 0.1, 0.03
"""The same for a surface that a neighbouring pixel shows: poses are a little off, so that what hides may hide a little more."""
_APART, _APART_SHARE = 0.03, 0.01
"""A depth that was measured agrees with the surface within this: metres, and metres per metre of depth."""
_AROUND_PX = 320.0
"""Width of an image whose pixels are compared with their neighbours, 3 x 3; in larger ones with more: poses are a little off."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenFaces:
    """Triangles that a photograph shows."""

    faces: I64
    """(N,), ascending."""
    corners: F64
    """(N, 3, 2): where their corners are in the photograph, pixels."""


def seen_faces(surface: Surface, intrinsics: Intrinsics, T_world_camera: F64) -> SeenFaces:
    """Returns the triangles whose front a photograph shows, none of whose corners is hidden."""
    uv, z = project(surface.vertices, intrinsics, T_world_camera)
    with np.errstate(invalid="ignore"):
        on_image = (
            (z > NEAR)
            & (uv > _MARGIN).all(axis=1)
            & (uv < (intrinsics.width - 1 - _MARGIN, intrinsics.height - 1 - _MARGIN)).all(axis=1)
        )
    candidates = np.flatnonzero(on_image[surface.triangles].all(axis=1))
    corners = surface.vertices[surface.triangles[candidates]]
    to_camera = T_world_camera[:3, 3] - corners.mean(axis=1)
    facing = np.einsum("ij,ij->i", unit_normals(corners), to_camera) > _STEEPEST * np.linalg.norm(to_camera, axis=1)
    candidates = candidates[facing]
    used = np.unique(surface.triangles[candidates])
    shown = np.zeros(len(surface.vertices), dtype=bool)
    shown[used] = visible_points(surface, surface.vertices[used], intrinsics, T_world_camera)
    faces = candidates[shown[surface.triangles[candidates]].all(axis=1)]
    return SeenFaces(faces, np.asarray(uv[surface.triangles[faces]]))


def visible_points(surface: Surface, points: F64, intrinsics: Intrinsics, T_world_camera: F64) -> Bools:
    """Returns which points (N, 3) of the surface, in front of the camera and within its image, the surface does not hide."""
    reduced = min(1.0, _LARGEST / max(intrinsics.width, intrinsics.height))
    small = intrinsics.resized(max(round(intrinsics.width * reduced), 1), max(round(intrinsics.height * reduced), 1))
    image = draw(surface, small, T_world_camera)
    uv, z = project(points, small, T_world_camera)
    limits = np.array([small.width - 1, small.height - 1])
    column, row = np.clip(np.rint(uv), 0, limits).astype(np.int64).T
    # The triangle at the centre of the pixel is extended to the point itself, since a slanted one is deeper at one side of the pixel.
    owner = image.face[row, column]
    a, b, c = (surface.vertices[surface.triangles[owner, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    eye = T_world_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.einsum("ij,ij->i", a - eye, normal) / np.einsum("ij,ij->i", points - eye, normal)
    plane = np.where(np.isfinite(share) & (share > 0.0), share * z, image.depth[row, column])
    before = np.maximum(plane, image.depth[row, column])
    hidden = (owner >= 0) & (before < z - _BEFORE - _BEFORE_SHARE * z)
    around = minimum_filter(image.depth, size=3, mode="nearest")[row, column]
    hidden |= around < z - _GAP - _GAP_SHARE * z
    return np.asarray(~hidden)


def agreeing(surface: Surface, seen: SeenFaces, depth: F32, T_world_camera: F64) -> SeenFaces:
    """Returns the triangles at which the depth (H, W) that was measured with the photograph, NaN = unknown, is that of the surface.

    Where it differs, the photograph shows something that the surface lacks: what moved, what is thin, what is too dark for the sensor.
    """
    height, width = depth.shape
    size = 2 * max(round(width / _AROUND_PX), 1) + 1
    unknown = np.isnan(depth)
    nearest = minimum_filter(np.where(unknown, np.inf, depth), size=size, mode="nearest")
    farthest = maximum_filter(np.where(unknown, -np.inf, depth), size=size, mode="nearest")
    points = np.concatenate([seen.corners, seen.corners.mean(axis=1, keepdims=True)], axis=1)
    column, row = np.clip(np.rint(points), 0, (width - 1, height - 1)).astype(np.int64).transpose(2, 0, 1)
    z = (surface.vertices[surface.triangles[seen.faces]] - T_world_camera[:3, 3]) @ T_world_camera[:3, 2]
    z = np.concatenate([z, z.mean(axis=1, keepdims=True)], axis=1)
    apart = _APART + _APART_SHARE * z
    other = np.isfinite(nearest[row, column]) & ((nearest[row, column] > z + apart) | (farthest[row, column] < z - apart))
    kept = ~other.any(axis=1)
    return SeenFaces(seen.faces[kept], seen.corners[kept])
