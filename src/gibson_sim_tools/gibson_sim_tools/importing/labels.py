"""Splits a labelled mesh into objects.

Labels of HM3D: in ``NAME.semantic.glb`` every object has one colour; ``NAME.semantic.txt`` maps colours to objects.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.errors import SceneError
from gibson_sim.formats.mesh import Mesh, MeshPart
from gibson_sim.quoting import quoted
from gibson_sim_tools.importing.document import ImportedObject

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
MAX_LABEL_DISTANCE = 0.1
"""Maximum distance between a face and the labelled face whose label it receives, m."""
_MAX_JSON_BYTES = 64 * 2**20
_COLOR_TOLERANCE = 2
"""Maximum difference of a colour channel, 0 to 255, between texture and list."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFaces:
    """Faces with object labels."""

    centres: F64
    """Centres of the faces, (F, 3), m, world frame."""
    objects: I64
    """Object number of each face, (F,)."""


def split_objects(mesh: Mesh, objects: list[I64], classes: Mapping[int, str]) -> list[ImportedObject]:
    """Splits a mesh into one object for each number, named after its class: ``chair_12``.

    Args:
        mesh: the whole mesh, world frame.
        objects: object number of each triangle, (F,), for each part.
        classes: class of each object number; missing numbers are unlabelled.
    """
    parts_by_object: dict[int, list[MeshPart]] = {}
    for part, numbers in zip(mesh.parts, objects, strict=True):
        for number in np.unique(numbers).tolist():
            parts_by_object.setdefault(number, []).append(select_triangles(part, numbers == number))
    out = []
    for number in sorted(parts_by_object):
        semantic_class = class_name(classes.get(number, ""))
        name = f"{semantic_class or 'unlabelled'}_{number}"
        out.append(ImportedObject(name, Mesh(tuple(parts_by_object[number])), semantic_class=semantic_class))
    return out


def select_triangles(part: MeshPart, is_selected: NDArray[np.bool_]) -> MeshPart:
    """Returns the selected triangles of a part, with only the vertices that they use. ``is_selected``: (F,)."""
    used, inverse = np.unique(part.triangles[is_selected], return_inverse=True)
    return replace(
        part,
        vertices=part.vertices[used],
        normals=part.normals[used],
        uvs=None if part.uvs is None else part.uvs[used],
        colors=None if part.colors is None else part.colors[used],
        light_uvs=None if part.light_uvs is None else part.light_uvs[used],
        triangles=inverse.reshape(-1, 3).astype(np.uint32),
    )


def transfer_labels(mesh: Mesh, labelled: LabelledFaces) -> list[I64]:
    """Returns the object number of each triangle, (F,), for each part of a mesh; -1 = no labelled face within ``MAX_LABEL_DISTANCE``."""
    tree = cKDTree(labelled.centres)
    out = []
    for part in mesh.parts:
        distance, nearest = tree.query(
            part.vertices[part.triangles].mean(axis=1, dtype=np.float64), distance_upper_bound=MAX_LABEL_DISTANCE
        )
        numbers = np.full(len(distance), -1, dtype=np.int64)
        is_near = np.isfinite(distance)
        numbers[is_near] = labelled.objects[nearest[is_near]]
        out.append(numbers)
    return out


def class_name(text: str) -> str:
    """Normalises a class name: lower case, words joined by ``_``; empty for names that mean "unlabelled"."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return "" if name in ("undefined", "unknown", "unlabeled", "unlabelled", "other", "void") else name


def replica_classes(path: Path) -> dict[int, str]:
    """Returns the class of each object number, from an ``info_semantic.json``."""
    document = _json(path)
    try:
        return {int(item["id"]): str(item.get("class_name", "")) for item in document["objects"]}
    except (KeyError, TypeError, ValueError, AttributeError) as e:
        raise SceneError(
            f"{path}: is not a list of objects with id and class_name: {e}; copy the file of the data set again"
        ) from e


def habitat_classes(path: Path) -> dict[int, str]:
    """Returns the class of each object number of a Habitat scene, from ``info_semantic.json``, ``*.scn`` or ``*.house``."""
    if path.suffix == ".house":
        return _house_classes(path)
    if path.suffix == ".scn":
        document = _json(path)
        try:
            return {int(item["id"]): str(item["class_"]) for item in document["objects"]}
        except (KeyError, TypeError, ValueError) as e:
            raise SceneError(f"{path}: is not a list of objects with id and class_: {e}") from e
    return replica_classes(path)


def _house_classes(path: Path) -> dict[int, str]:
    """Reads a Matterport house: lines ``C index mapping name ...`` for categories and ``O index region category ...`` for objects."""
    categories: dict[int, str] = {}
    objects: dict[int, str] = {}
    try:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            words = line.split()
            if words[:1] == ["C"]:
                categories[int(words[1])] = words[5] if len(words) > 5 else words[3]
            elif words[:1] == ["O"]:
                objects[int(words[1])] = categories.get(int(words[3]), "").replace("#", " ")
    except (ValueError, IndexError) as e:
        raise SceneError(f"{path}: a line cannot be read ({e}); the file is damaged") from e
    return objects


def _json(path: Path) -> Any:
    if path.stat().st_size > _MAX_JSON_BYTES:
        raise SceneError(f"{path}: has {path.stat().st_size // 2**20} MB, must be at most {_MAX_JSON_BYTES // 2**20} MB")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as e:
        raise SceneError(f"{path}: is not JSON ({' '.join(str(e).split())[:120]}); copy or download it again") from e


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
