"""Splits a labelled mesh into objects."""

from __future__ import annotations

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
from gibson_sim_tools.importing.document import ImportedObject

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]
NEAR = 0.1
"""Largest distance from a face to the labelled face whose label it gets, metres."""
_MAX_JSON = 64 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class LabelledFaces:
    """Faces with object labels."""

    centres: F64
    """(F, 3), metres, world frame."""
    objects: I64
    """(F,): number of the object."""


def take_apart(mesh: Mesh, objects: list[I64], classes: Mapping[int, str]) -> list[ImportedObject]:
    """Returns one object for each number, named after its class: ``chair_12``.

    Args:
        mesh: the whole mesh, world frame.
        objects: for each part, (F,): object number of each triangle.
        classes: class of each number; missing numbers are unlabelled.
    """
    pieces: dict[int, list[MeshPart]] = {}
    for part, numbers in zip(mesh.parts, objects, strict=True):
        for number in np.unique(numbers).tolist():
            pieces.setdefault(number, []).append(some_triangles(part, numbers == number))
    out = []
    for number in sorted(pieces):
        semantic_class = class_name(classes.get(number, ""))
        name = f"{semantic_class or 'unlabelled'}_{number}"
        out.append(ImportedObject(name, Mesh(tuple(pieces[number])), semantic_class=semantic_class))
    return out


def some_triangles(part: MeshPart, chosen: NDArray[np.bool_]) -> MeshPart:
    """Returns some of the triangles of a part, with the vertices that they use."""
    used, inverse = np.unique(part.triangles[chosen], return_inverse=True)
    return replace(
        part,
        vertices=part.vertices[used],
        normals=part.normals[used],
        uvs=None if part.uvs is None else part.uvs[used],
        colors=None if part.colors is None else part.colors[used],
        triangles=inverse.reshape(-1, 3).astype(np.uint32),
    )


def transfer(mesh: Mesh, labelled: LabelledFaces) -> list[I64]:
    """Returns for each part of a mesh the object number of each triangle, (F,); -1 = no labelled face within ``NEAR``."""
    tree = cKDTree(labelled.centres)
    out = []
    for part in mesh.parts:
        distance, nearest = tree.query(part.vertices[part.triangles].mean(axis=1, dtype=np.float64), distance_upper_bound=NEAR)
        numbers = np.full(len(distance), -1, dtype=np.int64)
        found = np.isfinite(distance)
        numbers[found] = labelled.objects[nearest[found]]
        out.append(numbers)
    return out


def class_name(text: str) -> str:
    """Returns a class name in our form: lower case, words joined by ``_``; empty for names that mean "unlabelled"."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return "" if name in ("undefined", "unknown", "unlabeled", "unlabelled", "other", "void") else name


def replica_classes(path: Path) -> dict[int, str]:
    """Returns the class of each object of an ``info_semantic.json``."""
    document = _json(path)
    try:
        return {int(item["id"]): str(item.get("class_name", "")) for item in document["objects"]}
    except (KeyError, TypeError, ValueError, AttributeError) as e:
        raise SceneError(
            f"{path}: is not a list of objects with id and class_name: {e}; copy the file of the data set again"
        ) from e


def habitat_classes(path: Path) -> dict[int, str]:
    """Returns the class of each object of a Habitat scene: ``info_semantic.json``, ``*.scn`` or ``*.house``."""
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
    found: dict[int, str] = {}
    try:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            words = line.split()
            if words[:1] == ["C"]:
                categories[int(words[1])] = words[5] if len(words) > 5 else words[3]
            elif words[:1] == ["O"]:
                found[int(words[1])] = categories.get(int(words[3]), "").replace("#", " ")
    except (ValueError, IndexError) as e:
        raise SceneError(f"{path}: a line cannot be read ({e}); the file is damaged") from e
    return found


def _json(path: Path) -> Any:
    if path.stat().st_size > _MAX_JSON:
        raise SceneError(f"{path}: has {path.stat().st_size // 2**20} MB, must be at most {_MAX_JSON // 2**20} MB")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as e:
        raise SceneError(f"{path}: is not JSON ({' '.join(str(e).split())[:120]}); copy or download it again") from e
