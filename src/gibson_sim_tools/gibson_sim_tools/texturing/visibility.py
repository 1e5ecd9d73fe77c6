"""Visibility of triangles in photographs, by a z-buffer of the surface, and their consistency with measured depth images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from gibson_sim.geometry.triangle_meshes import unit_normals
from gibson_sim_tools.scanning.posed_images import Intrinsics
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh
from gibson_sim_tools.texturing.rasteriser import NEAR_PLANE, rasterise
from gibson_sim_tools.texturing.surface import project

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_LONGEST_SIDE_PX = 640
"""Longest side of the z-buffer, pixels."""
_MIN_COSINE = 0.1
"""Least cosine between the normal of a visible triangle and the direction to the camera."""
_MARGIN_PX = 1.5
"""Least distance of a triangle from the image border, pixels."""
_OCCLUSION_TOLERANCE, _OCCLUSION_TOLERANCE_RATIO = 0.01, 0.005
"""Least distance behind the surface at which a point is occluded: metres, and metres per metre of depth."""
_NEIGHBOUR_TOLERANCE, _NEIGHBOUR_TOLERANCE_RATIO = 0.1, 0.03
"""The same for the surface at neighbouring pixels, which may occlude the point because of pose errors."""
_DEPTH_TOLERANCE, _DEPTH_TOLERANCE_RATIO = 0.03, 0.01
"""Largest difference between measured and rasterised depth: metres, and metres per metre of depth."""
_PIXELS_PER_WINDOW_STEP = 320.0
"""Image width per pixel of the half width of the window in which depths are compared; the window allows for pose errors."""


@dataclass(frozen=True, slots=True, eq=False)
class VisibleFaces:
    """Visible triangles of a photograph."""

    faces: I64
    """(N,), indices of the triangles, ascending."""
    corners: F64
    """(N, 3, 2), projections of their corners, columns and rows, pixels."""


def visible_faces(surface: TriangleMesh, intrinsics: Intrinsics, T_world_camera: F64) -> VisibleFaces:
    """Returns the front-facing triangles that lie within the image and have no occluded corner.

    Args:
        surface: mesh, world frame.
        intrinsics: of the photograph.
        T_world_camera: (4, 4), optical frame.
    """
    uv, z = project(surface.vertices, intrinsics, T_world_camera)
    with np.errstate(invalid="ignore"):
        on_image = (
            (z > NEAR_PLANE)
            & (uv > _MARGIN_PX).all(axis=1)
            & (uv < (intrinsics.width - 1 - _MARGIN_PX, intrinsics.height - 1 - _MARGIN_PX)).all(axis=1)
        )
    candidates = np.flatnonzero(on_image[surface.triangles].all(axis=1))
    corners = surface.vertices[surface.triangles[candidates]]
    to_camera = T_world_camera[:3, 3] - corners.mean(axis=1)
    is_facing = np.einsum("ij,ij->i", unit_normals(corners), to_camera) > _MIN_COSINE * np.linalg.norm(to_camera, axis=1)
    candidates = candidates[is_facing]
    used_vertices = np.unique(surface.triangles[candidates])
    is_visible = np.zeros(len(surface.vertices), dtype=bool)
    is_visible[used_vertices] = visible_points(surface, surface.vertices[used_vertices], intrinsics, T_world_camera)
    faces = candidates[is_visible[surface.triangles[candidates]].all(axis=1)]
    return VisibleFaces(faces, np.asarray(uv[surface.triangles[faces]]))


def visible_points(surface: TriangleMesh, points: F64, intrinsics: Intrinsics, T_world_camera: F64) -> Bools:
    """Returns the mask (N,) of the points that the surface does not occlude.

    Args:
        surface: mesh, world frame.
        points: (N, 3), points of the surface, world frame, metres; in front of the camera and within its image.
        intrinsics: of the camera.
        T_world_camera: (4, 4), optical frame.
    """
    scale = min(1.0, _LONGEST_SIDE_PX / max(intrinsics.width, intrinsics.height))
    reduced = intrinsics.resized(max(round(intrinsics.width * scale), 1), max(round(intrinsics.height * scale), 1))
    buffer = rasterise(surface, reduced, T_world_camera)
    uv, z = project(points, reduced, T_world_camera)
    limits = np.array([reduced.width - 1, reduced.height - 1])
    column, row = np.clip(np.rint(uv), 0, limits).astype(np.int64).T
    # The plane of the triangle at the pixel centre is intersected with the ray of the point: depth varies over a pixel on slanted surfaces.
    face = buffer.face[row, column]
    a, b, c = (surface.vertices[surface.triangles[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    eye = T_world_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        ray_scale = np.einsum("ij,ij->i", a - eye, normal) / np.einsum("ij,ij->i", points - eye, normal)
    plane_depth = np.where(np.isfinite(ray_scale) & (ray_scale > 0.0), ray_scale * z, buffer.depth[row, column])
    occluder_depth = np.maximum(plane_depth, buffer.depth[row, column])
    is_occluded = (face >= 0) & (occluder_depth < z - _OCCLUSION_TOLERANCE - _OCCLUSION_TOLERANCE_RATIO * z)
    nearest_neighbour_depth = minimum_filter(buffer.depth, size=3, mode="nearest")[row, column]
    is_occluded |= nearest_neighbour_depth < z - _NEIGHBOUR_TOLERANCE - _NEIGHBOUR_TOLERANCE_RATIO * z
    return np.asarray(~is_occluded)


def depth_consistent(surface: TriangleMesh, visible: VisibleFaces, depth: F32, T_world_camera: F64) -> VisibleFaces:
    """Returns the visible triangles whose depth agrees with the measured depth image, or is unknown there.

    Elsewhere, the photograph shows an object that the mesh lacks, because it moved, is thin, or is too dark for the sensor.

    Args:
        surface: mesh, world frame.
        visible: visible triangles of the photograph.
        depth: (H, W), metres along the optical axis, at the pixels of the photograph, NaN = unknown.
        T_world_camera: (4, 4), optical frame.
    """
    height, width = depth.shape
    size = 2 * max(round(width / _PIXELS_PER_WINDOW_STEP), 1) + 1
    is_unknown = np.isnan(depth)
    nearest = minimum_filter(np.where(is_unknown, np.inf, depth), size=size, mode="nearest")
    farthest = maximum_filter(np.where(is_unknown, -np.inf, depth), size=size, mode="nearest")
    points = np.concatenate([visible.corners, visible.corners.mean(axis=1, keepdims=True)], axis=1)
    column, row = np.clip(np.rint(points), 0, (width - 1, height - 1)).astype(np.int64).transpose(2, 0, 1)
    z = (surface.vertices[surface.triangles[visible.faces]] - T_world_camera[:3, 3]) @ T_world_camera[:3, 2]
    z = np.concatenate([z, z.mean(axis=1, keepdims=True)], axis=1)
    tolerance = _DEPTH_TOLERANCE + _DEPTH_TOLERANCE_RATIO * z
    is_inconsistent = np.isfinite(nearest[row, column]) & (
        (nearest[row, column] > z + tolerance) | (farthest[row, column] < z - tolerance)
    )
    is_consistent = ~is_inconsistent.any(axis=1)
    return VisibleFaces(visible.faces[is_consistent], visible.corners[is_consistent])
