"""Reads labels of HM3D: in ``NAME.semantic.glb`` every object has one colour; ``NAME.semantic.txt`` maps colours to objects."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.errors import SceneError
from gibson_sim.formats.mesh import Mesh, MeshPart
from gibson_sim.quoting import quoted
from gibson_sim_tools.importing.labels import LabelledFaces

_COLOR_TOLERANCE = 2
"""Maximum difference of a colour channel, 0 to 255, between texture and list."""


def labelled_faces_of_textures(mesh: Mesh, lists: Path) -> tuple[LabelledFaces, dict[int, str]]:
    """Returns the labelled faces of a mesh, and the class of each object.

    Args:
        mesh: mesh with coloured textures or vertices, world frame.
        lists: text file with lines of number, colour (RRGGBB), "class", region.

    Raises:
        SceneError: the list cannot be read, or none of its colours is on the mesh.
    """
    colors, classes = _read_list(lists)
    numbers = np.array(list(colors), dtype=np.int64)
    listed_colors = np.array(list(colors.values()), dtype=np.int64).reshape(-1, 3)
    tree = cKDTree(listed_colors)
    centres, objects = [], []
    for part in mesh.parts:
        difference, nearest = tree.query(_triangle_colors(part), p=np.inf)
        is_listed = difference <= _COLOR_TOLERANCE
        centres.append(part.vertices[part.triangles].mean(axis=1, dtype=np.float64)[is_listed])
        objects.append(numbers[nearest[is_listed]])
    faces = LabelledFaces(np.concatenate(centres), np.concatenate(objects))
    if not len(faces.objects):
        raise SceneError(
            f"{lists}: none of its {len(colors)} colours is on the mesh beside it; use --no-semantics, or download both files again"
        )
    return faces, classes


def _read_list(path: Path) -> tuple[dict[int, tuple[int, int, int]], dict[int, str]]:
    colors: dict[int, tuple[int, int, int]] = {}
    classes: dict[int, str] = {}
    for row in csv.reader(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        if len(row) < 3:
            continue  # the header
        try:
            number, (red, green, blue) = int(row[0]), bytes.fromhex(row[1].strip())
        except ValueError as e:
            raise SceneError(
                f"{path}: {quoted(','.join(row))} is not a number, a colour and a class ({e}); download the file again"
            ) from e
        colors[number] = (red, green, blue)
        classes[number] = row[2]
    if not colors:
        raise SceneError(f"{path}: lists no objects; download the file again, or use --no-semantics")
    return colors, classes


def _triangle_colors(part: MeshPart) -> NDArray[np.uint8]:
    """Returns the colour at the centre of each triangle, (F, 3) uint8 sRGB."""
    if part.colors is not None:
        return part.colors[part.triangles[:, 0], :3]
    texture = part.material.texture
    if texture is None or part.uvs is None:
        plain = np.rint(np.array(part.material.base_color[:3]) * 255.0).astype(np.uint8)
        return np.broadcast_to(plain, (len(part.triangles), 3))
    rows, columns = texture.pixels.shape[:2]
    uv = part.uvs[part.triangles].mean(axis=1)
    x = np.clip((uv[:, 0] % 1.0 * columns).astype(np.int64), 0, columns - 1)
    y = np.clip((uv[:, 1] % 1.0 * rows).astype(np.int64), 0, rows - 1)
    return np.asarray(texture.pixels[y, x, :3])
