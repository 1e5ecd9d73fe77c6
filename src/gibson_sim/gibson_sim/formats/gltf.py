"""Reads glTF 2.0, text and binary (GLB): geometry of the default scene and metallic-roughness materials.

Skins, animations, cameras, lights and material extensions other than unlit, emissive strength and (in part) specular-glossiness are
ignored.
"""

from __future__ import annotations

import base64
import json
import math
import os
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import Omission, OmissionKind
from gibson_sim.errors import MeshError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.gltf_compression import DRACO, MAX_DECODED_BYTES, MESHOPT, DracoMesh, decode_draco, decode_meshopt
from gibson_sim.formats.mesh import F64, I64, LIGHT_GREY, TO_Z_UP, AlphaMode, Material, MeshPart, build_part
from gibson_sim.formats.textures import TextureStore, Warn, local_path
from gibson_sim.geometry.colours import srgb8_from_linear, srgb_from_linear
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MAX_BUFFER_BYTES = 2**30
"""Maximum size of a buffer file, bytes."""
_MAX_ELEMENTS = 100_000_000
"""Maximum number of elements of an accessor."""
_MAX_VALUES = 2_000_000
"""Maximum number of commas in the JSON; a house with 20,000 nodes has 1 million. The size is not limited: buffers may be embedded as text."""
_MAX_NODES = 100_000
_NODES_PER_PART = 10
"""Maximum number of nodes per allowed part: most nodes have no mesh, and each takes time."""
_ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}
_KNOWN_EXTENSIONS = {
    "KHR_materials_unlit", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_materials_pbrSpecularGlossiness",
    "KHR_lights_punctual", "EXT_texture_webp", "KHR_texture_basisu", DRACO, *MESHOPT,
}  # fmt: skip

_MAPS = {
    "metallicRoughnessTexture": "metallic_roughness_texture",
    "normalTexture": "normal_texture",
    "occlusionTexture": "occlusion_texture",
    "emissiveTexture": "emissive_texture",
}
"""Name of a texture in the file -> field of ``Material``."""
_UvMapping = tuple[int, dict[str, Any]]
"""Index of the set of texture coordinates, and the KHR_texture_transform, empty = none."""


def load_gltf(
    path: Path, data: bytes, textures: TextureStore, files: list[Path], warn: Warn, max_parts: int | None = None
) -> list[MeshPart]:
    """Returns the parts of the default scene, metres, rotated from y up to z up.

    Args:
        path: the file.
        data: its content.
        textures: finds and decodes the images that it names.
        files: list to which the paths of further files that are read are appended.
        warn: called with one line for each element that is left out or replaced.
        max_parts: maximum number of parts; None = unlimited.

    Raises:
        MeshError: the file is corrupt, needs an unknown extension, or has too many parts or nodes.
    """
    document, chunk = _split(path, data)
    version = str(document.get("asset", {}).get("version", ""))
    if not version.startswith("2"):
        raise MeshError(f"{path}: glTF version is {version or 'not given'}, must be 2.x; convert the file")
    for name in document.get("extensionsRequired", []):
        if name not in _KNOWN_EXTENSIONS and not name.startswith("KHR_materials_"):
            raise MeshError(f"{path}: needs glTF extension {name}, which is not supported; export the file without it")
    return _GltfReader(path, document, chunk, textures, files, warn).parts(max_parts)


