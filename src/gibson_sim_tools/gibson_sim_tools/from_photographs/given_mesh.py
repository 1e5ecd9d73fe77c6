"""A mesh that came with photographs, in the frame of their poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import TO_Z_UP
from gibson_sim.geometry.triangles import unit_normals
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh, thinned
from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.texturing.rasteriser import rasterise
from gibson_sim_tools.texturing.surface import Surface, surface_from_mesh

F64 = NDArray[np.float64]

GREY = 160
"""Colour of meshes without colours at their vertices."""
_TURNS = (("as it is", np.eye(3)), ("with the axes of its file", TO_Z_UP["y"].T), ("turned from y up to z up", TO_Z_UP["y"]))
"""R_poses_mesh that are tried: glTF is y up, and readers turn it to z up, but the poses beside it often are not turned."""
_VIEWS, _WIDTH, _TRIANGLES = 12, 80, 40_000
"""Views by which a turn is judged, their width, pixels, and triangles of the mesh that is drawn."""
_BETTER, _LEAST = 0.15, 0.2
"""Share of the pixels by which another turn must be better, and that must show the front of the mesh."""


def given_mesh(
    path: Path, photographs: Photographs, progress: Callable[[float], None] = lambda _: None
) -> tuple[ColouredMesh, bool, str]:
    """Returns a mesh in the frame of the poses, whether its vertices have colours, and what was found about its frame.

    Raises:
        MeshError: it cannot be read.
        ScanError: hardly any photograph shows it from its front.
    """
    surface = surface_from_mesh(load_mesh(path, [path.resolve().parent]))
    coloured = surface.colors is not None
    colors = np.full((len(surface.vertices), 3), GREY, dtype=np.uint8) if surface.colors is None else surface.colors
    mesh = ColouredMesh(surface.vertices.astype(np.float32), surface.triangles.astype(np.int32), colors)
    coarse = mesh
    if len(mesh.triangles) > _TRIANGLES:
        try:
            coarse = thinned(mesh, _TRIANGLES)
        except MeshError:  # without meshoptimizer, drawing takes longer
            coarse = mesh
    shares = []
    for k, (_, R) in enumerate(_TURNS):
        shares.append(front_share(coarse.vertices @ R.T, coarse.triangles, photographs))
        progress((k + 1) / len(_TURNS))
    best = int(np.argmax(shares))
    best = best if shares[best] > shares[0] + _BETTER else 0
    if shares[best] < _LEAST:
        raise ScanError(
            f"{path}: fills {100.0 * shares[best]:.0f} % of the photographs from its front, at least {100.0 * _LEAST:.0f} % is needed; are mesh "
            "and poses of the same frame and scale, and are its triangles wound towards the room?"
        )
    name, R = _TURNS[best]
    text = f"{path.name}: {len(mesh.triangles)} triangles, {name}; it fills {100.0 * shares[best]:.0f} % of the photographs"
    return replace(mesh, vertices=np.ascontiguousarray(mesh.vertices @ R.T.astype(np.float32))), coloured, text


def front_share(vertices: F64, triangles: NDArray[np.integer], photographs: Photographs) -> float:
    """Returns the share of the pixels of some photographs in which a mesh shows its front, less that of its back."""
    surface = Surface(np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64))
    corners = surface.corners
    normals, middles = unit_normals(corners), corners.mean(axis=1)
    shares = []
    for number in np.unique(np.linspace(0, len(photographs) - 1, _VIEWS).round().astype(int)).tolist():
        full, pose = photographs.intrinsics(number), photographs.items[number].T_world_camera
        small = full.resized(_WIDTH, max(round(_WIDTH * full.height / full.width), 1))
        face = rasterise(surface, small, pose).face
        seen = face[face >= 0]
        front = np.einsum("ij,ij->i", normals[seen], pose[:3, 3] - middles[seen]) > 0.0
        shares.append((int(front.sum()) - int((~front).sum())) / face.size)
    return float(np.mean(shares))
