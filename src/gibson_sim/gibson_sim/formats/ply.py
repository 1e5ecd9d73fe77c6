"""Reads PLY, text and binary: polygons and triangle strips with normals, colours of vertices or faces, or a texture. Metres and z up are assumed.

Format: http://paulbourke.net/dataformats/ply/. Colours come from scans and include the light of the room, so these surfaces are unlit.

trimesh (5.2) is not used: it cuts concave polygons into fans, draws no strips, and reads a text file that is cut without a word. plyfile leaves
polygons, strips, colours and textures to its caller.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import F64, I64, MAX_FRACTION, Material, MeshPart, build_part, index_corners
from gibson_sim.formats.polygons import triangulate
from gibson_sim.formats.textures import TextureStore, Warn
from gibson_sim.quoting import quoted

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_START = re.compile(rb"ply[ \t]*(\r\n|\n|\r)")
_MAX_HEADER = 64 * 1024
_INDICES = ("vertex_indices", "vertex_index")
_COLOR_NAMES = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_ALPHA_NAMES = ("alpha", "a")
_ELEMENTS_LEFT_OUT = {
    "edge": "edges are not drawn", "material": "surfaces have the colours of their vertices or faces",
    "multi_texture_vertex": "the surface has no texture", "multi_texture_face": "the surface has no texture",
}  # fmt: skip
"""Element -> what changes without it."""
_WITHOUT_EFFECT = ("vertex", "face", "tristrips", "camera", "range_grid")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))

POINT_CLOUD_ADVICE = (
    "is a point cloud, which has no triangles to draw or to collide with. Convert it to a mesh first, for example with MeshLab "
    "(Filters > Remeshing > Screened Poisson), CloudCompare (Plugins > PoissonRecon) or Open3D "
    "(TriangleMesh.create_from_point_cloud_poisson), and import that"
)
"""Error message for a point cloud, without the name of the file."""


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str = ""
    """Type of the length of a list; empty = the property is not a list."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Ply:
    """Content of a PLY file, unconverted."""

    vertex: Mapping[str, NDArray[Any]]
    """Name of a vertex property -> values, (V,)."""
    corners: I64
    """Vertex indices of the corners of all polygons, concatenated, (C,)."""
    sizes: I64
    """Number of corners of each polygon, (P,)."""
    face: Mapping[str, NDArray[Any]]
    """Name of a polygon property -> values, (P,), without lists."""
    corner_uvs: F64 | None
    """Texture coordinates of the corners, (C, 2), v upwards, or None."""
    texture: str
    """Name of the texture file, empty = none."""
    omissions: tuple[str, ...]
    """What is left out, one line each, without the name of the file."""

    @property
    def positions(self) -> F64:
        """Vertex positions, (V, 3), in the units of the file."""
        return np.stack([np.asarray(self.vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """Vertex colours, (V, 3) uint8 sRGB, or None."""
        return _colors(self.vertex)

    @property
    def corner_colors(self) -> NDArray[np.uint8] | None:
        """Colours of the faces at their corners, (C, 3) uint8 sRGB; None if the faces have none, or the vertices have some."""
        colors = _colors(self.face) if self.colors is None else None
        return None if colors is None else np.repeat(colors, self.sizes, axis=0)

    def triangulated(self) -> tuple[I64, I64]:
        """Returns the triangles of the polygons, (F, 3) rows of ``corners``, and the polygon of each, (F,)."""
        return triangulate(self.positions, self.corners, self.sizes)


def load_ply(path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn) -> list[MeshPart]:
    """Returns the triangles of a PLY file as one part, metres, z up.

    Args:
        path: the file.
        data: its content.
        textures: finds and decodes the images that it names.
        files: list to which the paths of further files that are read are appended.
        warn: called with one line for each element that is left out or replaced.

    Raises:
        MeshError: the file is corrupt, or a point cloud.
    """
    ply = read_ply(path, data)
    for line in ply.omissions:
        warn(f"{path}: {line}")
    material = _material(path, ply, textures, files, warn)
    has_colors = ply.colors is not None or ply.corner_colors is not None
    if has_colors and material is not None and material.texture is not None:
        warn(f"{path}: its colours are left out; the texture is drawn")
    part = ply_part(str(path), ply, ply.triangulated()[0], material)
    return [] if part is None else [part]


def ply_part(what: str, ply: Ply, corner_triangles: I64, material: Material | None = None) -> MeshPart | None:
    """Returns triangles of a PLY file as a part, metres, z up, or None if ``corner_triangles`` is empty.

    Args:
        what: the file, for messages.
        ply: its content.
        corner_triangles: (F, 3), rows of ``ply.corners``.
        material: the material; None = the vertex colours.
    """
    triangles = ply.corners[corner_triangles]
    uvs, rows, colors = _uvs(ply), None, ply.colors
    corner_colors = ply.corner_colors
    if ply.corner_uvs is not None or corner_colors is not None:
        # A vertex on a seam has several texture coordinates or colours.
        used_corners = corner_triangles.ravel()
        columns = [ply.corners[used_corners]]
        if ply.corner_uvs is not None:
            keys = np.rint(np.clip(np.nan_to_num(ply.corner_uvs[used_corners]), -1e6, 1e6) * 65536.0).astype(np.int64)
            columns += [keys[:, 0], keys[:, 1]]
        if corner_colors is not None:
            columns.append(corner_colors[used_corners].astype(np.int64) @ (65536, 256, 1))
        first, inverse = index_corners(*columns)
        rows, triangles = ply.corners[used_corners][first], inverse.reshape(-1, 3)
        uvs = ply.corner_uvs[used_corners][first] if ply.corner_uvs is not None else None if uvs is None else uvs[rows]
        if corner_colors is not None:
            colors = corner_colors[used_corners][first]
        elif colors is not None:
            colors = colors[rows]
    if len(triangles) and (triangles.min() < 0 or (rows is None and triangles.max() >= len(ply.vertex["x"]))):
        raise MeshError(
            f"{what}: a face names a vertex that does not exist; there are {len(ply.vertex['x'])}; the file is broken"
        )
    selection = slice(None) if rows is None else rows
    normals = None
    if all(k in ply.vertex for k in ("nx", "ny", "nz")):
        normals = np.stack([np.asarray(ply.vertex[k], dtype=np.float64) for k in ("nx", "ny", "nz")], axis=1)[selection]
    if uvs is not None:
        uvs = np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)
    part_material = material or Material("vertex colours", (1.0, 1.0, 1.0, 1.0), unlit=True)
    return build_part(
        what,
        ply.positions[selection],
        triangles,
        normals,
        uvs,
        part_material,
        None,
        colors,
    )


def read_ply(path: Path, data: bytes) -> Ply:
    """Returns the content of a PLY file.

    Args:
        path: the file, for messages.
        data: its bytes.

    Raises:
        MeshError: the file is corrupt, truncated, or a point cloud.
    """
    tables, texture_names = _tables(path, data)
    vertex = tables.get("vertex", {})
    if not all(axis in vertex for axis in "xyz"):
        raise MeshError(f"{path}: has no vertices with x, y and z; is it a mesh?")
    face = tables.get("face", {})
    lists = next((face[name] for name in _INDICES if name in face), None)
    strips = next((tables["tristrips"][name] for name in _INDICES if name in tables.get("tristrips", {})), None)
    uses_strips = strips is not None and (lists is None or not len(lists[1]))
    if strips is not None and uses_strips:
        face, lists = {}, _strips(*strips)
    if not len(vertex["x"]):
        raise MeshError(f"{path}: is empty: it has no vertices; export the mesh again")
    if lists is None or not len(lists[1]):
        raise MeshError(f"{path}: {POINT_CLOUD_ADVICE} ({len(vertex['x'])} points)")
    if lists[0].dtype.kind == "f":
        _whole(path, "index of a vertex", lists[0])
    corners, sizes = np.asarray(lists[0], dtype=np.int64), np.asarray(lists[1], dtype=np.int64)
    if len(corners) and (corners.min() < 0 or corners.max() >= len(vertex["x"])):
        index = int(corners.min() if corners.min() < 0 else corners.max())
        raise MeshError(
            f"{path}: a face names vertex {index}, but there are {len(vertex['x'])}; the file is broken, export it again"
        )
    corner_uvs = None
    if "texcoord" in face and np.array_equal(face["texcoord"][1], 2 * sizes):
        corner_uvs = np.asarray(face["texcoord"][0], dtype=np.float64).reshape(-1, 2)
    scalars = {name: values for name, values in face.items() if not isinstance(values, tuple)}
    omissions = _omissions(tables, len(texture_names), uses_strips)
    return Ply(vertex, corners, sizes, scalars, corner_uvs, texture_names[0] if texture_names else "", omissions)


def _strips(values: NDArray[Any], sizes: I64) -> tuple[I64, I64]:
    """Returns the corners of the triangles of strips, (3 F,), and 3 for each; -1 ends a strip, and each second triangle is turned."""
    breaks = np.cumsum(sizes)
    corners = np.insert(np.asarray(values, dtype=np.int64), breaks, -1)
    a, b, c = corners[:-2], corners[1:-1], corners[2:]
    # Place of each triangle within its strip.
    ends = np.flatnonzero(corners == -1)
    start = np.where(corners[:-2] == -1, 0, np.concatenate([[-1], ends])[np.searchsorted(ends, np.arange(len(a)))] + 1)
    turned = (np.arange(len(a)) - start) % 2 == 1
    triangles = np.stack([a, np.where(turned, c, b), np.where(turned, b, c)], axis=1)[(a >= 0) & (b >= 0) & (c >= 0)]
    return triangles.ravel(), np.full(len(triangles), 3, dtype=np.int64)


def _omissions(tables: Mapping[str, Mapping[str, Any]], textures: int, uses_strips: bool) -> tuple[str, ...]:
    """Returns what is left out of a file with ``textures`` names of textures, one line each."""
    vertex, face = tables["vertex"], tables.get("face", {})
    found = [
        f"element {quoted(name)} is left out; {_ELEMENTS_LEFT_OUT.get(name, 'it has no meaning for a surface')}"
        for name in tables
        if name not in _WITHOUT_EFFECT
    ]
    alphas = [table[name] for table in (vertex, face) for name in _ALPHA_NAMES if name in table]
    if any(not isinstance(a, tuple) and len(a) and a.min() < _white(a) for a in alphas):
        found.append("the opacity of its colours is left out; the surface is opaque")
    if _colors(vertex) is not None and _colors(face) is not None:
        found.append("the colours of its faces are left out; those of its vertices are used")
    if "tristrips" in tables and not uses_strips:
        found.append("its triangle strips are left out, since it has faces too")
    if textures > 1:
        found.append(f"names {textures} textures; the first is used for all faces")
    return tuple(found)


def read_ply_tables(path: Path, data: bytes) -> dict[str, dict[str, Any]]:
    """Returns element -> property -> column of a PLY file; a list property is a pair of its concatenated values and the length of each row.

    Args:
        path: the file, for messages.
        data: its bytes.

    Raises:
        MeshError: the file is corrupt or truncated.
    """
    return _tables(path, data)[0]


def _tables(path: Path, data: bytes) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Returns the columns as ``read_ply_tables``, and the names of the textures."""
    binary, elements, textures, at = _header(path, data)
    tables: dict[str, dict[str, Any]] = {}
    words = None if binary else data[at:].split()
    position = 0
    for element in elements:
        if words is None:
            tables[element.name], at = _binary_table(path, element, data, at, binary)
        else:
            tables[element.name], position = _text_table(path, element, words, position)
    return tables, textures


def _material(path: Path, ply: Ply, textures: TextureStore, files: list[Path], warn: Warn) -> Material | None:
    if ply.texture and (ply.corner_uvs is not None or _uvs(ply) is not None):
        texture = textures.from_uri(ply.texture, path, files, warn)
        if texture is not None or not textures.decode:
            return Material("texture", (1.0, 1.0, 1.0, 1.0), texture, unlit=True)
    return None if ply.colors is not None or ply.corner_colors is not None else Material()


def _colors(columns: Mapping[str, Any]) -> NDArray[np.uint8] | None:
    """Returns the colours in the columns of vertices or faces, (N, 3) uint8 sRGB, or None."""
    names = next((n for n in _COLOR_NAMES if all(isinstance(columns.get(k), np.ndarray) for k in n)), None)
    if names is None:
        return None
    values = np.stack([np.asarray(columns[k]) for k in names], axis=1)
    white = _white(values)
    if white == 65535:
        values = values // 257
    elif values.dtype.kind == "f":
        values = np.rint(np.clip(np.nan_to_num(values), 0.0, white) * (255.0 / white))
    return np.asarray(np.clip(values, 0, 255), dtype=np.uint8)


def _white(values: NDArray[Any]) -> float:
    """Returns the value of white, which the format does not specify: programs write fractions, 0 to 255 in any type, and 16 bits."""
    largest = np.nan_to_num(values).max(initial=0)
    if values.dtype.kind == "f":
        return 1.0 if largest <= MAX_FRACTION else 255.0
    return 65535.0 if values.dtype.itemsize == 2 and largest > 255 else 255.0


def _uvs(ply: Ply) -> F64 | None:
    names = next((n for n in _UV_NAMES if all(k in ply.vertex for k in n)), None)
    return None if names is None else np.stack([np.asarray(ply.vertex[k], dtype=np.float64) for k in names], axis=1)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], list[str], int]:
    """Returns the byte order ("" = text), the elements, the names of the textures, and the offset of the data, bytes."""
    mark = len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0
    start = _START.match(data, mark)
    if start is None:
        raise MeshError(
            f"{path}: is not a PLY file (it begins with {quoted(data[:8].decode('ascii', 'replace'))}, must begin with 'ply')"
        )
    # After CR, an LF belongs to the data where lines end with CR only.
    end = re.compile(rb"[\r\n][ \t]*end_header[ \t]*" + (rb"\r" if start[1] == b"\r" else rb"\r?\n")).search(
        data, mark, _MAX_HEADER
    )
    if end is None:
        raise MeshError(f"{path}: the header of the PLY has no end_header; the file is cut or broken")
    order: str | None = None
    elements: list[_Element] = []
    textures: list[str] = []
    for line in data[mark : end.start()].decode("ascii", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1])
            if words[2:] not in ([], ["1.0"]):
                raise MeshError(f"{path}: has version {quoted(' '.join(words[2:]))} of PLY, must be 1.0; export it again")
        elif words[:2] == ["comment", "TextureFile"]:
            textures.append(line.split("TextureFile", 1)[1].strip())
        elif words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdecimal():
                raise MeshError(f"{path}: {quoted(' '.join(words))} must be 'element', a name and a number; the PLY is broken")
            if any(known.name == words[1] for known in elements):
                raise MeshError(
                    f"{path}: has element {quoted(words[1])} twice, must have it once; merge them, or export it again"
                )
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"] and elements:
            elements[-1] = _with_property(path, elements[-1], words[1:])
    if order is None:
        raise MeshError(f"{path}: the format in the header is unknown; known: ascii, binary_little_endian, binary_big_endian")
    return order, elements, textures, end.end()


def _with_property(path: Path, element: _Element, words: list[str]) -> _Element:
    kinds = words[1:3] if words[:1] == ["list"] else words[:1]
    unknown = [kind for kind in kinds if kind not in _TYPES]
    if unknown or len(words) < 2:
        raise MeshError(f"{path}: property {quoted(' '.join(words))} of {element.name} is of an unknown type; the PLY is broken")
    if any(known.name == words[-1] for known in element.properties):
        raise MeshError(f"{path}: {element.name} has property {quoted(words[-1])} twice; the PLY is broken")
    added = _Property(words[-1], _TYPES[kinds[-1]], _TYPES[kinds[0]] if words[0] == "list" else "")
    return _Element(element.name, element.count, (*element.properties, added))


def _binary_table(path: Path, element: _Element, data: bytes, at: int, order: str) -> tuple[dict[str, Any], int]:
    lists = [p for p in element.properties if p.count_kind]
    # Most files have only triangles, or only quads: all rows then have the same layout and are read at once.
    sizes = _first_sizes(element, data, at, order) if lists and element.count else [0] * len(lists)
    dtype = _row_type(element, sizes, order)
    size_bytes = element.count * dtype.itemsize
    uniform = at + size_bytes <= len(data)
    if uniform:
        rows = np.frombuffer(data, dtype=dtype, count=element.count, offset=at)
        uniform = all((rows[f"{p.name} n"] == size).all() for p, size in zip(lists, sizes, strict=True))
    if uniform:
        table: dict[str, Any] = {p.name: rows[p.name] for p in element.properties if not p.count_kind}
        for p, size in zip(lists, sizes, strict=True):
            table[p.name] = (rows[p.name].ravel(), np.full(element.count, size, dtype=np.int64))
        return table, at + size_bytes
    min_bytes = element.count * _row_type(element, [0] * len(lists), order).itemsize
    if not lists or at + min_bytes > len(data):
        raise MeshError(f"{path}: {element.count} rows of {element.name} do not fit into {len(data)} bytes; the file is cut")
    return _uneven_table(path, element, data, at, order)


def _first_sizes(element: _Element, data: bytes, at: int, order: str) -> list[int]:
    sizes = []
    for p in element.properties:
        width = np.dtype(p.kind).itemsize
        if p.count_kind:
            kind = np.dtype(order + p.count_kind)
            size = int(np.frombuffer(data, kind, 1, at)[0]) if at + kind.itemsize <= len(data) else 0
            sizes.append(min(max(size, 0), 255))
            at += kind.itemsize + sizes[-1] * width
        else:
            at += width
    return sizes


def _row_type(element: _Element, sizes: list[int], order: str) -> np.dtype[Any]:
    fields: list[Any] = []
    left = iter(sizes)
    for p in element.properties:
        if p.count_kind:
            fields += [(f"{p.name} n", order + p.count_kind), (p.name, order + p.kind, (next(left),))]
        else:
            fields.append((p.name, order + p.kind))
    return np.dtype(fields)


def _uneven_table(path: Path, element: _Element, data: bytes, at: int, order: str) -> tuple[dict[str, Any], int]:
    """Returns the table of rows of different lengths, read one by one, and the offset after it, bytes."""
    kinds = [(p, np.dtype(order + p.kind), np.dtype(order + p.count_kind) if p.count_kind else None) for p in element.properties]
    sizes: dict[str, list[int]] = {p.name: [] for p in element.properties}
    pieces: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
    byte_order = "little" if order == "<" else "big"
    for _ in range(element.count):
        for p, kind, count_kind in kinds:
            size = 1
            if count_kind is not None:
                size = int.from_bytes(data[at : at + count_kind.itemsize], byte_order)  # type: ignore[arg-type]
                at += count_kind.itemsize
            if at + size * kind.itemsize > len(data):
                raise MeshError(f"{path}: ends in the middle of {element.name}; the file is cut")
            sizes[p.name].append(size)
            pieces[p.name].append(data[at : at + size * kind.itemsize])
            at += size * kind.itemsize
    table: dict[str, Any] = {}
    for p, kind, count_kind in kinds:
        values = np.frombuffer(b"".join(pieces[p.name]), dtype=kind)
        table[p.name] = values if count_kind is None else (values, np.array(sizes[p.name], dtype=np.int64))
    return table, at


def _as_kind(path: Path, what: str, column: NDArray[np.float64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Returns numbers (N,) of a text file, converted to the type in its header.

    Raises:
        MeshError: a whole number is out of range.
    """
    if kind.kind in "iu" and len(column):
        limits = np.iinfo(kind)
        _whole(path, what, column)
        out_of_range = ~((column >= limits.min) & (column <= limits.max))
        if out_of_range.any():
            raise MeshError(f"{path}: {quoted(what)} is {column[out_of_range][0]:g}, must be {limits.min} to {limits.max}")
    with np.errstate(over="ignore"):  # numbers too large for single precision become infinite, which build_part rejects
        return column.astype(kind)


def _whole(path: Path, what: str, values: NDArray[Any]) -> None:
    """Raises MeshError if finite values are no whole numbers."""
    is_fraction = np.isfinite(values) & (values != np.rint(values))
    if is_fraction.any():
        raise MeshError(f"{path}: {quoted(what)} is {values[is_fraction][0]:g}, must be a whole number; the PLY is broken")


def _numbers(path: Path, what: str, words: list[bytes]) -> NDArray[np.float64]:
    """Returns the words (N,) of a text file as numbers.

    Raises:
        MeshError: a word is not a number.
    """
    try:
        return np.array(words, dtype=np.float64)
    except ValueError as e:
        raise MeshError(f"{path}: {what} has a value that is not a number ({e}); the PLY is broken") from e


def _count(path: Path, what: str, word: bytes) -> int:
    try:
        return int(word)
    except ValueError as e:
        raise MeshError(
            f"{path}: the length of {quoted(what)} is {quoted(word.decode('utf-8', 'replace'))}, not a whole number; the PLY is broken"
        ) from e


def _text_table(path: Path, element: _Element, words: list[bytes], at: int) -> tuple[dict[str, Any], int]:
    lists = any(p.count_kind for p in element.properties)
    width = len(element.properties)
    if len(words) - at < element.count * width:
        raise MeshError(f"{path}: ends in the middle of {element.name}; the file is cut")
    if not lists:
        values = _numbers(path, element.name, words[at : at + element.count * width]).reshape(element.count, width)
        table = {p.name: _as_kind(path, p.name, values[:, k], np.dtype(p.kind)) for k, p in enumerate(element.properties)}
        return table, at + element.count * width
    columns: dict[str, Any] = {p.name: [] for p in element.properties}
    sizes: dict[str, list[int]] = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for p in element.properties:
            size = 1
            if p.count_kind:
                size, at = (_count(path, p.name, words[at]) if at < len(words) else -1), at + 1
            if size < 0 or at + size > len(words):
                raise MeshError(f"{path}: ends in the middle of {element.name}; the file is cut")
            columns[p.name] += words[at : at + size]
            sizes[p.name].append(size)
            at += size
    result: dict[str, Any] = {}
    for p in element.properties:
        column = _as_kind(path, p.name, _numbers(path, p.name, columns[p.name]), np.dtype(p.kind))
        result[p.name] = (column, np.array(sizes[p.name], dtype=np.int64)) if p.count_kind else column
    return result, at
