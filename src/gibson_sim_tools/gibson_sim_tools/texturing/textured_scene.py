"""Converts a textured surface to a mesh, and writes it as a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource, area_normals
from gibson_sim_tools.importing.document import BAKED_LIGHT, SIMPLIFIED, ImportedObject, ImportedScene, is_scan, write_scene
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, level_transform
from gibson_sim_tools.texturing.texture import TexturedSurface

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

UNSEEN_MATERIAL = "unseen"
"""Name of the material of unseen triangles."""


def write_textured_scene(textured: TexturedSurface, output: Path, name: str = "", *, level: bool = False) -> Path:
    """Writes a scene into a new folder and returns the path of its scene.yaml.

    Args:
        textured: the surface, metres; z up unless ``level``.
        output: the folder.
        name: name of the scene; empty = that of the folder.
        level: rotate and translate the mesh so that z is up and the floor is at z = 0.

    Raises:
        SceneError: the folder is not empty, or cannot be written.
        ScanError: ``level`` is set, and the mesh has no level surface.
    """
    mesh = textured_mesh(textured)
    if level:
        mesh = mesh.transformed(level_transform(textured.surface, textured.photographs.poses))
    name = name or output.resolve().name
    scene = ImportedScene(name, "textured scan", output.parent, light=BAKED_LIGHT)
    scene.objects = [ImportedObject(name, mesh, collision=SIMPLIFIED if is_scan(mesh) else "same")]
    return write_scene(scene, output)


def textured_mesh(textured: TexturedSurface) -> Mesh:
    """Returns the textured surface as a mesh: one part per page, and one with vertex colours for the unseen triangles.

    Materials are unlit, because the photographs include the lighting of the room.
    """
    surface, atlas = textured.surface, textured.atlas
    normals = area_normals(surface.vertices, surface.triangles)
    parts = []
    for number, (width, height) in enumerate(atlas.pages):
        rows = np.flatnonzero(atlas.page[atlas.patch] == number)
        vertices = surface.triangles[atlas.faces[rows]]
        keys, first, index = np.unique(
            atlas.patch[rows][:, None] * len(surface.vertices) + vertices, return_index=True, return_inverse=True
        )
        vertex_rows = vertices.ravel()[first]
        uvs = (atlas.corners[rows].reshape(-1, 2)[first] + 0.5) / (width, height)
        source = TextureSource(f"page {number}", textured.pages[number])
        material = Material(f"page_{number}", (1.0, 1.0, 1.0, 1.0), source, unlit=True)
        parts.append(_mesh_part(surface, normals, vertex_rows, index.reshape(-1, 3), material, uvs.astype(np.float32), None))
        assert len(keys) == len(vertex_rows)
    unseen = surface.triangles[textured.labels < 0]
    if len(unseen):
        vertex_rows, index = np.unique(unseen, return_inverse=True)
        material = Material(UNSEEN_MATERIAL, (1.0, 1.0, 1.0, 1.0), unlit=True, colored=True)
        parts.append(
            _mesh_part(surface, normals, vertex_rows, index.reshape(-1, 3), material, None, textured.vertex_colors[vertex_rows])
        )
    return Mesh(tuple(parts))


def _mesh_part(
    surface: TriangleMesh, normals: F64, vertex_rows: I64, triangles: I64, material: Material, uvs: F32 | None, colors: NDArray[np.uint8] | None
) -> MeshPart:  # fmt: skip
    return MeshPart(
        surface.vertices[vertex_rows].astype(np.float32),
        normals[vertex_rows].astype(np.float32),
        uvs,
        triangles.astype(np.uint32),
        material,
        colors,
    )
