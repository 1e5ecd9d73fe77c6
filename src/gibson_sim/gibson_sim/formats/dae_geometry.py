"""Geometry of COLLADA: the primitives of a ``<mesh>`` as triangles with their normals, texture coordinates and colours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.dae_document import DaeDocument, Element, children, reference
from gibson_sim.formats.mesh import F64, I64, area_normals, index_corners
from gibson_sim.formats.polygons import fan, triangulate, triangulate_with_holes
from gibson_sim.quoting import quoted

_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")
_LEAST_COLUMNS = {"POSITION": 3, "NORMAL": 3, "COLOR": 3}
"""Numbers that one value of a semantic has at least; texture coordinates may lack the second."""
_MOST_COLUMNS = {"POSITION": 3, "NORMAL": 3, "TEXCOORD": 2, "COLOR": 4}
"""Numbers that one value of a semantic has at most; further columns of its source have no meaning."""


@dataclass(frozen=True, slots=True)
class _Input:
    """One <input>."""

    offset: int
    """Which of the indices of a corner is its own."""
    values: F64
    """(N, C)."""


@dataclass(frozen=True, slots=True, eq=False)
class DaeTriangles:
    """Triangles of one material."""

    vertices: F64
    """(V, 3), in the unit and axes of the file."""
    triangles: I64
    """(F, 3)."""
    normals: F64
    """(V, 3)."""
    uvs: F64 | None
    """(V, 2), v downwards."""
    colors: NDArray[np.uint8] | None
    """(V, 3) sRGB."""


class DaePrimitive:
    """One group of polygons of a <mesh>, e.g. a <polylist>.

    Args:
        document: the file.
        group: the element.
        inputs: (semantic, set) -> input.
        corners: indices of all corners, (C, stride).
        triangles: (F, 3), rows of ``corners``.
    """

    def __init__(
        self, document: DaeDocument, group: Element, inputs: dict[tuple[str, int], _Input], corners: I64, triangles: I64
    ) -> None:
        self.symbol = group.get("material", "")
        """Symbol of the material, "" = none."""
        self.sets = sorted(number for semantic, number in inputs if semantic == "TEXCOORD")
        """Numbers of the sets of texture coordinates."""
        self._document = document
        self._inputs = inputs
        self._corners = corners
        self._triangles = triangles
        self._known: dict[int | None, DaeTriangles] = {}

    def read(self, uv_set: int | None) -> DaeTriangles:
        """Returns the triangles with one set of texture coordinates, None = without.

        Raises:
            MeshError: an index is out of range.
        """
        if uv_set not in self._known:
            self._known[uv_set] = self._read(uv_set)
        return self._known[uv_set]

    def _read(self, uv_set: int | None) -> DaeTriangles:
        position = self._inputs["POSITION", 0]
        texcoord = None if uv_set is None else self._inputs["TEXCOORD", uv_set]
        normal = self._inputs.get(("NORMAL", 0))
        color = next((self._inputs[key] for key in sorted(self._inputs) if key[0] == "COLOR"), None)
        columns = [self._corners[:, one.offset] for one in (position, texcoord, normal, color) if one is not None]
        p = columns[0]
        self._check(p, len(position.values), "position")
        first, corner = index_corners(*columns)
        if normal is not None:
            normals = self._rows(normal, first, "normal")
        else:
            with np.errstate(invalid="ignore"):
                normals = area_normals(position.values, p[self._triangles])[p[first]]
        uvs = None
        if texcoord is not None:
            uvs = self._rows(texcoord, first, "texcoord")[:, :2]
            if uvs.shape[1] == 1:
                uvs = np.concatenate([uvs, np.zeros_like(uvs)], axis=1)
            uvs = uvs * (1.0, -1.0) + (0.0, 1.0)
        colors = None if color is None else self._colors(self._rows(color, first, "color"))
        return DaeTriangles(position.values[p[first]], corner[self._triangles], normals, uvs, colors)

    def _colors(self, values: F64) -> NDArray[np.uint8]:
        """Returns colours (V, 3) uint8 of values (V, 3) or (V, 4)."""
        values = np.clip(np.nan_to_num(values), 0.0, 1.0)
        if values.shape[1] > 3 and (values[:, 3] < 1.0).any():
            self._document.warn("the alpha of its vertex colours is left out; they are opaque")
        return np.asarray(np.rint(values[:, :3] * 255.0), dtype=np.uint8)

    def _rows(self, item: _Input, first: I64, what: str) -> F64:
        index = self._corners[first, item.offset]
        self._check(index, len(item.values), what)
        rows: F64 = item.values[index]
        return rows

    def _check(self, index: I64, total: int, what: str) -> None:
        if len(index) and (index.min() < 0 or index.max() >= total):
            wrong = int(index.min() if index.min() < 0 else index.max())
            raise self._document.error(f"a triangle names {what} {wrong}, but there are {total}; the file is broken")


def read_geometry(document: DaeDocument, geometry: Element) -> list[DaePrimitive]:
    """Returns the groups of polygons of a <geometry>; what is not polygons is left out with a warning.

    Raises:
        MeshError: the geometry is broken.
    """
    name = quoted(geometry.get("id"))
    for tag, what in (
        ("spline", "is a spline, which is not drawn"),
        ("brep", "is a boundary representation, which is not drawn"),
    ):
        if geometry.find(tag) is not None:
            document.warn(f"geometry {name} {what}; export it as triangles")
    mesh = geometry.find("mesh")
    if mesh is None:
        # A convex mesh says that it is convex, or which geometry it is the hull of.
        mesh = geometry.find("convex_mesh")
        if mesh is not None and mesh.get("convex_hull_of"):
            document.warn(
                f"geometry {name} is the convex hull of {quoted(mesh.get('convex_hull_of'))}, which is not computed; left out"
            )
    return [] if mesh is None else list(_MeshReader(document, mesh).primitives())


class _MeshReader:
    """Reader of one <mesh>."""

    def __init__(self, document: DaeDocument, mesh: Element) -> None:
        self.document = document
        self.mesh = mesh
        self._sources = {s.get("id", ""): s for s in mesh.iterfind("source")}
        self._values: dict[tuple[str, str], F64] = {}

    def primitives(self) -> Iterator[DaePrimitive]:
        """Yields all groups of polygons that have triangles."""
        for tag in _PRIMITIVES:
            for group in self.mesh.iterfind(tag):
                inputs, stride = self._inputs(group)
                if ("POSITION", 0) not in inputs:
                    raise self.document.error(f"<{tag}> has no positions; the file is broken")
                corners, triangles = self._corners(group, tag, stride, inputs["POSITION", 0])
                if len(triangles):
                    yield DaePrimitive(self.document, group, inputs, corners, triangles)
        if self.mesh.find("lines") is not None or self.mesh.find("linestrips") is not None:
            self.document.warn("lines are not drawn")

    def _inputs(self, group: Element) -> tuple[dict[tuple[str, int], _Input], int]:
        """Returns (semantic, set) -> input, and the number of indices per corner."""
        inputs: dict[tuple[str, int], _Input] = {}
        shared: dict[tuple[str, int], _Input] = {}
        stride = 0
        for item in group.iterfind("input"):
            semantic, offset = item.get("semantic", ""), self.document.whole(item, "offset", 0)
            if offset < 0:
                raise self.document.error(f"offset={offset} of <input> must not be negative")
            stride = max(stride, offset + 1)
            if semantic == "VERTEX":
                for inner in self.mesh.iterfind("vertices/input"):
                    name = inner.get("semantic", "")
                    if name in ("POSITION", "NORMAL", "TEXCOORD", "COLOR"):
                        number = self.document.whole(inner, "set", 0) if name in ("TEXCOORD", "COLOR") else 0
                        shared.setdefault((name, number), _Input(offset, self._array(inner, name)))
            elif semantic == "NORMAL":
                inputs[semantic, 0] = _Input(offset, self._array(item, semantic))
            elif semantic in ("TEXCOORD", "COLOR"):
                inputs.setdefault((semantic, self.document.whole(item, "set", 0)), _Input(offset, self._array(item, semantic)))
        # The inputs of a primitive have precedence over those of its vertices.
        return {**shared, **inputs}, stride

    def _array(self, item: Element, semantic: str) -> F64:
        """Returns the values of the source of an <input>, (N, C) float64."""
        key = (reference(item, "source"), semantic)
        if key not in self._values:
            values = self._source(key[0])
            least = _LEAST_COLUMNS.get(semantic, 1)
            if values.shape[1] < least:
                raise self.document.error(
                    f"source {quoted(key[0])} has {values.shape[1]} numbers per {semantic}, must have at least {least}"
                )
            self._values[key] = values[:, : _MOST_COLUMNS[semantic]]
        return self._values[key]

    def _source(self, name: str) -> F64:
        error = self.document.error
        source = self._sources.get(name)
        accessor = None if source is None else source.find("technique_common/accessor")
        array = None if source is None else next(children(source, "float_array", "int_array"), None)
        if accessor is not None and (array is None or array.get("id") != reference(accessor, "source")):
            # An accessor may read the array of another source.
            named = [a for a in self.mesh.iterfind("source/float_array") if a.get("id") == reference(accessor, "source")]
            array = named[0] if named else array
        if array is None:
            raise error(f"source {quoted(name)} has no numbers; the file is broken")
        values = self.document.numbers(array.text)
        whole = self.document.whole
        stride = 3 if accessor is None else whole(accessor, "stride", 1)
        offset = 0 if accessor is None else whole(accessor, "offset", 0)
        if stride < 1 or not 0 <= offset <= len(values):
            raise error(f"source {quoted(name)} has stride {stride} and offset {offset}; the file is broken")
        # The last row may end with its last parameter.
        columns = _columns(accessor, stride)
        missing = -(len(values) - offset) % stride
        if 0 < missing < stride and stride - missing > max(columns):
            values = np.concatenate([values, np.zeros(missing)])
        rows = (len(values) - offset) // stride
        count = rows if accessor is None else whole(accessor, "count", rows)
        if count > rows:
            raise error(f"source {quoted(name)} has {rows} rows, must have {count}; the file is cut or broken")
        table: F64 = values[offset : offset + rows * stride].reshape(rows, stride)
        return table if columns == list(range(stride)) else table[:, columns]

    def _corners(self, group: Element, tag: str, stride: int, position: _Input) -> tuple[I64, I64]:
        """Returns the indices of all corners (C, stride), and triangles (F, 3) as rows of these."""
        integers = self.document.integers
        lists = [integers(p.text) for p in group.iterfind("p")]
        plain = len(lists)
        # Rings of each polygon with holes: its outline, then its holes.
        holed = [[integers(ring.text) for ring in children(ph, "p", "h")] for ph in group.iterfind("ph")]
        lists += [ring for rings in holed for ring in rings]
        if not lists:
            return np.zeros((0, stride), np.int64), np.zeros((0, 3), np.int64)
        if any(len(one) % stride for one in lists):
            raise self.document.error(f"the indices of a <{tag}> are not a multiple of {stride}; the file is cut or broken")
        corners = np.concatenate(lists).reshape(-1, stride)
        counts = np.array([len(one) // stride for one in lists], dtype=np.int64)
        if tag == "triangles":
            if len(corners) % 3:
                self.document.warn(
                    f"a <triangles> has {len(corners)} corners, not a multiple of 3; the last {len(corners) % 3} are left out"
                )
            return corners, np.arange(len(corners) // 3 * 3).reshape(-1, 3)
        if tag == "polylist":
            counts = integers(group.findtext("vcount"))
            if counts.sum() != len(corners) or counts.min(initial=0) < 0:
                raise self.document.error(
                    f"a <polylist> has {len(corners)} corners, must have {counts.sum()}; the file is cut or broken"
                )
        if (counts < 3).any():
            self.document.warn(f"{int((counts < 3).sum())} polygon(s) of a <{tag}> have fewer than 3 corners; left out")
        if tag == "trifans":
            return corners, fan(counts)
        if tag == "tristrips":
            strips = [_strip(int(start), int(n)) for start, n in zip(np.cumsum(counts) - counts, counts, strict=True)]
            return corners, np.concatenate(strips)
        # Indices out of range are refused where the corners are read.
        index = np.clip(corners[:, position.offset], 0, max(len(position.values) - 1, 0))
        outlines = counts if tag == "polylist" else counts[:plain]
        triangles = [triangulate(position.values[:, :3], index[: outlines.sum()], outlines)[0]]
        start, ring = int(outlines.sum()), plain
        for rings in holed:
            sizes = counts[ring : ring + len(rings)]
            end = start + int(sizes.sum())
            loops = np.split(position.values[index[start:end], :3], np.cumsum(sizes)[:-1])
            triangles.append(triangulate_with_holes(loops) + start)
            start, ring = end, ring + len(rings)
        return corners, np.concatenate(triangles)


def _columns(accessor: Element | None, stride: int) -> list[int]:
    """Returns the columns of an accessor's rows that hold values: those with a named parameter, all if none has a name."""
    params = [] if accessor is None else accessor.findall("param")[:stride]
    named = [k for k, param in enumerate(params) if param.get("name")]
    return named or list(range(stride))


def _strip(start: int, count: int) -> I64:
    """Returns the triangles (F, 3) of a strip of ``count`` corners that begins at ``start``."""
    k = start + np.arange(max(count - 2, 0))
    triangles = np.stack([k, k + 1, k + 2], axis=1)
    triangles[1::2] = triangles[1::2][:, [0, 2, 1]]
    return triangles
