"""Reads COLLADA 1.4 and 1.5 (.dae): geometry of the visual scene, diffuse colours and diffuse textures.

The file's unit and up axis are applied. Skins are drawn in their bind pose; animations, lights and cameras are ignored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.formats.mesh import (
    F64,
    I64,
    LIGHT_GREY,
    TO_Z_UP,
    AlphaMode,
    Material,
    MeshPart,
    TextureSource,
    UpAxis,
    area_normals,
    build_part,
    fan,
    index_corners,
)
from gibson_sim.formats.textures import TextureStore, Warn
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_xml
from gibson_sim.types import Rgba

Element = ElementTree.Element

_NAMESPACE = re.compile(rb'\sxmlns\s*=\s*(".*?"|\'.*?\')')
_UP: dict[str, UpAxis] = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}
_PRIMITIVES = ("triangles", "polylist", "polygons", "trifans", "tristrips")
_SHADERS = ("phong", "blinn", "lambert", "constant")
_MAX_INSTANCES = 100_000
"""Maximum number of node instances in the scene."""
_LEAST_ALPHA = 0.02
"""Opacity below which a surface counts as opaque, since no exporter writes invisible surfaces, as does an opacity above 1 minus this."""


def load_dae(
    path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn
) -> tuple[list[MeshPart], UpAxis, float]:
    """Returns the parts of a COLLADA file, metres, z up, and the file's up axis and unit, metres.

    Args:
        path: the file.
        data: its content.
        textures: finds and decodes the images that it names.
        files: list to which the paths of further files that are read are appended.
        warn: called with one line for each element that is left out or replaced.

    Raises:
        MeshError: the file is not a COLLADA file, or is corrupt.
    """
    # Remove the default namespace, so that all paths below are plain tag names.
    root = parse_xml(_NAMESPACE.sub(b"", data, count=1))
    if root.tag != "COLLADA":
        raise MeshError(f"{path}: is not a COLLADA file: its root is <{root.tag[:60]}>")
    unit_m = _unit(path, root, warn)
    up_axis = _UP.get((root.findtext("asset/up_axis") or "Y_UP").strip(), "y")
    to_scene = np.eye(4)
    to_scene[:3, :3] = unit_m * TO_Z_UP[up_axis]
    reader = _DaeReader(path, root, _DaeMaterials(path, root, textures, files, warn), warn)
    return reader.parts(to_scene), up_axis, unit_m


def _unit(path: Path, root: Element, warn: Warn) -> float:
    """Returns the unit of a file, metres."""
    unit = root.find("asset/unit")
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        warn(f"{path}: <unit meter={quoted(text)}> is not a length; 1 is used")
        return 1.0
    return value


class _DaeReader:
    """Reader of one document."""

    def __init__(self, path: Path, root: Element, materials: _DaeMaterials, warn: Warn) -> None:
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
        """Returns all parts, transformed by ``to_scene``, T_scene_file, (4, 4)."""
        instance = self.root.find("scene/instance_visual_scene")
        scene = None if instance is None else self.scenes.get(_ref(instance))
        if scene is None and self.scenes:
            scene = next(iter(self.scenes.values()))
        parts: list[MeshPart] = []
        if scene is None:
            # Some exporters write no scene: place every geometry at the origin.
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
        node_path = (*path, id(node))
        for child in node:
            if child.tag == "instance_geometry":
                yield from self._geometry(_ref(child), child, matrix)
            elif child.tag == "instance_controller":
                yield from self._controller(_ref(child), child, matrix)
            elif child.tag == "node":
                yield from self._node(child, matrix, node_path)
            elif child.tag == "instance_node":
                target = self.nodes.get(_ref(child))
                if target is None:
                    self.warn(f"{self.path}: instance of node {quoted(child.get('url'))}, which is not in the file; left out")
                else:
                    yield from self._node(target, matrix, node_path)

    def _controller(self, name: str, instance: Element, matrix: F64) -> list[MeshPart]:
        controller = self.controllers.get(name)
        skin = None if controller is None else controller.find("skin")
        if skin is None:
            self.warn(f"{self.path}: controller {quoted(name)} is not a skin; left out")
            return []
        bind = skin.findtext("bind_shape_matrix")
        return self._geometry(skin.get("source", "").lstrip("#"), instance, matrix @ _matrix(_numbers(bind)) if bind else matrix)

    def _geometry(self, name: str, instance: Element | None, matrix: F64) -> list[MeshPart]:
        if name not in self.geometries:
            self.warn(f"{self.path}: geometry {quoted(name)} is not in the file; left out")
            return []
        if name not in self._pieces:
            mesh = self.geometries[name].find("mesh")
            self._pieces[name] = [] if mesh is None else _DaeGeometry(self.path, mesh, self.warn).pieces()
        bindings = self.materials.bound(instance)
        parts = []
        for symbol, vertices, triangles, normals, uvs in self._pieces[name]:
            material = self.materials.get(bindings.get(symbol, symbol)) if symbol else Material()
            part = build_part(str(self.path), vertices, triangles, normals, uvs, material, matrix)
            if part is not None:
                parts.append(part)
        return parts


class _DaeGeometry:
    """Reader of one <mesh>."""

    def __init__(self, path: Path, mesh: Element, warn: Warn) -> None:
        self.path = path
        self.mesh = mesh
        self.warn = warn
        self._sources = {s.get("id", ""): s for s in mesh.iterfind("source")}
        self._arrays: dict[str, F64] = {}

    def pieces(self) -> list[tuple[str, F64, I64, F64, F64 | None]]:
        """Returns (material symbol, vertices (V, 3), triangles (F, 3), normals (V, 3), uvs (V, 2) or None) of each group of polygons."""
        pieces = []
        for tag in _PRIMITIVES:
            for group in self.mesh.iterfind(tag):
                piece = self._piece(group, tag)
                if piece is not None:
                    pieces.append((group.get("material", ""), *piece))
        if not pieces and (self.mesh.find("lines") is not None or self.mesh.find("linestrips") is not None):
            self.warn(f"{self.path}: lines are not drawn")
        return pieces

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
        """Returns (offset, values (N, C)) of each semantic, and the number of indices per corner."""
        inputs: dict[str, tuple[int, F64]] = {}
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
                        inputs.setdefault(name, (offset, self._array(inner.get("source", "").lstrip("#"))))
            elif semantic == "NORMAL":
                inputs[semantic] = (offset, self._array(source))
            elif semantic == "TEXCOORD":
                # Assume that the diffuse texture uses the lowest of several sets, as in all known files.
                number = int(item.get("set", "0"))
                if texcoord_set is None or number < texcoord_set:
                    texcoord_set = number
                    inputs[semantic] = (offset, self._array(source))
        return inputs, stride

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
            count = rows if accessor is None else int(accessor.get("count", str(rows)))
            if count > rows:
                raise MeshError(
                    f"{self.path}: source {quoted(name)} has {rows} rows, must have {count}; the file is cut or broken"
                )
            self._arrays[name] = values[offset : offset + rows * stride].reshape(rows, stride)
        return self._arrays[name]

    def _corners(self, group: Element, tag: str, stride: int) -> tuple[I64, I64]:
        """Returns the indices of all corners (C, stride), and triangles (F, 3) as rows of these."""
        lists = [_integers(p.text) for p in group.iterfind("p")]
        lists += [_integers(p.text) for p in group.iterfind("ph/p")]
        if not lists:
            return np.zeros((0, stride), np.int64), np.zeros((0, 3), np.int64)
        if any(len(one) % stride for one in lists):
            raise MeshError(f"{self.path}: the indices of a <{tag}> are not a multiple of {stride}; the file is cut or broken")
        corners = np.concatenate(lists).reshape(-1, stride)
        counts = np.array([len(one) // stride for one in lists], dtype=np.int64)
        if tag == "triangles":
            return corners, np.arange(len(corners) // 3 * 3).reshape(-1, 3)
        if tag == "polylist":
            counts = _integers(group.findtext("vcount"))
            if counts.sum() != len(corners) or counts.min(initial=0) < 0:
                raise MeshError(
                    f"{self.path}: a <polylist> has {len(corners)} corners, must have {counts.sum()}; the file is cut or broken"
                )
        triangles = fan(counts)
        if tag == "tristrips":
            triangles = np.concatenate(
                [_strip(int(start), int(n)) for start, n in zip(np.cumsum(counts) - counts, counts, strict=True)]
            )
        return corners, triangles


class _DaeMaterials:
    """Materials of one file, each read at its first use."""

    def __init__(self, path: Path, root: Element, textures: TextureStore, files: list[Path], warn: Warn) -> None:
        self.path = path
        self.textures = textures
        self.files = files
        self.warn = warn
        self._materials = {m.get("id", ""): m for m in root.iterfind("library_materials/material")}
        self._effects = {e.get("id", ""): e for e in root.iterfind("library_effects/effect")}
        self._images = {i.get("id", ""): i for i in root.iterfind("library_images/image")}
        self._known: dict[str, Material] = {}

    def bound(self, instance: Element | None) -> dict[str, str]:
        """Returns symbol -> material id, as bound by an <instance_geometry>."""
        if instance is None:
            return {}
        return {m.get("symbol", ""): m.get("target", "").lstrip("#") for m in instance.iter("instance_material")}

    def get(self, name: str) -> Material:
        """Returns a material by id; light grey, with a warning, if it does not exist."""
        if name not in self._known:
            self._known[name] = self._read(name)
        return self._known[name]

    def _read(self, name: str) -> Material:
        source = self._materials.get(name)
        instance = None if source is None else source.find("instance_effect")
        effect = None if instance is None else self._effects.get(instance.get("url", "").lstrip("#"))
        if effect is None:
            self.warn(f"{self.path}: material {quoted(name)} is not in the file; the surface is light grey")
            return Material(name)
        shader = next((found for tag in _SHADERS if (found := effect.find(f".//{tag}")) is not None), None)
        if shader is None:
            return Material(name)
        color: Rgba = LIGHT_GREY
        texture = None
        # A <constant> shader has no diffuse colour; it shows its emission.
        for slot in ("diffuse", "emission") if shader.tag == "constant" else ("diffuse",):
            diffuse = shader.find(slot)
            if diffuse is None:
                continue
            image = diffuse.find("texture")
            if image is not None:
                texture = self._texture(effect, image.get("texture", ""))
                color = (1.0, 1.0, 1.0, 1.0) if texture is not None else LIGHT_GREY
            else:
                color = _color(diffuse.findtext("color")) or LIGHT_GREY
            break
        alpha = _alpha(shader)
        transparent = shader.find("transparent/texture")
        mode: AlphaMode = "opaque"
        if alpha < 1.0:
            mode = "blend"
        elif transparent is not None and texture is not None and texture.pixels.shape[2] == 4:
            mode = "mask"
        return Material(name, (*color[:3], alpha), texture, alpha_mode=mode)

    def _texture(self, effect: Element, name: str) -> TextureSource | None:
        """Returns the image of a sampler (sampler -> surface -> image); ``name`` may also be the id of the image itself."""
        for _ in range(3):
            if name in self._images:
                break
            parameter = next((p for p in effect.iter("newparam") if p.get("sid") == name), None)
            if parameter is None:
                break
            image = parameter.find(".//instance_image")
            source = parameter.findtext("sampler2D/source") or parameter.findtext("surface/init_from")
            name = (image.get("url", "").lstrip("#") if image is not None else source or "").strip()
        if name not in self._images:
            self.warn(f"{self.path}: image {quoted(name)} is not in the file; the surface is drawn without it")
            return None
        init = self._images[name].find("init_from")
        uri = "" if init is None else (init.text or init.findtext("ref") or "").strip()
        if not uri:
            self.warn(f"{self.path}: image {quoted(name)} names no file; the surface is drawn without it")
            return None
        return self.textures.from_uri(uri, self.path, self.files, self.warn)


def _color(text: str | None) -> Rgba | None:
    """Returns a colour, 0 to 1; None if the text has fewer than three numbers."""
    values = [min(max(float(word), 0.0), 1.0) for word in (text or "").split()]
    if len(values) < 3:
        return None
    return (values[0], values[1], values[2], values[3] if len(values) > 3 else 1.0)


def _alpha(shader: Element) -> float:
    """Returns the opacity, 0 to 1, by COLLADA 1.4.1, "Determining Transparency"; invisible surfaces count as opaque.

    Exporters use both "0 = opaque" and "1 = opaque", with or without the attribute that specifies it, but do not write invisible surfaces.
    """
    transparent, factor = shader.find("transparent"), shader.findtext("transparency/float")
    if transparent is None and factor is None:
        return 1.0
    strength = 1.0 if factor is None else float(factor)
    color = _color(None if transparent is None else transparent.findtext("color")) or (1.0, 1.0, 1.0, 1.0)
    mode = "A_ONE" if transparent is None else transparent.get("opaque", "A_ONE")
    luminance = 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
    alpha = {
        "A_ONE": color[3] * strength,
        "A_ZERO": 1.0 - color[3] * strength,
        "RGB_ZERO": 1.0 - luminance * strength,
        "RGB_ONE": luminance * strength,
    }.get(mode, 1.0)
    return alpha if _LEAST_ALPHA < alpha < 1.0 - _LEAST_ALPHA else 1.0


def _strip(start: int, count: int) -> I64:
    """Returns the triangles (F, 3) of a strip of ``count`` corners that begins at ``start``."""
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


# Transforms, (4, 4)


def _matrix(values: F64) -> F64:
    return values.reshape(4, 4)


def _translate(values: F64) -> F64:
    matrix = np.eye(4)
    matrix[:3, 3] = values
    return matrix


def _scale(values: F64) -> F64:
    return np.diag([*values[:3], 1.0])


def _rotate(values: F64) -> F64:
    """Returns the rotation about an axis by an angle in degrees (Rodrigues' formula)."""
    x, y, z = values[:3] / np.linalg.norm(values[:3])
    angle = math.radians(values[3])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


_TRANSFORMS = {"matrix": _matrix, "translate": _translate, "scale": _scale, "rotate": _rotate}
