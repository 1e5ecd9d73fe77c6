"""Reads STL, binary and ASCII. The format has no units and no materials: metres, z up and light grey are assumed.

trimesh (5.2) is not used: it reads a text file that is cut as an empty mesh, and leaves out colours without a word.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import F64, Material, MeshPart, build_part, unit
from gibson_sim.formats.textures import Warn

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# Of text in lower case, which is searched faster than by re.IGNORECASE.
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")
_SOLID = re.compile(rb"solid[^\r\n]*?(?=[\r\n]|\bfacet\s+normal\b|$)")
"""Begin or end of a solid with its name, which may be any text."""
_LOOP = re.compile(rb"outer\s+loop(.*?)endloop", re.DOTALL)


def load_stl(path: Path, data: bytes, warn: Warn) -> list[MeshPart]:
    """Returns the triangles of an STL file as one part, metres, with flat normals by the order of their corners.

    Args:
        path: the file, for messages.
        data: its bytes.
        warn: called with one line for each element that is left out.

    Raises:
        MeshError: the file is corrupt.
    """
    corners = _corners(path, data, warn)
    edges = corners[:, 1:] - corners[:, :1]
    with np.errstate(invalid="ignore"):
        normals = np.repeat(unit(np.cross(edges[:, 0], edges[:, 1])), 3, axis=0)
    vertices = corners.reshape(-1, 3)
    part = build_part(str(path), vertices, np.arange(len(vertices)).reshape(-1, 3), normals, None, Material())
    return [] if part is None else [part]


def _corners(path: Path, data: bytes, warn: Warn) -> F64:
    """Returns the corners of all triangles, (F, 3, 3) float64."""
    data = data.removeprefix(codecs.BOM_UTF8)
    is_text = data.lstrip()[:5].lower() == b"solid"
    # The header of a binary file may begin with "solid" too.
    if is_text and b"\0" in data and b"facet" not in data.lower():
        is_text = False
    if len(data) >= 84:
        count = int.from_bytes(data[80:84], "little")
        size = 84 + 50 * count
        # A text file of this size by chance has no such count: its bytes 80 to 83 are letters.
        if len(data) == size or (len(data) > size and count and not is_text):
            facets = np.frombuffer(data, dtype=_FACET, count=count, offset=84)
            if len(data) > size:
                warn(f"{path}: the {len(data) - size} bytes after its {count} triangles are left out")
            # VisCAM marks a colour by the highest bit, Magics by the header; other values are of no meaning outside of their program.
            if (facets["attribute"] & 0x8000).any() or b"COLOR=" in data[:80]:
                text = f"{path}: the colours of its triangles are left out; the surface is light grey"
                warn(text)
            return facets["corners"].astype(np.float64)
        if not is_text:
            raise MeshError(
                f"{path}: an STL of {count} triangles has {size} bytes, this file has {len(data)}; it is cut or broken"
            )
    if not is_text:
        raise MeshError(f"{path}: is not an STL file")
    return _ascii_corners(path, data)


def _ascii_corners(path: Path, data: bytes) -> F64:
    text = data.lower()
    last = list(_SOLID.finditer(text))[-1]
    if text[last.start() - 3 : last.start()] != b"end" or b"facet" in text[last.end() :]:
        raise MeshError(f"{path}: does not end with 'endsolid'; the STL is cut, export it again")
    text = _SOLID.sub(b"", text)
    corners, facets = _VERTEX.findall(text), text.count(b"facet") - text.count(b"endfacet")
    loops = [len(_VERTEX.findall(loop)) for loop in _LOOP.findall(text)]
    if any(count != 3 for count in loops) or 3 * len(loops) != len(corners) or facets != len(loops):
        wrong = next(
            (f"has a facet of {count} corners" for count in loops if count != 3),
            f"has {len(corners)} corners and {len(loops)} loops in {facets} facets",
        )
        raise MeshError(f"{path}: {wrong}, must have 3 each; the STL is cut or broken")
    try:
        return np.array([float(word) for corner in corners for word in corner]).reshape(-1, 3, 3)
    except ValueError as e:
        raise MeshError(f"{path}: {e}; the STL is broken") from e
