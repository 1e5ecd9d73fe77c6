"""A mesh with vertex colours, as scanners produce it: welding, small parts, levelling, PLY. Pure but for the file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.patches import flat_patches
from gibson_sim.geometry.transforms import Mat4, transform_points
from gibson_sim.geometry.triangle_meshes import components, simplified_triangles
from gibson_sim.geometry.upright import find_candidates
from gibson_sim.writing import write_file
from gibson_sim_tools.scanning.posed_rgbd import ScanError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_CAMERA_DEG = 50.0
"""Largest angle between up and the mean of the cameras' -y, degrees; many cameras look down most of the time."""
_LEVEL_SHARE = 0.02
"""Least fraction of the surface that is a floor."""
_FLOOR_DEG = 15.0
"""Largest angle between up and the normal of a floor triangle, degrees."""
_FLOOR_BIN = 0.02
_FLOOR_SHARE = 0.25
"""The floor is the lowest height with this fraction of the level area at the height that has most."""


@dataclass(frozen=True, slots=True, eq=False)
class ColouredMesh:
    """Triangles, counter-clockwise seen from the camera."""

    vertices: F32
    """(V, 3), metres."""
    triangles: NDArray[np.int32]
    """(F, 3), rows of ``vertices``."""
    colors: NDArray[np.uint8]
    """(V, 3), sRGB."""

    def crosses(self) -> F64:
        """Returns the normals of the triangles, (F, 3), as long as twice their areas."""
        corners = self.vertices.astype(np.float64)[self.triangles]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    @property
    def area(self) -> float:
        """Surface area, square metres."""
        return float(np.linalg.norm(self.crosses(), axis=1).sum() / 2.0)


def welded(mesh: ColouredMesh, size: float) -> ColouredMesh:
    """Returns the mesh with the vertices in each cube of edge ``size``, metres, merged, without the triangles that collapse.

    Where a surface passes through corners of voxels, a distance field gives many sliver triangles.
    """
    cells = np.rint(mesh.vertices.astype(np.float64) / size).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    sides = cells.max(axis=0, initial=0) + 1
    _, first, number = np.unique(
        (cells[:, 0] * sides[1] + cells[:, 1]) * sides[2] + cells[:, 2], return_index=True, return_inverse=True
    )
    triangles = number.reshape(-1)[mesh.triangles].astype(np.int32)
    a, b, c = triangles.T
    solid = (a != b) & (b != c) & (c != a)
    return ColouredMesh(mesh.vertices[first], triangles[solid], mesh.colors[first])


def without_small_parts(mesh: ColouredMesh, least_area: float) -> ColouredMesh:
    """Returns the mesh without connected parts whose area is below ``least_area``, square metres."""
    part = components(mesh.triangles, len(mesh.vertices))
    areas = np.bincount(part, weights=np.linalg.norm(mesh.crosses(), axis=1) / 2.0)
    return _subset(mesh, mesh.triangles[areas[part] >= least_area])


def thinned(mesh: ColouredMesh, triangles: int) -> ColouredMesh:
    """Returns the mesh with about ``triangles`` triangles, or more if fewer would tear it; its vertices are a subset of the given ones.

    Faster and less accurate than a method that optimises vertex positions.

    Raises:
        MeshError: meshoptimizer is not installed.
    """
    return _subset(mesh, simplified_triangles(mesh.vertices, mesh.triangles, least=triangles))


def _subset(mesh: ColouredMesh, triangles: NDArray[Any]) -> ColouredMesh:
    """Returns the mesh of some triangles (F, 3), with the vertices that they use."""
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[triangles] = True
    number = np.cumsum(used) - 1
    return ColouredMesh(mesh.vertices[used], number[triangles].astype(np.int32), mesh.colors[used])


def level_transform(mesh: ColouredMesh, poses: F64) -> Mat4:
    """Returns T_level_world, (4, 4): z up, the floor at z = 0, by the smallest rotation.

    Third-party scans have the frame of their first camera. Cameras are roughly upright, so up is near the mean of their -y; the level
    surfaces near that direction decide, by the measure of ``gibson-sim scene check``.

    Args:
        mesh: in the frame of the scan.
        poses: T_world_camera, (N, 4, 4), optical.

    Raises:
        ScanError: the mesh has no level surface that faces up.
    """
    return level_transform_near(mesh, -poses[:, :3, 1].mean(axis=0))


def level_transform_near(mesh: ColouredMesh, up: F64) -> Mat4:
    """Returns T_level_world as ``level_transform``, for a known rough direction of up (3,), in the frame of the mesh.

    Raises:
        ScanError: the mesh has no level surface near it that faces up.
    """
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    patches = flat_patches(mesh.vertices.astype(np.float64), mesh.triangles, np.random.default_rng(0))
    found = [] if patches is None else find_candidates(patches)
    near = [c for c in found if float(np.asarray(c.up) @ up) > math.cos(math.radians(_CAMERA_DEG)) and c.area > _LEVEL_SHARE]
    if not near:
        raise ScanError("the mesh has no level surface, so up cannot be found; leave out --level")
    up = np.asarray(near[0].up)
    T = np.eye(4)
    T[:3, :3] = _turn_to_z(up)
    crosses = mesh.crosses()
    lengths = np.linalg.norm(crosses, axis=1)
    alike = crosses @ up > math.cos(math.radians(_FLOOR_DEG)) * lengths
    if not alike.any():
        raise ScanError("the mesh has no surface that faces up, so its floor cannot be found; leave out --level")
    heights = transform_points(T, mesh.vertices[mesh.triangles[alike]].mean(axis=1))[:, 2]
    edges = np.arange(heights.min() - _FLOOR_BIN, heights.max() + 2 * _FLOOR_BIN, _FLOOR_BIN)
    level, _ = np.histogram(heights, edges, weights=lengths[alike])
    lowest = int(np.flatnonzero(level >= _FLOOR_SHARE * level.max())[0])
    near = np.abs(heights - edges[lowest] - _FLOOR_BIN / 2) <= 1.5 * _FLOOR_BIN
    T[2, 3] = -float(np.average(heights[near], weights=lengths[alike][near]))
    return T


def _turn_to_z(up: F64) -> F64:
    """Returns the smallest rotation (3, 3) that takes a unit vector to z."""
    axis = np.cross(up, (0.0, 0.0, 1.0))
    if float(np.linalg.norm(axis)) < 1e-9:
        return np.eye(3) if up[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + up[2]))


def moved(mesh: ColouredMesh, T: Mat4) -> ColouredMesh:
    """Returns the mesh under a rigid transform, (4, 4)."""
    return ColouredMesh(transform_points(T, mesh.vertices).astype(np.float32), mesh.triangles, mesh.colors)


def write_ply(path: Path, mesh: ColouredMesh, comments: Sequence[str] = ()) -> None:
    """Writes a binary PLY with vertex colours.

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
