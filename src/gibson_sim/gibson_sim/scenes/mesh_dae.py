"""Reads COLLADA 1.4 and 1.5 (.dae): geometry of the visual scene, diffuse colours and diffuse textures.

The file's unit and up axis are applied. Skins are drawn in their bind shape; animations, lights and cameras are left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_xml
from gibson_sim.scenes.mesh_dae_materials import DaeMaterials
from gibson_sim.scenes.mesh_types import (
    F64,
    I64,
    TO_Z_UP,
    Material,
    MeshPart,
    UpAxis,
    area_normals,
    build_part,
    fan,
    index_corners,
)
from gibson_sim.scenes.textures import TextureStore, Warn

Element = ElementTree.Element
_MAX_INSTANCES = 100_000
_UP: dict[str, UpAxis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
_NAMESPACE = re.compile(rb'\sxmlns\s*=\s*(".*?"|\'.*?\')')
_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")


def load_dae(
    path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn
) -> tuple[list[MeshPart], UpAxis, float]:
    """Returns the parts in metres with z up, and what the file says of both: its up axis and its metres per unit."""
    # Without the default namespace every path below is a plain tag name.
    root = parse_xml(_NAMESPACE.sub(b"", data, count=1))
    if root.tag != "COLLADA":
        raise MeshError(f"{path}: is not a COLLADA file: its root is <{root.tag[:60]}>")
    unit_m = _unit(path, root, warn)
    up_axis = _UP.get((root.findtext("asset/up_axis") or "Y_UP").strip(), "y")
    to_scene = np.eye(4)
    to_scene[:3, :3] = unit_m * TO_Z_UP[up_axis]
    reader = _Reader(path, root, DaeMaterials(path, root, textures, files, warn), warn)
    return reader.parts(to_scene), up_axis, unit_m


def _unit(path: Path, root: Element, warn: Warn) -> float:
    unit = root.find("asset/unit")
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        warn(f"{path}: <unit meter={quoted(text)}> is no length; 1 is used")
        return 1.0
    return value


class _Reader:
    def __init__(self, path: Path, root: Element, materials: DaeMaterials, warn: Warn) -> None:
        self.path = path
        self.root = root
        self.materials = materials
        self.warn = warn
        self.geometries = {g.get("id", ""): g for g in root.iterfind("library_geometries/geometry")}
        self.controllers = {c.get("id", ""): c for c in root.iterfind("library_controllers/controller")}
        self.nodes = {n.get("id", ""): n for n in root.iter("node")}
        self.scenes = {s.get("id", ""): s for s in root.iterfind("library_visual_scenes/visual_scene")}
        self._instances = 0
        self._pieces: dict[str, list[tuple[str, F64, I64, F64, F64 | None]]] = {}

    def parts(self, to_scene: F64) -> list[MeshPart]:
        instance = self.root.find("scene/instance_visual_scene")
        scene = None if instance is None else self.scenes.get(_ref(instance))
        if scene is None and self.scenes:
            scene = next(iter(self.scenes.values()))
        parts: list[MeshPart] = []
        if scene is None:
            # Some exporters write no scene at all: take every geometry as it lies.
            for name in self.geometries:
                parts += self._geometry(name, None, to_scene)
            return parts
        for child in scene.iterfind("node"):
            parts += self._node(child, to_scene, ())
        return parts

    def _node(self, node: Element, parent: F64, path: tuple[int, ...]) -> Iterator[MeshPart]:
        self._instances += 1
        if id(node) in path or self._instances > _MAX_INSTANCES:
            raise MeshError(
                f"{self.path}: node {quoted(node.get('id'))} contains itself, or there are too many; the file is broken"
            )
        matrix = parent
        for child in node:
            if child.tag in _TRANSFORMS:
                matrix = matrix @ _TRANSFORMS[child.tag](_numbers(child.text))
        here = (*path, id(node))
        for child in node:
            if child.tag == "instance_geometry":
                yield from self._geometry(_ref(child), child, matrix)
            elif child.tag == "instance_controller":
                yield from self._controller(_ref(child), child, matrix)
            elif child.tag == "node":
                yield from self._node(child, matrix, here)
            elif child.tag == "instance_node":
                target = self.nodes.get(_ref(child))
                if target is None:
                    self.warn(f"{self.path}: instance of node {quoted(child.get('url'))}, which is not in the file; left out")
                else:
                    yield from self._node(target, matrix, here)

    def _controller(self, name: str, instance: Element, matrix: F64) -> list[MeshPart]:
        controller = self.controllers.get(name)
        skin = None if controller is None else controller.find("skin")
        if skin is None:
            self.warn(f"{self.path}: controller {quoted(name)} is no skin; left out")
            return []
        bind = skin.findtext("bind_shape_matrix")
        return self._geometry(skin.get("source", "").lstrip("#"), instance, matrix @ _matrix(_numbers(bind)) if bind else matrix)

    def _geometry(self, name: str, instance: Element | None, matrix: F64) -> list[MeshPart]:
        if name not in self.geometries:
            self.warn(f"{self.path}: geometry {quoted(name)} is not in the file; left out")
            return []
        if name not in self._pieces:
            mesh = self.geometries[name].find("mesh")
            self._pieces[name] = [] if mesh is None else _Geometry(self.path, mesh, self.warn).pieces()
        bound = self.materials.bound(instance)
        parts = []
        for symbol, vertices, triangles, normals, uvs in self._pieces[name]:
            material = self.materials.get(bound.get(symbol, symbol)) if symbol else Material()
            part = build_part(str(self.path), vertices, triangles, normals, uvs, material, matrix)
            if part is not None:
                parts.append(part)
        return parts


class _Geometry:
    """One <mesh> while it is read."""

    def __init__(self, path: Path, mesh: Element, warn: Warn) -> None:
        self.path = path
        self.mesh = mesh
        self.warn = warn
        self._sources = {s.get("id", ""): s for s in mesh.iterfind("source")}
        self._arrays: dict[str, F64] = {}

    def pieces(self) -> list[tuple[str, F64, I64, F64, F64 | None]]:
        """Returns (material symbol, vertices, triangles, normals, uvs) of every group of polygons."""
        found = []
        for tag in _PRIMITIVES:
            for group in self.mesh.iterfind(tag):
                piece = self._piece(group, tag)
                if piece is not None:
                    found.append((group.get("material", ""), *piece))
        if not found and (self.mesh.find("lines") is not None or self.mesh.find("linestrips") is not None):
            self.warn(f"{self.path}: lines are not drawn")
        return found

    def _piece(self, group: Element, tag: str) -> tuple[F64, I64, F64, F64 | None] | None:
        semantics, stride = self._inputs(group)
        if "POSITION" not in semantics:
            raise MeshError(f"{self.path}: <{tag}> has no positions; the file is broken")
        corners, triangles = self._corners(group, tag, stride)
        if not len(triangles):
            return None
        offset, positions = semantics["POSITION"]
        p = corners[:, offset]
        columns = [p]
        for name in ("TEXCOORD", "NORMAL"):
            if name in semantics:
                columns.append(corners[:, semantics[name][0]])
        self._check(p, len(positions), "position")
        first, corner = index_corners(*columns)
        if "NORMAL" in semantics:
            normals = self._rows("NORMAL", semantics, corners, first)
        else:
            with np.errstate(invalid="ignore"):
                normals = area_normals(positions, p[triangles])[p[first]]
        uvs = None
        if "TEXCOORD" in semantics:
            uvs = self._rows("TEXCOORD", semantics, corners, first)[:, :2] * (1.0, -1.0) + (0.0, 1.0)
        return positions[p[first]], corner[triangles], normals, uvs

    def _rows(self, name: str, semantics: dict[str, tuple[int, F64]], corners: I64, first: I64) -> F64:
        offset, array = semantics[name]
        index = corners[first, offset]
        self._check(index, len(array), name.lower())
        rows: F64 = array[index]
        return rows

    def _check(self, index: I64, total: int, what: str) -> None:
        if len(index) and (index.min() < 0 or index.max() >= total):
            raise MeshError(f"{self.path}: a triangle names {what} {int(index.max())}, but there are {total}; the file is broken")

    def _inputs(self, group: Element) -> tuple[dict[str, tuple[int, F64]], int]:
        """Returns (offset, values) by semantic, and the number of indices at each corner."""
        found: dict[str, tuple[int, F64]] = {}
        texcoord_set = None
        stride = 0
        for item in group.iterfind("input"):
            semantic, offset = item.get("semantic", ""), int(item.get("offset", "0"))
            stride = max(stride, offset + 1)
            source = item.get("source", "").lstrip("#")
            if semantic == "VERTEX":
                for inner in self.mesh.iterfind("vertices/input"):
                    name = inner.get("semantic", "")
                    if name in ("POSITION", "NORMAL", "TEXCOORD"):
                        found.setdefault(name, (offset, self._array(inner.get("source", "").lstrip("#"))))
            elif semantic == "NORMAL":
                found[semantic] = (offset, self._array(source))
            elif semantic == "TEXCOORD":
                # Several sets: the lowest is the one that the diffuse texture uses, in all files met so far.
                number = int(item.get("set", "0"))
                if texcoord_set is None or number < texcoord_set:
                    texcoord_set = number
                    found[semantic] = (offset, self._array(source))
        return found, stride

    def _array(self, name: str) -> F64:
        """Returns the values of a <source>, (N, stride) float64."""
        if name not in self._arrays:
            source = self._sources.get(name)
            array = None if source is None else source.find("float_array")
            if source is None or array is None:
                raise MeshError(f"{self.path}: source {quoted(name)} has no numbers; the file is broken")
            values = _numbers(array.text)
            accessor = source.find("technique_common/accessor")
            stride = 3 if accessor is None else int(accessor.get("stride", "1"))
            offset = 0 if accessor is None else int(accessor.get("offset", "0"))
            if stride < 1 or not 0 <= offset <= len(values):
                raise MeshError(f"{self.path}: source {quoted(name)} has stride {stride} and offset {offset}; the file is broken")
            rows = (len(values) - offset) // stride
            wanted = rows if accessor is None else int(accessor.get("count", str(rows)))
            if wanted > rows:
                raise MeshError(
                    f"{self.path}: source {quoted(name)} has {rows} rows, {wanted} are promised; the file is cut or broken"
                )
            self._arrays[name] = values[offset : offset + rows * stride].reshape(rows, stride)
        return self._arrays[name]

    def _corners(self, group: Element, tag: str, stride: int) -> tuple[I64, I64]:
        """Returns the index rows of all corners (C, stride), and triangles (F, 3) into them."""
        lists = [_integers(p.text) for p in group.iterfind("p")]
        lists += [_integers(p.text) for p in group.iterfind("ph/p")]
        if not lists:
            return np.zeros((0, stride), np.int64), np.zeros((0, 3), np.int64)
        if any(len(one) % stride for one in lists):
            raise MeshError(f"{self.path}: the indices of a <{tag}> are no multiple of {stride}; the file is cut or broken")
        corners = np.concatenate(lists).reshape(-1, stride)
        counts = np.array([len(one) // stride for one in lists], dtype=np.int64)
        if tag == "triangles":
            return corners, np.arange(len(corners) // 3 * 3).reshape(-1, 3)
        if tag == "polylist":
            counts = _integers(group.findtext("vcount"))
            if counts.sum() != len(corners) or counts.min(initial=0) < 0:
                raise MeshError(
                    f"{self.path}: a <polylist> promises {counts.sum()} corners and has {len(corners)}; the file is cut or broken"
                )
        triangles = fan(counts)
        if tag == "tristrips":
            triangles = np.concatenate(
                [_strip(int(start), int(n)) for start, n in zip(np.cumsum(counts) - counts, counts, strict=True)]
            )
        return corners, triangles


def _strip(start: int, count: int) -> I64:
    k = start + np.arange(max(count - 2, 0))
    triangles = np.stack([k, k + 1, k + 2], axis=1)
    triangles[1::2] = triangles[1::2][:, [0, 2, 1]]
    return triangles


def _ref(element: Element) -> str:
    return element.get("url", "").lstrip("#")


def _numbers(text: str | None) -> F64:
    return np.array((text or "").split(), dtype=np.float64)


def _integers(text: str | None) -> I64:
    return np.array((text or "").split(), dtype=np.int64)


# Transforms: all (4, 4)


def _matrix(values: F64) -> F64:
    return values.reshape(4, 4)


def _translate(values: F64) -> F64:
    matrix = np.eye(4)
    matrix[:3, 3] = values
    return matrix


def _scale(values: F64) -> F64:
    return np.diag([*values[:3], 1.0])


def _rotate(values: F64) -> F64:
    """Axis and angle in degrees (Rodrigues)."""
    x, y, z = values[:3] / np.linalg.norm(values[:3])
    angle = math.radians(values[3])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


_TRANSFORMS = {"matrix": _matrix, "translate": _translate, "scale": _scale, "rotate": _rotate}
