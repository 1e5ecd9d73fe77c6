"""The mesh to be textured: welding, edge splitting, face adjacency, pinhole projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.transforms import invert
from gibson_sim.geometry.triangle_meshes import weld
from gibson_sim_tools.importing.checks.gravity import size_text
from gibson_sim_tools.scanning.posed_images import Intrinsics, ScanError
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_EDGES = ((0, 1), (1, 2), (2, 0))
MAX_TRIANGLES = 10_000_000
"""Largest number of triangles after splitting long edges."""


@dataclass(frozen=True, slots=True, eq=False)
class Adjacency:
    """Face adjacency: E pairs of triangles with a common edge. A non-manifold edge gives a chain of pairs."""

    faces: I64
    """(E, 2), triangles of each pair."""
    edges: I64
    """(E, 2), vertices of the common edge."""


def surface_from_mesh(mesh: Mesh) -> TriangleMesh:
    """Returns the welded triangles of a mesh, with vertex colours if all its parts have them.

    Raises:
        ScanError: the mesh has no triangle.
    """
    vertices, triangles = weld(*mesh.merged())
    if not len(triangles):
        raise ScanError("the mesh has no triangle with an area; give the mesh of the scan")
    colors = None
    if all(part.colors is not None for part in mesh.parts):
        part_vertices = np.concatenate([part.vertices for part in mesh.parts]).astype(np.float64)
        part_colors = np.concatenate([part.colors[:, :3] for part in mesh.parts if part.colors is not None])
        colors = part_colors[cKDTree(part_vertices).query(vertices)[1]]
    return TriangleMesh(vertices, triangles, colors)


def split_count(surface: TriangleMesh, max_length: float) -> int:
    """Returns about how many triangles ``split_long_edges`` would return."""
    corners = surface.corners
    lengths = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    return int((np.maximum(lengths[:, 2] / max_length, 1.0) * np.maximum(lengths[:, 0] / max_length, 1.0)).sum())


def check_split(surface: TriangleMesh, max_length: float) -> None:
    """Raises ScanError, which names the size of the surface, if ``split_long_edges`` would return too many triangles."""
    count = split_count(surface, max_length)
    if count > MAX_TRIANGLES:
        raise ScanError(
            f"the mesh is {size_text(np.ptp(surface.vertices, axis=0).tolist())}: with edges of {max_length:g} m at most, as textures "
            f"need them, it would have about {count / 1e6:.0f} million triangles, more than {MAX_TRIANGLES / 1e6:.0f}; if poses and mesh have "
            "another unit than metres, give --unit (`scene texture` also has --longest-edge)"
        )


def split_long_edges(surface: TriangleMesh, max_length: float) -> TriangleMesh:
    """Returns the surface with all edges at most ``max_length`` metres long.

    One photograph textures a triangle, so triangles must be small against the field of view. Each round splits all longer edges at their
    midpoints, in all their triangles, which avoids T-junctions.

    Raises:
        ScanError: it would have more than ``MAX_TRIANGLES``.
    """
    check_split(surface, max_length)
    vertices, triangles, colors = surface.vertices, surface.triangles, surface.colors
    while True:
        sorted_ends = np.sort(np.concatenate([triangles[:, edge] for edge in _EDGES]), axis=1)
        edges, edge_of_side = np.unique(sorted_ends, axis=0, return_inverse=True)
        is_long = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > max_length
        if not is_long.any():
            return TriangleMesh(vertices, triangles, colors)
        midpoint = np.where(is_long, np.cumsum(is_long) - 1 + len(vertices), -1)
        split_edges = edges[is_long]
        if colors is not None:
            colors = np.concatenate([colors, (colors[split_edges].astype(np.uint16).sum(axis=1) // 2).astype(np.uint8)])
        vertices = np.concatenate([vertices, vertices[split_edges].mean(axis=1)])
        triangles = _split_triangles(triangles, midpoint[edge_of_side.reshape(3, -1).T])


def _split_triangles(triangles: I64, midpoints: I64) -> I64:
    """Returns triangles (F, 3) split at the midpoint vertices (F, 3) of their edges 01, 12 and 20; -1 = the edge is not split."""
    count = (midpoints >= 0).sum(axis=1)
    parts = [triangles[count == 0]]
    # Each triangle is rotated so that its only split edge, or its only edge that is not split, comes first.
    for k in range(3):
        order = [k, (k + 1) % 3, (k + 2) % 3]
        one = (count == 1) & (midpoints[:, k] >= 0)
        (a, b, c), m = triangles[one][:, order].T, midpoints[one, k]
        parts += [np.stack([a, m, c], 1), np.stack([m, b, c], 1)]
        two = (count == 2) & (midpoints[:, k] < 0)
        (a, b, c), (_, m, n) = triangles[two][:, order].T, midpoints[two][:, order].T
        parts += [np.stack([a, b, m], 1), np.stack([a, m, n], 1), np.stack([m, c, n], 1)]
    (a, b, c), (m, n, o) = triangles[count == 3].T, midpoints[count == 3].T
    parts += [np.stack([a, m, o], 1), np.stack([m, b, n], 1), np.stack([o, n, c], 1), np.stack([m, n, o], 1)]
    return np.concatenate(parts)


def face_adjacency(triangles: I64) -> Adjacency:
    """Returns the face adjacency of triangles (F, 3), vertex indices."""
    ends = np.sort(np.concatenate([triangles[:, edge] for edge in _EDGES]), axis=1)
    face = np.tile(np.arange(len(triangles)), 3)
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, face = ends[order], face[order]
    same = (ends[1:] == ends[:-1]).all(axis=1) & (face[1:] != face[:-1])
    return Adjacency(np.stack([face[:-1][same], face[1:][same]], axis=1), ends[1:][same])


def project(points: F64, intrinsics: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the projections (N, 2), columns and rows, of points (N, 3), world frame, and their depths (N,), metres.

    Points that are not in front of the camera have NaN projections.
    """
    T = invert(T_world_camera)
    p = points @ T[:3, :3].T + T[:3, 3]
    z = p[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(z[:, None] > 0.0, p[:, :2] / z[:, None], np.nan)
    return plane * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy), z
