"""Files for the engine: a temporary folder, OBJ text that the engine reads and writes, and meshes split to its size limits."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError

_VERTEX_LIMIT = 131_000
"""Maximum number of vertices of a collision shape; PyBullet refuses arrays above 131,072 vertices or 524,288 indices."""
_TRIANGLE_LIMIT = 174_000
"""Maximum number of triangles of a collision shape, for the same reason."""
_LISTED: dict[bytes, list[Any]] = {}
"""Digest of an array -> its content as a list, for all meshes ever given to the engine."""


class EngineFiles:
    """The files of one engine, in a temporary folder that ``close`` deletes."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        """Temporary folder, created at first use."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="gibson_sim_physics_")
        return Path(self._folder.name)

    def close(self) -> None:
        """Deletes the files; a second call does nothing."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def write_urdf(self, text: str) -> Path:
        """Writes a text to a file, which the next call overwrites, and returns its path."""
        path = self.folder / "body.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    def copy_obj(self, path: str) -> Path:
        """Copies only the shapes of an OBJ file and returns the copy: the engine would also read textures, and crash on invalid references.

        Raises:
            MeshError: the file cannot be read.
        """
        try:
            text = Path(path).read_bytes()
        except OSError as error:
            raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
        return self.write_obj(shapes_alone(text))

    def write_obj(self, text: bytes) -> Path:
        """Writes an OBJ file and returns its path; equal texts share a file."""
        path = self.folder / f"{hashlib.sha256(text).hexdigest()[:32]}.obj"
        if not path.is_file():
            path.write_bytes(text)
        return path


def to_obj(vertices: NDArray[np.float64], triangles: NDArray[Any]) -> str:
    """Returns the text of an OBJ file with vertices, (V, 3), metres, in full precision, and triangles, (T, 3), indices into them."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join(lines) + "\n"


def shapes_alone(text: bytes) -> bytes:
    """Returns only the vertices, objects and faces of an OBJ file, since other content may crash the engine.

    Vertex indices count from 1; references to texture coordinates and normals, which may be invalid, are removed. Faces are omitted if they have
    fewer than three vertices, or reference an undefined one.
    """
    vertices, objects = _parse(text)
    lines = [b" ".join((b"v", *vertex)) for vertex in vertices]
    for each in objects:
        lines += [each.header] if each.header else []
        lines += [b"f " + b" ".join(b"%d" % corner for corner in face) for face in each.faces]
    return b"\n".join(lines) + b"\n"


def objects_of_obj(text: bytes) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Returns vertices, (V, 3), and triangles, (T, 3), of each object with faces in an OBJ file of triangles."""
    vertices, objects = _parse(text)
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    out = []
    for faces in (each.faces for each in objects if each.faces):
        used, corners = np.unique(np.array(faces, dtype=np.int64) - 1, return_inverse=True)
        out.append((points[used], corners.reshape(-1, 3)))
    return out


@dataclass(slots=True)
class _Object:
    """One object or group of an OBJ file."""

    header: bytes = b""
    """First line of the object, such as ``o lid``; empty = faces before the first such line."""
    faces: list[list[int]] = field(default_factory=list)
    """Vertex indices of each face, from 1."""


def _parse(text: bytes) -> tuple[list[list[bytes]], list[_Object]]:
    """Returns the valid vertices of an OBJ file, three words each, and its objects with their valid faces."""
    vertices: list[list[bytes]] = []
    objects = [_Object()]
    for line in text.splitlines():
        key, *words = line.split() or [b""]
        if key == b"v" and len(words) >= 3 and all(map(_is_number, words[:3])):
            vertices.append(words[:3])
        elif key in (b"o", b"g"):
            objects.append(_Object(b" ".join((key, *words[:1]))))
        elif key == b"f":
            face = [_corner(word, len(vertices)) for word in words]
            if len(face) >= 3 and all(face):
                objects[-1].faces.append(face)
    return vertices, objects


def _is_number(word: bytes) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _corner(word: bytes, count: int) -> int:
    """Returns the vertex index, from 1, of a face element; 0 if it is not among the ``count`` vertices so far."""
    try:
        number = int(word.split(b"/", 1)[0])
    except ValueError:
        return 0
    number = count + 1 + number if number < 0 else number
    return number if 1 <= number <= count else 0


def mesh_pieces(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Yields (vertices, triangles) of pieces below the size limits, split along the longest axis so that each is compact."""
    if len(triangles) <= _TRIANGLE_LIMIT:
        used, corners = np.unique(triangles, return_inverse=True)
        if len(used) <= _VERTEX_LIMIT:
            yield vertices[used], corners.reshape(-1, 3)
            return
    centers = vertices[triangles].mean(axis=1)
    axis = int(np.argmax(np.ptp(centers, axis=0)))
    order = np.argsort(centers[:, axis], kind="stable")
    half = len(order) // 2
    yield from mesh_pieces(vertices, triangles[order[:half]])
    yield from mesh_pieces(vertices, triangles[order[half:]])


def listed_for_ever(array: NDArray[Any]) -> list[Any]:
    """Returns an array as a list, the same object for equal arrays.

    PyBullet leaks a reference to each vertex and index passed to ``createCollisionShape``: with new lists, each new world and each reset would leak
    their memory again.
    """
    key = hashlib.sha256(str((array.dtype, array.shape)).encode() + np.ascontiguousarray(array).tobytes()).digest()
    if key not in _LISTED:
        _LISTED[key] = array.tolist()
    return _LISTED[key]
