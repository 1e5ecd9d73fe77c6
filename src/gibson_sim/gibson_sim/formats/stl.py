"""Reads STL, binary and ASCII. The format has no units and no materials: metres, z up and light grey are assumed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import F64, Material, MeshPart, build_part, unit

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def load_stl(path: Path, data: bytes) -> list[MeshPart]:
    """Returns the triangles of an STL file with flat normals, as one part, metres.

    Args:
        path: the file, for messages.
        data: its bytes.

    Raises:
        MeshError: the file is corrupt.
    """
    corners = _corners(path, data)
    edges = corners[:, 1:] - corners[:, :1]
    with np.errstate(invalid="ignore"):
        normals = np.repeat(unit(np.cross(edges[:, 0], edges[:, 1])), 3, axis=0)
    vertices = corners.reshape(-1, 3)
    part = build_part(str(path), vertices, np.arange(len(vertices)).reshape(-1, 3), normals, None, Material())
    return [] if part is None else [part]


def _corners(path: Path, data: bytes) -> F64:
    """Returns the corners of all triangles, (F, 3, 3) float64."""
    if len(data) >= 84:
        count = int.from_bytes(data[80:84], "little")
        if len(data) == 84 + 50 * count:
            return np.frombuffer(data, dtype=_FACET, count=count, offset=84)["corners"].astype(np.float64)
        if not data.lstrip().startswith(b"solid"):
            raise MeshError(
                f"{path}: an STL of {count} triangles has {84 + 50 * count} bytes, this file has {len(data)}; it is cut or broken"
            )
    if not data.lstrip().startswith(b"solid"):
        raise MeshError(f"{path}: is not an STL file")
    words = [word for match in _VERTEX.findall(data) for word in match]
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as e:
        raise MeshError(f"{path}: {e}; the STL is broken") from e
    if len(numbers) % 9:
        raise MeshError(f"{path}: has {len(numbers) // 3} corners, must be a multiple of 3; the STL is cut")
    return numbers.reshape(-1, 3, 3)
