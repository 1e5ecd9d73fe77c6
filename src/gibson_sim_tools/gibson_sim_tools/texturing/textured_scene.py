"""A textured surface as a mesh and as a scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource, area_normals
from gibson_sim_tools.importing.document import BAKED_LIGHT, SIMPLIFIED, ImportedObject, ImportedScene, write_scene
from gibson_sim_tools.importing.scans import is_scan
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh, level_transform
from gibson_sim_tools.texturing.surface import Surface
from gibson_sim_tools.texturing.texture import Textured

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

UNSEEN_MATERIAL = "unseen"
"""Material of the triangles that no photograph shows."""


def write_textured_scene(textured: Textured, output: Path, name: str = "", *, level: bool = False) -> Path:
    """Writes a scene into a new folder and returns its scene.yaml.

    Args:
        textured: metres; z up, or to be levelled.
        output: the folder.
        name: of the scene; empty = that of the folder.
        level: whether to turn it so that z is up and the floor is at z = 0.

    Raises:
        SceneError: the folder is not empty, or cannot be written.
        ScanError: it is to be levelled, and has no level surface.
    """
    mesh = mesh_of(textured)
    if level:
        surface = textured.surface
        whole = ColouredMesh(surface.vertices.astype(np.float32), surface.triangles.astype(np.int32), textured.vertex_colors)
        mesh = mesh.transformed(level_transform(whole, textured.photographs.poses))
    name = name or output.resolve().name
    scene = ImportedScene(name, "textured scan", output.parent, light=BAKED_LIGHT)
    scene.objects = [ImportedObject(name, mesh, collision=SIMPLIFIED if is_scan(mesh) else "same")]
    return write_scene(scene, output)


def mesh_of(textured: Textured) -> Mesh:
    """Returns the textured surface as a mesh: a part for each page, and one with vertex colours for what no photograph shows. Colours include
    the light of the room, so that nothing is shaded.
    """
    surface, plan = textured.surface, textured.atlas
    normals = area_normals(surface.vertices, surface.triangles)
    parts = []
    for number, (width, height) in enumerate(plan.pages):
        rows = np.flatnonzero(plan.page[plan.patch] == number)
        vertices = surface.triangles[plan.faces[rows]]
        keys, first, index = np.unique(
            plan.patch[rows][:, None] * len(surface.vertices) + vertices, return_index=True, return_inverse=True
        )
        of_vertex = vertices.ravel()[first]
        uvs = (plan.corners[rows].reshape(-1, 2)[first] + 0.5) / (width, height)
        source = TextureSource(f"page {number}", textured.pages[number])
        material = Material(f"page_{number}", (1.0, 1.0, 1.0, 1.0), source, unlit=True)
        parts.append(_part(surface, normals, of_vertex, index.reshape(-1, 3), material, uvs.astype(np.float32), None))
        assert len(keys) == len(of_vertex)
    unseen = surface.triangles[textured.labels < 0]
    if len(unseen):
        of_vertex, index = np.unique(unseen, return_inverse=True)
        material = Material(UNSEEN_MATERIAL, (1.0, 1.0, 1.0, 1.0), unlit=True, colored=True)
        parts.append(_part(surface, normals, of_vertex, index.reshape(-1, 3), material, None, textured.vertex_colors[of_vertex]))
    return Mesh(tuple(parts))


def _part(
    surface: Surface, normals: F64, of_vertex: I64, triangles: I64, material: Material, uvs: F32 | None, colors: NDArray[np.uint8] | None
) -> MeshPart:  # fmt: skip
    return MeshPart(
        surface.vertices[of_vertex].astype(np.float32),
        normals[of_vertex].astype(np.float32),
        uvs,
        triangles.astype(np.uint32),
        material,
        colors,
    )
