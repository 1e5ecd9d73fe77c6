"""Files that an engine reads: they lie in a folder of their own and go with it."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError

_VERTEX_LIMIT = 131_000
"""Vertices of one collision shape; PyBullet refuses arrays above 131,072 vertices or 524,288 indices."""
_TRIANGLE_LIMIT = 174_000


def mesh_pieces(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Yields (vertices, triangles) of pieces below the size limit, cut across the longest axis so that each is compact."""
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


def to_obj(vertices: NDArray[np.float64], triangles: NDArray[Any]) -> str:
    """Returns the text of an OBJ file that holds vertices, (V, 3), metres, exactly, and triangles, (T, 3), indices into them."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join(lines) + "\n"


def shapes_alone(text: bytes) -> bytes:
    """Returns the vertices, objects and faces of an OBJ file, and nothing else that an engine could stumble over.

    Corners are counted from 1 and have neither textures nor normals, whose references may be wrong; faces that name a corner that is not
    there yet, or fewer than three, are left out.
    """
    out: list[bytes] = []
    count = 0
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v" and len(words) >= 4 and all(map(_is_number, words[1:4])):
            count += 1
            out.append(b" ".join(words[:4]))
        elif words[0] in (b"o", b"g"):
            out.append(b" ".join((words[0], *words[1:2])))
        elif words[0] == b"f":
            corners = [_corner(word, count) for word in words[1:]]
            if len(corners) >= 3 and all(corners):
                out.append(b"f " + b" ".join(b"%d" % corner for corner in corners))
    return b"\n".join(out) + b"\n"


def _is_number(word: bytes) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _corner(word: bytes, count: int) -> int:
    """Returns the number of a corner, from 1; 0 where there are only ``count`` others."""
    try:
        number = int(word.split(b"/", 1)[0])
    except ValueError:
        return 0
    number = count + 1 + number if number < 0 else number
    return number if 1 <= number <= count else 0


def objects_of_obj(lines: Sequence[str]) -> list[tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Returns vertices, (V, 3), and triangles, (T, 3), of each object that has any in the lines of an OBJ file."""
    points = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64).reshape(-1, 3)
    out, faces = [], []
    for line in [*lines, "o end"]:
        if line.startswith("f "):
            faces.append([int(corner) - 1 for corner in line.split()[1:4]])
        elif line.startswith("o ") and faces:
            used, corners = np.unique(np.array(faces, dtype=np.int64), return_inverse=True)
            out.append((points[used], corners.reshape(-1, 3)))
            faces = []
    return out


class EngineFiles:
    """Writes them; a second ``close`` does nothing."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        """Where they are."""
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="gibson_sim_physics_")
        return Path(self._folder.name)

    def close(self) -> None:
        """Deletes all of them."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def write_urdf(self, text: str) -> Path:
        """Returns a file with the text; the next one takes its place."""
        path = self.folder / "body.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    def copy_obj(self, path: str) -> Path:
        """Returns an OBJ file with the shapes of another one alone: the engine would read its textures, too, and crash on wrong references.

        Raises:
            MeshError: it cannot be read.
        """
        try:
            text = Path(path).read_bytes()
        except OSError as error:
            raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
        return self.write_obj(shapes_alone(text))

    def write_obj(self, text: bytes) -> Path:
        """Returns an OBJ file with this text; equal ones share a file."""
        path = self.folder / f"{hashlib.sha256(text).hexdigest()[:32]}.obj"
        if not path.is_file():
            path.write_bytes(text)
        return path
