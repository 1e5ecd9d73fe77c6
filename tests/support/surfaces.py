"""Surfaces of many triangles, and their open edges."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource, area_normals
from gibson_sim.render.batching import assembly
from gibson_sim.render.batching.building import build_geometry
from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.lod.clusters import weld

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]


def grid_triangles(rows: int, columns: int) -> I64:
    """Returns two triangles for each cell of ``rows`` x ``columns`` cells; vertices are numbered row by row."""
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    below = corner + columns + 1
    return np.concatenate([np.stack([corner, below, below + 1], 1), np.stack([corner, below + 1, corner + 1], 1)])


def bumpy_sphere(rings: int = 71, radius: float = 1.0, material: Material | None = None) -> MeshPart:
    """Returns a closed surface about the origin, 4 rings (rings - 1) triangles, whose texture has a seam and two poles."""
    columns = 2 * rings
    around = 2 * math.pi * (np.arange(columns + 1) % columns) / columns
    down, turn = (g.ravel() for g in np.meshgrid(np.linspace(0.0, math.pi, rings + 1), around, indexing="ij"))
    sine = np.where((down == 0.0) | (down == math.pi), 0.0, np.sin(down))  # each pole is one place
    way = np.stack([sine * np.cos(turn), sine * np.sin(turn), np.cos(down)], axis=1)
    x, y, z = way.T
    height = 1.0 + 0.08 * np.sin(4 * x + 1) * np.sin(5 * y) * np.sin(3 * z + 2) + 0.004 * np.sin(17 * x) * np.sin(23 * y + z)
    vertices = (radius * height[:, None] * way).astype(np.float32)
    triangles = grid_triangles(rings, columns)
    corners = vertices[triangles]
    flat = np.zeros(len(triangles), dtype=bool)
    for k in range(3):
        flat |= (corners[:, k] == corners[:, k - 1]).all(axis=1)
    triangles = triangles[~flat]
    number = weld(vertices)
    normals = area_normals(vertices, triangles)
    total = np.zeros((int(number.max()) + 1, 3))
    np.add.at(total, number, normals)
    normals = total[number] / np.linalg.norm(total[number], axis=1, keepdims=True)
    uvs = np.stack(
        [np.tile(np.arange(columns + 1) / columns, rings + 1), np.repeat(np.arange(rings + 1) / rings, columns + 1)], 1
    )
    return MeshPart(
        vertices, normals.astype(np.float32), uvs.astype(np.float32), triangles.astype(np.uint32), material or Material()
    )


def bumpy_grid(cells: int = 100, half: float = 2.0, height: float = 0.1, material: Material | None = None) -> MeshPart:
    """Returns a relief z(x, y) over a square about the origin, 2 cells^2 triangles, with a texture once over it."""
    axis = np.linspace(-half, half, cells + 1)
    x, y = (g.ravel() for g in np.meshgrid(axis, axis, indexing="ij"))
    z = height * (np.sin(2.1 * x + 0.3) * np.sin(1.7 * y) + 0.1 * np.sin(9 * x) * np.sin(7 * y + 1))
    vertices = np.stack([x, y, z], axis=1).astype(np.float32)
    triangles = grid_triangles(cells, cells)
    uvs = np.stack([x, y], axis=1) / (2 * half) + 0.5
    normals = area_normals(vertices, triangles).astype(np.float32)
    return MeshPart(vertices, normals, uvs.astype(np.float32), triangles.astype(np.uint32), material or Material())


def in_two(part: MeshPart, other: Material, axis: int = 0) -> Mesh:
    """Returns a surface cut along its middle into triangles that keep their material and triangles that get ``other``."""
    upper = part.vertices[part.triangles].mean(axis=1)[:, axis] > part.vertices[:, axis].mean()
    return Mesh(tuple(_picked(part, part.triangles[side], m) for side, m in ((upper, part.material), (~upper, other))))


def _picked(part: MeshPart, triangles: NDArray[np.uint32], material: Material) -> MeshPart:
    used, numbers = np.unique(triangles, return_inverse=True)
    assert part.uvs is not None
    return MeshPart(part.vertices[used], part.normals[used], part.uvs[used], numbers.reshape(-1, 3).astype(np.uint32), material)


def textured(name: str, unlit: bool = True) -> Material:
    """Returns a material with a unique texture: smooth stripes in both directions."""
    v, u = np.mgrid[:64, :64] / 64.0 * 2 * math.pi
    pixels = np.stack([128 + 60 * np.sin(2 * u), 128 + 60 * np.sin(2 * v), 128 + 60 * np.sin(u + v + len(name))], axis=-1)
    return Material(name, (1.0, 1.0, 1.0, 1.0), TextureSource(name, pixels.astype(np.uint8)), unlit=unlit)


def detail_from(triangles: int) -> AbstractContextManager[object]:
    """Enables levels of detail from this number of triangles, within the context."""
    return mock.patch.object(assembly, "DETAIL_FROM", triangles)


def geometry_of(mesh: Mesh, levels_of_detail: bool = True) -> SceneGeometry:
    """Returns the renderer's geometry of a mesh in the world, with levels of detail at any size."""
    visual = VisualSpec("mesh", "", Shape("mesh", mesh="/mesh"))
    with detail_from(1):
        return build_geometry([visual], (), lambda shape: mesh, levels_of_detail=levels_of_detail)


def drawn_positions(scene: SceneGeometry, clusters: I64) -> F32:
    """Returns the corners of all triangles of some clusters, (F, 3, 3), metres."""
    rows = [
        np.arange(first, first + count)
        for first, count in zip(scene.cluster_first[clusters].tolist(), scene.cluster_count[clusters].tolist(), strict=True)
    ]
    corners: F32 = scene.vertices["position"][scene.indices[np.concatenate(rows)]]
    return corners.reshape(-1, 3, 3)


def open_edges(corners: F32) -> F32:
    """Returns the edges of one triangle only, (E, 2, 3), from start to end in its winding order."""
    number = weld(corners.reshape(-1, 3))
    _, first = np.unique(number, return_index=True)
    spot, number = corners.reshape(-1, 3)[first], number.reshape(-1, 3)
    count = int(number.max()) + 1
    start, end = number.ravel(), np.roll(number, -1, axis=1).ravel()
    codes, inverse = np.unique(np.concatenate([start * count + end, end * count + start]), return_inverse=True)
    surplus = np.bincount(inverse, weights=np.repeat([1.0, -1.0], len(start)), minlength=len(codes))
    code = np.repeat(codes, np.maximum(surplus, 0).astype(np.int64))
    code = code[code // count != code % count]
    return np.stack([spot[code // count], spot[code % count]], axis=1)
