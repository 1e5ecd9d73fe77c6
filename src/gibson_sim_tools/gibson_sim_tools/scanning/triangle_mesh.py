"""The triangle mesh of a scan: vertex welding, removal of small components, decimation, levelling, PLY. Pure except for the file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.patches import flat_patches
from gibson_sim.geometry.transforms import Mat4, transform_points
from gibson_sim.geometry.triangle_meshes import components, simplified_triangles
from gibson_sim.geometry.upright import find_candidates
from gibson_sim.writing import write_file
from gibson_sim_tools.scanning.posed_images import ScanError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

_MAX_UP_ERROR_DEG = 50.0
"""Largest angle between up and the mean -y axis of the cameras, degrees; many cameras look down most of the time."""
_MIN_LEVEL_SHARE = 0.02
"""Least fraction of the surface that is a floor."""
_MAX_FLOOR_TILT_DEG = 15.0
"""Largest angle between up and the normal of a floor triangle, degrees."""
_HEIGHT_BIN = 0.02
_MIN_FLOOR_SHARE = 0.25
"""The floor is the lowest height with this fraction of the level area at the height that has most."""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """Triangles that share vertices, counter-clockwise from the visible side; some may be degenerate."""

    vertices: F64
    """(V, 3), metres."""
    triangles: I64
    """(F, 3), rows of ``vertices``."""
    colors: U8 | None = None
    """(V, 3), vertex colours, sRGB; None = there are none."""

    @property
    def corners(self) -> F64:
        """(F, 3, 3), corners of the triangles, metres."""
        return np.asarray(self.vertices[self.triangles])

    def scaled(self, scale: float) -> TriangleMesh:
        """Returns the mesh scaled about the origin."""
        return replace(self, vertices=self.vertices * scale)

    def single(self) -> TriangleMesh:
        """Returns the mesh with positions rounded to single precision, as files hold them."""
        return replace(self, vertices=self.vertices.astype(np.float32).astype(np.float64))

    def doubled_area_vectors(self) -> F64:
        """Returns the doubled area vectors of the triangles, (F, 3), square metres: normals with twice the area as length."""
        corners = self.corners
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    @property
    def area(self) -> float:
        """Surface area, square metres."""
        return float(np.linalg.norm(self.doubled_area_vectors(), axis=1).sum() / 2.0)


def weld_vertices(mesh: TriangleMesh, cell_size: float) -> TriangleMesh:
    """Returns the mesh with the vertices in each grid cell of edge ``cell_size``, metres, merged, without degenerate triangles.

    Marching cubes yields many sliver triangles where the surface passes near voxel corners.
    """
    cells = np.rint(mesh.vertices / cell_size).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    grid_shape = cells.max(axis=0, initial=0) + 1
    _, first, merged = np.unique(
        (cells[:, 0] * grid_shape[1] + cells[:, 1]) * grid_shape[2] + cells[:, 2], return_index=True, return_inverse=True
    )
    triangles = merged.reshape(-1)[mesh.triangles].astype(np.int64)
    a, b, c = triangles.T
    is_valid = (a != b) & (b != c) & (c != a)
    return TriangleMesh(mesh.vertices[first], triangles[is_valid], None if mesh.colors is None else mesh.colors[first])


def without_small_components(mesh: TriangleMesh, least_area: float) -> TriangleMesh:
    """Returns the mesh without connected components of an area below ``least_area``, square metres."""
    part = components(mesh.triangles, len(mesh.vertices))
    areas = np.bincount(part, weights=np.linalg.norm(mesh.doubled_area_vectors(), axis=1) / 2.0)
    return _subset(mesh, mesh.triangles[areas[part] >= least_area])


def decimated(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """Returns the mesh decimated by meshoptimizer to about ``triangles`` triangles, or more if fewer would tear it.

    Its vertices are a subset of the given ones, which is faster and less accurate than ``simplify_quadric``.

    Raises:
        MeshError: meshoptimizer is not installed.
    """
    return _subset(mesh, simplified_triangles(mesh.vertices, mesh.triangles, least=triangles))


def _subset(mesh: TriangleMesh, triangles: NDArray[Any]) -> TriangleMesh:
    """Returns the mesh of some triangles (F, 3), without unused vertices."""
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[triangles] = True
    number = np.cumsum(used) - 1
    return TriangleMesh(mesh.vertices[used], number[triangles], None if mesh.colors is None else mesh.colors[used])


def level_transform(mesh: TriangleMesh, poses: F64) -> Mat4:
    """Returns T_level_world, (4, 4): z up, the floor at z = 0, by the smallest rotation.

    Third-party scans have the frame of their first camera. Cameras are roughly upright, so up is near the mean of their -y axes. The normal
    of the level surfaces near that direction is up, as in ``gibson-sim scene check``.

    Args:
        mesh: mesh in the frame of the scan.
        poses: T_world_camera, (N, 4, 4), optical frame.

    Raises:
        ScanError: the mesh has no level surface that faces up.
    """
    return level_transform_from_up(mesh, -poses[:, :3, 1].mean(axis=0))


def level_transform_from_up(mesh: TriangleMesh, up: F64) -> Mat4:
    """Returns T_level_world as ``level_transform``, from an approximate up direction (3,), frame of the mesh.

    Raises:
        ScanError: the mesh has no level surface near it that faces up.
    """
    up, mesh = up / max(float(np.linalg.norm(up)), 1e-9), mesh.single()
    patches = flat_patches(mesh.vertices, mesh.triangles, np.random.default_rng(0))
    candidates = [] if patches is None else find_candidates(patches)
    near = [
        c
        for c in candidates
        if float(np.asarray(c.up) @ up) > math.cos(math.radians(_MAX_UP_ERROR_DEG)) and c.area > _MIN_LEVEL_SHARE
    ]
    if not near:
        raise ScanError("the mesh has no level surface, so up cannot be found; leave out --level")
    up = np.asarray(near[0].up)
    T = np.eye(4)
    T[:3, :3] = _rotation_to_z(up)
    area_vectors = mesh.doubled_area_vectors()
    doubled_areas = np.linalg.norm(area_vectors, axis=1)
    is_level = area_vectors @ up > math.cos(math.radians(_MAX_FLOOR_TILT_DEG)) * doubled_areas
    if not is_level.any():
        raise ScanError("the mesh has no surface that faces up, so its floor cannot be found; leave out --level")
    heights = transform_points(T, mesh.corners[is_level].astype(np.float32).mean(axis=1))[:, 2]
    edges = np.arange(heights.min() - _HEIGHT_BIN, heights.max() + 2 * _HEIGHT_BIN, _HEIGHT_BIN)
    area_histogram, _ = np.histogram(heights, edges, weights=doubled_areas[is_level])
    lowest = int(np.flatnonzero(area_histogram >= _MIN_FLOOR_SHARE * area_histogram.max())[0])
    near = np.abs(heights - edges[lowest] - _HEIGHT_BIN / 2) <= 1.5 * _HEIGHT_BIN
    T[2, 3] = -float(np.average(heights[near], weights=doubled_areas[is_level][near]))
    return T


def _rotation_to_z(up: F64) -> F64:
    """Returns the smallest rotation (3, 3) that takes a unit vector to z."""
    axis = np.cross(up, (0.0, 0.0, 1.0))
    if float(np.linalg.norm(axis)) < 1e-9:
        return np.eye(3) if up[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + up[2]))


def transformed(mesh: TriangleMesh, T: Mat4) -> TriangleMesh:
    """Returns the mesh under a rigid transform, (4, 4)."""
    return replace(mesh, vertices=transform_points(T, mesh.vertices)).single()


def write_ply(path: Path, mesh: TriangleMesh, comments: Sequence[str] = ()) -> None:
    """Writes a binary PLY of a mesh with vertex colours.

    Args:
        path: the file.
        mesh: the mesh.
        comments: lines for its header.

    Raises:
        WriteError: it cannot be written.
    """
    vertex = np.empty(len(mesh.vertices), dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    vertex["xyz"], vertex["rgb"] = mesh.vertices, mesh.colors
    face = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    face["count"], face["index"] = 3, mesh.triangles
    header = [
        "ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments),
        f"element vertex {len(vertex)}", *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {color}" for color in ("red", "green", "blue")), f"element face {len(face)}",
        "property list uchar int vertex_indices", "end_header\n",
    ]  # fmt: skip
    write_file(path, "\n".join(header).encode() + vertex.tobytes() + face.tobytes())