def _split(path: Path, data: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON document and the binary chunk, empty for a text file."""
    if data[:4] != b"glTF":
        if path.suffix.lower() == ".glb":
            raise MeshError(
                f"{path}: is not a GLB file (it begins with {quoted(data[:8].decode('ascii', 'replace'))}, must begin with 'glTF')"
            )
        document = _json(path, data)
        if not isinstance(document, dict):
            raise MeshError(f"{path}: is not a glTF file: its JSON holds no object")
        return document, b""
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise MeshError(f"{path}: GLB version is {version}, must be 2; convert the file")
    if length > len(data):
        raise MeshError(f"{path}: GLB of {length} bytes is cut after {len(data)}; copy or download it again")
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    return _json(path, chunks[0x4E4F534A]), chunks.get(0x004E4942, b"")


def _json(path: Path, data: bytes) -> Any:
    values = data.count(b",")
    if values > _MAX_VALUES:
        reason = f"has about {values} JSON values, must have at most {_MAX_VALUES}; split it"
        raise MeshError(f"{path}: {reason}").with_public(reason)
    return json.loads(data.decode("utf-8-sig"))


class _GltfReader:
    """Reader of one document."""

    def __init__(
        self, path: Path, document: dict[str, Any], chunk: bytes, textures: TextureStore, files: list[Path], warn: Warn
    ) -> None:
        self.path = path
        self.document = document
        self.chunk = chunk
        self.textures = textures
        self.files = files
        self.warn = warn
        self._buffers: dict[int, bytes] = {}
        self._materials: dict[int, Material] = {}
        self._images: dict[int, Any] = {}
        self._draco: dict[int, DracoMesh] | None = None
        """Index of a buffer view -> mesh; None = not decoded yet."""
        self._decoded: dict[int, NDArray[Any]] = {}
        """Index of an accessor -> values from Draco, for the current primitive."""
        self._unpacked: dict[int, bytes] = {}
        self._unpacked_bytes = 0

    def parts(self, most: int | None) -> list[MeshPart]:
        """Returns all parts, at most ``most``."""
        if "EXT_mesh_gpu_instancing" in self.document.get("extensionsUsed", []):
            self.warn(f"{self.path}: EXT_mesh_gpu_instancing is not supported; only one of each instanced mesh is drawn")
        parts: list[MeshPart] = []
        nodes, allowed = len(self.document.get("nodes", [])), min(_MAX_NODES, _NODES_PER_PART * (most or _MAX_NODES))
        if nodes > allowed:
            reason = f"has {nodes} nodes, must have at most {allowed}; join its meshes"
            raise MeshError(f"{self.path}: {reason}").with_public(reason)
        for node, matrix in self._nodes():
            if "mesh" not in node:
                continue
            for primitive in self._item("meshes", node["mesh"]).get("primitives", []):
                if most is not None and len(parts) >= most:
                    reason = f"has more than {most} meshes in its nodes; join them before it is spawned, or load it as a world"
                    raise MeshError(f"{self.path}: {reason}").with_public(reason)
                part = self._primitive(primitive, matrix)
                if part is not None:
                    parts.append(part)
        return parts

    def _item(self, kind: str, index: int) -> dict[str, Any]:
        items = self.document.get(kind, [])
        if not 0 <= index < len(items):
            raise MeshError(f"{self.path}: names number {index} of {kind}, but there are {len(items)}; the file is broken")
        item: dict[str, Any] = items[index]
        return item

    # Nodes

    def _nodes(self) -> Iterator[tuple[dict[str, Any], F64]]:
        """Yields every node of the default scene and its T_zup_node, (4, 4)."""
        nodes = self.document.get("nodes", [])
        scenes = self.document.get("scenes")
        if scenes:
            roots = self._item("scenes", self.document.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [k for k in range(len(nodes)) if k not in children]
        to_z_up = np.eye(4)
        to_z_up[:3, :3] = TO_Z_UP["y"]
        stack = [(root, to_z_up) for root in reversed(roots)]
        seen: set[int] = set()
        while stack:
            index, parent = stack.pop()
            if index in seen:
                raise MeshError(f"{self.path}: node {index} has two parents or is its own ancestor; the file is broken")
            seen.add(index)
            node = self._item("nodes", index)
            matrix = parent @ _node_matrix(node)
            yield node, matrix
            stack += [(child, matrix) for child in reversed(node.get("children", []))]

    # Geometry

    def _primitive(self, primitive: dict[str, Any], matrix: F64) -> MeshPart | None:
        mode = primitive.get("mode", 4)
        attributes = primitive["attributes"]
        if mode not in (4, 5, 6) or "POSITION" not in attributes:
            if "POSITION" in attributes:
                self.warn(f"{self.path}: points and lines are not drawn")
            return None
        draco = self._draco_of(primitive)
        self._decoded = {} if draco is None else self._draco_arrays(primitive, draco)
        vertices = self._accessor(attributes["POSITION"])
        if vertices.shape[1] != 3:
            raise MeshError(f"{self.path}: positions have {vertices.shape[1]} coordinates, must be 3; the file is broken")
        normals = self._attribute("NORMAL", attributes, len(vertices), 3)
        if draco is not None:
            indices: I64 = draco.indices
        elif "indices" in primitive:
            indices = self._accessor(primitive["indices"])[:, 0].astype(np.int64)
        else:
            indices = np.arange(len(vertices))
        material, uv_set, uv_matrix = self._material_of(primitive)
        uvs = self._attribute(f"TEXCOORD_{uv_set}", attributes, len(vertices), 2)
        if uvs is not None and uv_matrix is not None:
            uvs = uvs @ uv_matrix[:2, :2].T + uv_matrix[:2, 2]
        colors = None
        if material.texture is None and "COLOR_0" in attributes:
            colors = self._colors(attributes["COLOR_0"], len(vertices))
        return build_part(str(self.path), vertices, _triangles(indices, mode), normals, uvs, material, matrix, colors)

    def _draco_of(self, primitive: dict[str, Any]) -> DracoMesh | None:
        """Returns the Draco mesh of a primitive, None = not compressed; the first call decodes all meshes of the file."""
        if DRACO not in primitive.get("extensions", {}):
            return None
        if "bufferView" in self._item("accessors", primitive["attributes"]["POSITION"]):
            return None  # the file also contains it uncompressed
        if self._draco is None:
            every = [p for mesh in self.document.get("meshes", []) for p in mesh.get("primitives", [])]
            views = dict.fromkeys(p["extensions"][DRACO]["bufferView"] for p in every if DRACO in p.get("extensions", {}))
            meshes = decode_draco(str(self.path), [self._view_bytes(view) for view in views])
            self._draco = dict(zip(views, meshes, strict=True))
        return self._draco[primitive["extensions"][DRACO]["bufferView"]]

    def _draco_arrays(self, primitive: dict[str, Any], draco: DracoMesh) -> dict[int, NDArray[Any]]:
        """Returns index of an accessor -> values (V, C), for the accessors in the Draco mesh; checks their shapes."""
        arrays: dict[int, NDArray[Any]] = {}
        for name, number in primitive["extensions"][DRACO].get("attributes", {}).items():
            index = primitive["attributes"].get(name)
            if index is None or number not in draco.attributes:
                continue
            values, accessor = draco.attributes[number], self._item("accessors", index)
            shape = (accessor["count"], _WIDTHS[accessor["type"]])
            if values.shape != shape:
                raise MeshError(f"{self.path}: Draco holds {name} of shape {values.shape}, must be {shape}; the file is broken")
            arrays[index] = values
        if primitive["attributes"]["POSITION"] not in arrays:
            raise MeshError(f"{self.path}: a Draco mesh has no POSITION; the file is broken")
        return arrays

    def _attribute(self, name: str, attributes: dict[str, Any], count: int, width: int) -> NDArray[Any] | None:
        """Returns a vertex attribute (count, width); None if the primitive does not have it."""
        if name not in attributes:
            return None
        array = self._accessor(attributes[name])
        if array.shape != (count, width):
            raise MeshError(f"{self.path}: {name} has shape {array.shape}, must be ({count}, {width}); the file is broken")
        return array

    def _colors(self, index: int, count: int) -> NDArray[np.uint8]:
        """Returns the vertex colours, (V, 3) uint8 sRGB, converted from the linear RGB of the file; drops alpha."""
        linear = self._accessor(index)
        if linear.shape[0] != count or linear.shape[1] not in (3, 4):
            raise MeshError(f"{self.path}: COLOR_0 has shape {linear.shape}, must be ({count}, 3 or 4); the file is broken")
        return srgb8_from_linear(linear[:, :3].astype(np.float64))

    def _accessor(self, index: int) -> NDArray[Any]:
        """Returns the values of an accessor, (count, width); normalised integers are converted to floats in [-1, 1] or [0, 1]."""
        accessor = self._item("accessors", index)
        dtype, width, count = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[accessor["type"]], int(accessor["count"])
        if not 0 <= count <= _MAX_ELEMENTS:
            raise MeshError(f"{self.path}: accessor {index} has {count} elements, must be 0 to {_MAX_ELEMENTS}")
        if index in self._decoded:
            array = self._decoded[index]
            dtype = array.dtype
        elif "bufferView" in accessor:
            array = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), dtype, count, width)
        else:
            array = np.zeros((count, width), dtype=dtype)
        sparse = accessor.get("sparse")
        if sparse:
            n = int(sparse["count"])
            positions, values = sparse["indices"], sparse["values"]
            rows = self._view(
                positions["bufferView"], positions.get("byteOffset", 0), np.dtype(_COMPONENTS[positions["componentType"]]), n, 1
            )
            array = array.copy()
            array[rows[:, 0].astype(np.int64)] = self._view(values["bufferView"], values.get("byteOffset", 0), dtype, n, width)
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(array.astype(np.float64) / np.iinfo(dtype).max, -1.0)
        return array

    def _view(self, index: int, offset: int, dtype: np.dtype[Any], count: int, width: int) -> NDArray[Any]:
        """Returns values (count, width) of a buffer view, starting at byte ``offset``."""
        view = self._item("bufferViews", index)
        start, length = int(view.get("byteOffset", 0)), int(view["byteLength"])
        stride = int(view.get("byteStride", 0)) or dtype.itemsize * width
        packed = next((view["extensions"][name] for name in MESHOPT if name in view.get("extensions", {})), None)
        if packed is None:
            data = self._buffer(view["buffer"])
        else:
            if index not in self._unpacked:
                self._unpacked[index] = self._meshopt(packed)
            data, start = self._unpacked[index], 0
        last = offset + (count - 1) * stride + dtype.itemsize * width if count else 0
        if min(start, offset, length) < 0 or last > length or start + length > len(data):
            raise MeshError(
                f"{self.path}: a buffer has {len(data)} bytes, but {start + max(length, last)} are needed; the file is cut"
            )
        return np.ndarray((count, width), dtype, data, start + offset, (stride, dtype.itemsize))

    def _meshopt(self, packed: dict[str, Any]) -> bytes:
        """Returns the decoded bytes of a buffer view that is compressed with meshoptimizer."""
        self._unpacked_bytes += int(packed.get("count", 0)) * int(packed.get("byteStride", 0))
        if self._unpacked_bytes > MAX_DECODED_BYTES:
            raise MeshError(
                f"{self.path}: its buffers have more than {MAX_DECODED_BYTES >> 20} MB when decompressed; simplify the mesh"
            )
        start, length = int(packed.get("byteOffset", 0)), int(packed.get("byteLength", 0))
        return decode_meshopt(str(self.path), packed, self._slice(packed["buffer"], start, length))

    def _view_bytes(self, index: int) -> bytes:
        view = self._item("bufferViews", index)
        return self._slice(view["buffer"], int(view.get("byteOffset", 0)), int(view["byteLength"]))

    def _slice(self, buffer: int, start: int, length: int) -> bytes:
        data = self._buffer(buffer)
        if min(start, length) < 0 or start + length > len(data):
            raise MeshError(f"{self.path}: a buffer has {len(data)} bytes, but {start + length} are needed; the file is cut")
        return data[start : start + length]

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self._item("buffers", index).get("uri")
            self._buffers[index] = self.chunk if uri is None else self._bytes_at(uri)
        return self._buffers[index]

    def _bytes_at(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return _data_uri(uri)
        file = local_path(uri, self.path.parent)
        if not is_inside(file, self.textures.roots):
            raise MeshError(
                f"{self.path}: buffer {quoted(uri)} lies outside the folder of the mesh and of its model; put it beside the mesh"
            )
        try:
            data = read_file(file, _MAX_BUFFER_BYTES)
        except OSError as e:
            raise MeshError(f"{self.path}: buffer {file.name} cannot be read: {e.strerror or e}") from e
        self.files.append(Path(os.path.realpath(file)))
        return data

    # Materials

    def _material_of(self, primitive: dict[str, Any]) -> tuple[Material, int, F64 | None]:
        """Returns the material of a primitive, the index of its set of texture coordinates, and their transform (3, 3) or None."""
        if "material" not in primitive:
            return Material(), 0, None
        index = primitive["material"]
        source = self._item("materials", index)
        extensions = source.get("extensions", {})
        gloss = extensions.get("KHR_materials_pbrSpecularGlossiness", {})
        pbr = source.get("pbrMetallicRoughness", {})
        info = pbr.get("baseColorTexture") or gloss.get("diffuseTexture")
        factor = pbr.get("baseColorFactor") or gloss.get("diffuseFactor")
        mapping = _uv_mapping(info or next(filter(None, (_map_info(source, name) for name in _MAPS)), {}))
        if index not in self._materials:
            texture = None if info is None else self._texture(info["index"])
            color = (1.0, 1.0, 1.0, 1.0) if texture or not self.textures.decode else LIGHT_GREY
            if factor is not None:
                *rgb, alpha = (float(c) for c in factor)
                r, g, b = srgb_from_linear(rgb).tolist()
                color = (r, g, b, min(max(alpha, 0.0), 1.0))
            material = Material(
                str(source.get("name", "")),
                color,
                texture,
                "KHR_materials_unlit" in extensions,
                _ALPHA_MODES.get(source.get("alphaMode", "OPAQUE"), "opaque"),
                float(source.get("alphaCutoff", 0.5)),
                bool(source.get("doubleSided", False)),
            )
            self._materials[index] = material if material.unlit else self._with_surface(material, source, mapping)
        return self._materials[index], mapping[0], _uv_matrix(mapping[1])

    def _with_surface(self, material: Material, source: dict[str, Any], mapping: _UvMapping) -> Material:
        """Returns the material with metallic, roughness and emissive factors and the other textures."""
        maps: dict[str, Any] = {}
        for name, field in _MAPS.items():
            info = _map_info(source, name)
            if info is None:
                continue
            if _uv_mapping(info) != mapping:
                # A second set of coordinates for each vertex would take memory in all scenes, and few need it.
                self.warn(
                    f"{self.path}: {name} of material {quoted(material.name)} has other texture coordinates than its base colour; left out"
                )
                continue
            maps[field] = self._texture(info["index"])
        pbr, extensions = source.get("pbrMetallicRoughness", {}), source.get("extensions", {})
        gloss = extensions.get("KHR_materials_pbrSpecularGlossiness", {})
        # By the standard, a material without these keys is a rough metal; exporters that omit all of them mean a non-metal.
        unspecified = not {"metallicFactor", "roughnessFactor", "metallicRoughnessTexture"} & set(pbr)
        metallic, roughness = (0.0, 1.0) if unspecified else (pbr.get("metallicFactor", 1.0), pbr.get("roughnessFactor", 1.0))
        if unspecified and "glossinessFactor" in gloss:
            roughness = 1.0 - float(gloss["glossinessFactor"])
        strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
        red, green, blue = (_clamped(c, math.inf) * _clamped(strength, math.inf) for c in source.get("emissiveFactor", (0, 0, 0)))
        return replace(
            material,
            metallic=_clamped(metallic),
            roughness=_clamped(roughness),
            emissive=(red, green, blue),
            normal_scale=float(source.get("normalTexture", {}).get("scale", 1.0)),
            occlusion_strength=_clamped(source.get("occlusionTexture", {}).get("strength", 1.0)),
            **maps,
        )

    def _texture(self, index: int) -> Any:
        texture = self._item("textures", index)
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        if source is None:
            ktx = "KHR_texture_basisu" in texture.get("extensions", {})
            what = "is KTX2, which is not read" if ktx else "has a format that cannot be read"
            remedy = "; make it PNG: npx @gltf-transform/cli ktxdecompress in.glb out.glb (needs KTX-Software)" if ktx else ""
            text = f"{self.path}: texture {index} {what}; the surface is drawn without it{remedy}"
            self.warn(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
            return None
        if source not in self._images:
            self._images[source] = self._image(source)
        return self._images[source]

    def _image(self, index: int) -> Any:
        image = self._item("images", index)
        name = f"{self.path}: image {index}"
        if "bufferView" in image:
            view = self._item("bufferViews", image["bufferView"])
            data = self._view(image["bufferView"], 0, np.dtype("u1"), int(view["byteLength"]), 1).tobytes()
            return self.textures.from_bytes(name, data, self.warn)
        uri = image["uri"]
        if uri.startswith("data:"):
            return self.textures.from_bytes(name, _data_uri(uri), self.warn)
        return self.textures.from_uri(uri, self.path, self.files, self.warn)


def _map_info(source: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Returns the textureInfo of a texture of a material, or None."""
    holder = source.get("pbrMetallicRoughness", {}) if name == "metallicRoughnessTexture" else source
    info: dict[str, Any] | None = holder.get(name)
    return info


def _uv_mapping(info: dict[str, Any]) -> _UvMapping:
    """Returns the mapping of a textureInfo."""
    transform = info.get("extensions", {}).get("KHR_texture_transform", {})
    return int(transform.get("texCoord", info.get("texCoord", 0))), {k: v for k, v in transform.items() if k != "texCoord"}


def _clamped(value: Any, high: float = 1.0) -> float:
    """Returns a number clamped to 0 and ``high``."""
    return min(max(float(value), 0.0), high)


def _node_matrix(node: dict[str, Any]) -> F64:
    """Returns T_parent_node, (4, 4)."""
    if "matrix" in node:
        return np.asarray(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = np.asarray(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    length = np.linalg.norm(rotation)
    if length > 0:
        matrix[:3, :3] = matrix_from_quat(rotation / length)
    matrix[:3, :3] *= np.asarray(node.get("scale", (1, 1, 1)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _triangles(indices: I64, mode: int) -> I64:
    """Returns the triangles (F, 3) of a list (mode 4), a strip (5) or a fan (6) of vertices."""
    if mode == 4:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    n = max(len(indices) - 2, 0)
    if mode == 6:
        return np.stack([indices[1 : 1 + n], indices[2 : 2 + n], np.full(n, indices[0] if n else 0)], axis=1)
    triangles = np.stack([indices[:n], indices[1 : 1 + n], indices[2 : 2 + n]], axis=1)
    triangles[1::2] = triangles[1::2][:, [0, 2, 1]]
    return triangles


def _uv_matrix(transform: dict[str, Any]) -> F64 | None:
    """Returns the matrix (3, 3) of a KHR_texture_transform, or None; its rotation is counter-clockwise in the image (v downwards)."""
    if not transform:
        return None
    c, s = math.cos(transform.get("rotation", 0.0)), math.sin(transform.get("rotation", 0.0))
    (du, dv), (su, sv) = transform.get("offset", (0.0, 0.0)), transform.get("scale", (1.0, 1.0))
    return np.array([[c * su, s * sv, du], [-s * su, c * sv, dv], [0.0, 0.0, 1.0]])


def _data_uri(uri: str) -> bytes:
    """Returns the content of a ``data:`` URI."""
    header, _, body = uri.partition(",")
    return base64.b64decode(unquote_to_bytes(body), validate=False) if header.endswith(";base64") else unquote_to_bytes(body)
