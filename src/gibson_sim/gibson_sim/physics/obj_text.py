"""Triangle meshes as the text of OBJ files, exactly, for what reads no arrays. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_obj(vertices: NDArray[np.float64], triangles: NDArray[Any]) -> str:
    """Returns the text of an OBJ file that holds vertices, (V, 3), metres, exactly, and triangles, (T, 3), indices into them."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    return "\n".join(lines) + "\n"


def without_materials(text: bytes) -> bytes:
    """Returns the text of an OBJ file without the names of its material libraries."""
    return b"".join(line for line in text.splitlines(keepends=True) if not line.lstrip().startswith(b"mtllib"))


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
