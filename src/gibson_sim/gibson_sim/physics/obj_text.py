"""Triangle meshes as the text of OBJ files, exactly, for what reads no arrays. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
