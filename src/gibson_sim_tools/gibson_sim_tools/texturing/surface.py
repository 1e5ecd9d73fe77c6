"""The surface that gets a texture: a welded triangle mesh, its neighbourhoods, and projections of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.transforms import invert
from gibson_sim.geometry.triangle_meshes import weld
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_EDGES = ((0, 1), (1, 2), (2, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Triangles, counter-clockwise seen from outside; world frame."""

    vertices: F64
    """(V, 3), metres, no two equal."""
    triangles: I64
    """(F, 3), rows of ``vertices``, the three different; some may have no area."""
    colors: NDArray[np.uint8] | None = None
    """(V, 3), sRGB of the vertices, or None."""

    @property
    def corners(self) -> F64:
        """(F, 3, 3), metres."""
        return np.asarray(self.vertices[self.triangles])

    def times(self, scale: float) -> Surface:
        """Returns the surface, larger by a factor."""
        return Surface(self.vertices * scale, self.triangles, self.colors)


@dataclass(frozen=True, slots=True, eq=False)
class Adjacency:
    """Pairs of triangles with a common edge. An edge of more than two triangles gives a chain of pairs."""

    faces: I64
    """(E, 2), rows of ``triangles``."""
    edges: I64
    """(E, 2), the common vertices."""


def surface_of(mesh: Mesh) -> Surface:
    """Returns the triangles of a mesh, welded, with the colours of its vertices if all its parts have them.

    Raises:
        ScanError: no triangle is left.
    """
    vertices, triangles = weld(*mesh.merged())
    if not len(triangles):
        raise ScanError("the mesh has no triangle; give the mesh of the scan")
    colors = None
    if all(part.colors is not None for part in mesh.parts):
        given = np.concatenate([part.vertices for part in mesh.parts]).astype(np.float64)
        of_given = np.concatenate([part.colors for part in mesh.parts if part.colors is not None])
        colors = of_given[cKDTree(given).query(vertices)[1]]
    return Surface(vertices, triangles, colors)


def split_long_edges(surface: Surface, longest: float) -> Surface:
    """Returns the surface with every edge at most ``longest`` metres long.

    A triangle is textured by one photograph, so that it has to be small beside what a photograph shows. Each round splits all edges that are
    too long at their middles, in all their triangles alike, so that no gap opens.
    """
    vertices, triangles, colors = surface.vertices, surface.triangles, surface.colors
    while True:
        ends = np.sort(np.concatenate([triangles[:, edge] for edge in _EDGES]), axis=1)
        edges, number = np.unique(ends, axis=0, return_inverse=True)
        long = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) > longest
        if not long.any():
            return Surface(vertices, triangles, colors)
        middle = np.where(long, np.cumsum(long) - 1 + len(vertices), -1)
        new = edges[long]
        if colors is not None:
            colors = np.concatenate([colors, (colors[new].astype(np.uint16).sum(axis=1) // 2).astype(np.uint8)])
        vertices = np.concatenate([vertices, vertices[new].mean(axis=1)])
        triangles = _split(triangles, middle[number.reshape(3, -1).T])


def _split(triangles: I64, middles: I64) -> I64:
    """Returns triangles (F, 3) split at the middles (F, 3) of their edges 01, 12 and 20; -1 = the edge stays whole."""
    count = (middles >= 0).sum(axis=1)
    out = [triangles[count == 0]]
    # Turn each triangle so that a lone split edge, or a lone whole one, comes first.
    for k in range(3):
        order = [k, (k + 1) % 3, (k + 2) % 3]
        one = (count == 1) & (middles[:, k] >= 0)
        (a, b, c), m = triangles[one][:, order].T, middles[one, k]
        out += [np.stack([a, m, c], 1), np.stack([m, b, c], 1)]
        two = (count == 2) & (middles[:, k] < 0)
        (a, b, c), (_, m, n) = triangles[two][:, order].T, middles[two][:, order].T
        out += [np.stack([a, b, m], 1), np.stack([a, m, n], 1), np.stack([m, c, n], 1)]
    (a, b, c), (m, n, o) = triangles[count == 3].T, middles[count == 3].T
    out += [np.stack([a, m, o], 1), np.stack([m, b, n], 1), np.stack([o, n, c], 1), np.stack([m, n, o], 1)]
    return np.concatenate(out)


def adjacency(triangles: I64) -> Adjacency:
    """Returns which triangles (F, 3) share an edge."""
    ends = np.sort(np.concatenate([triangles[:, edge] for edge in _EDGES]), axis=1)
    face = np.tile(np.arange(len(triangles)), 3)
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, face = ends[order], face[order]
    same = (ends[1:] == ends[:-1]).all(axis=1) & (face[1:] != face[:-1])
    return Adjacency(np.stack([face[:-1][same], face[1:][same]], axis=1), ends[1:][same])


def project(points: F64, intrinsics: Intrinsics, T_world_camera: F64) -> tuple[F64, F64]:
    """Returns the pixels (N, 2) of points (N, 3), world frame, and their depths (N,), metres; NaN pixels for points not in front."""
    T = invert(T_world_camera)
    p = points @ T[:3, :3].T + T[:3, 3]
    z = p[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(z[:, None] > 0.0, p[:, :2] / z[:, None], np.nan)
    return plane * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy), z
