"""Reads glTF 2.0, text and binary (GLB): geometry of the default scene and metallic-roughness materials.

Skins and morph targets are applied in the pose of the file. Animations, cameras, lights and material extensions other than unlit, emissive
strength and (in part) specular-glossiness are left out, each with a warning that says what changes; ``docs/formats.md`` lists all elements.

No library replaces this reader. trimesh 5.2 reads 300,000 triangles in 35 ms of CPU time, this reader in 53 ms; but 71 of 97 tests in
``tests/conformance/test_gltf.py`` fail with it. Without a word it leaves out sparse accessors, normalised texture coordinates, fans, skins,
morph weights, instances, transforms and second sets of texture coordinates, samplers and unlit materials, takes colours of floats for
bytes, and ignores required extensions that it does not know. pygltflib reads the JSON only; accessors are left to its caller.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
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
from gibson_sim.formats.gltf_document import check_document
from gibson_sim.formats.light_maps import EXTENSION as LIGHT_MAP
from gibson_sim.formats.mesh import F64, I64, TO_Z_UP, AlphaMode, Filter, Material, MeshPart, Sampling, Wrap, build_part
from gibson_sim.formats.textures import TextureStore, Warn, local_path
from gibson_sim.geometry.colours import srgb8_from_linear, srgb_from_linear
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import read_file

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_MAX_BUFFER_BYTES = 2**30
"""Maximum size of a buffer file, bytes."""
_MAX_ELEMENTS = 100_000_000
"""Maximum number of elements of an accessor."""
_MAX_VALUES = 2_000_000
"""Maximum number of commas in the JSON; a house with 20,000 nodes has 1 million. The size is not limited: buffers may be embedded as text."""
_MAX_NODES = 100_000
_NODES_PER_PART = 10
"""Maximum number of nodes per allowed part: most nodes have no mesh, and each takes time."""
_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_MINIFIED: dict[int, tuple[Filter, Filter | None]] = {
    9728: ("nearest", None), 9729: ("linear", None), 9984: ("nearest", "nearest"), 9985: ("linear", "nearest"),
    9986: ("nearest", "linear"), 9987: ("linear", "linear"),
}  # fmt: skip
"""Value of ``minFilter`` -> filter within a mip level and between levels, None = without levels."""
_ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}
_GLOSS = "KHR_materials_pbrSpecularGlossiness"
_METADATA = {"KHR_xmp", "KHR_xmp_json_ld"}
"""Extensions without influence on the picture."""
_LEFT_OUT = {
    "KHR_lights_punctual": "its lights are left out, so that only the lights of the scene shine",
    "KHR_materials_variants": "the variants are left out, and the default materials are drawn",
}
"""Extension of a document -> what changes without it."""
_MATERIAL_EXTENSIONS: dict[str, tuple[str, Any, str]] = {
    "KHR_materials_anisotropy": ("anisotropyStrength", 0.0, "its highlights are round"),
    "KHR_materials_clearcoat": ("clearcoatFactor", 0.0, "the highlights of its coat are missing"),
    "KHR_materials_diffuse_transmission": ("diffuseTransmissionFactor", 0.0, "no light shines through it"),
    "KHR_materials_dispersion": ("dispersion", 0.0, "it does not split light into colours"),
    "KHR_materials_ior": ("ior", 1.5, "it reflects as with an index of refraction of 1.5"),
    "KHR_materials_iridescence": ("iridescenceFactor", 0.0, "its colour does not change with the view"),
    "KHR_materials_sheen": ("sheenColorFactor", [0, 0, 0], "its sheen is missing"),
    "KHR_materials_specular": ("specularFactor", 1.0, "its reflections have the default strength and colour"),
    "KHR_materials_transmission": ("transmissionFactor", 0.0, "it is opaque instead of transparent like glass"),
    "KHR_materials_volume": ("thicknessFactor", 0.0, "it does not refract or absorb light"),
}
"""Extension of a material -> property and value with which it has no effect, and what changes without it."""

_READ_MATERIAL_EXTENSIONS = {"KHR_materials_unlit", "KHR_materials_emissive_strength", _GLOSS, LIGHT_MAP}
_KNOWN_EXTENSIONS = {
    *_READ_MATERIAL_EXTENSIONS, *_MATERIAL_EXTENSIONS, *_LEFT_OUT, "KHR_texture_transform", "KHR_mesh_quantization", "EXT_texture_webp",
    "KHR_texture_basisu", "EXT_mesh_gpu_instancing", "KHR_node_visibility", DRACO, *MESHOPT,
}  # fmt: skip
"""Extensions that are read, or whose absence is named with what changes."""
_WHITE = (1.0, 1.0, 1.0, 1.0)
"""``baseColorFactor`` of a material that has none."""

_MAPS = {
    "metallicRoughnessTexture": "metallic_roughness_texture",
    "normalTexture": "normal_texture",
    "occlusionTexture": "occlusion_texture",
    "emissiveTexture": "emissive_texture",
}
"""Name of a texture in the file -> field of ``Material``."""
_TO_Z_UP = np.eye(4)
_TO_Z_UP[:3, :3] = TO_Z_UP["y"]
_TRANSFORMS = {"translation", "rotation", "scale"}
_INSTANCE_WIDTHS = {"TRANSLATION": 3, "ROTATION": 4, "SCALE": 3}
_Targets = Sequence[tuple[float, dict[str, int]]]
"""Morph targets: weight, and accessors by attribute."""
_NO_TRANSFORM: dict[str, Any] = {"offset": [0, 0], "rotation": 0, "scale": [1, 1]}
"""Values of a KHR_texture_transform that change nothing."""
_UvMapping = tuple[int, dict[str, Any]]
"""Index of the set of texture coordinates, and what a KHR_texture_transform changes, empty = nothing."""


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
    asset = document.get("asset")
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if not version.startswith("2"):
        raise MeshError(f"{path}: glTF version is {clipped(version, 40) or 'not given'}, must be 2.x; convert the file")
    check_document(str(path), document)
    least = document["asset"].get("minVersion", "2.0")
    if _version(least) > (2, 0):
        raise MeshError(f"{path}: needs glTF {clipped(least, 40)}, 2.0 is read; export it for 2.0")
    for name in document.get("extensionsRequired", []):
        if name not in _KNOWN_EXTENSIONS | _METADATA:
            raise MeshError(f"{path}: needs glTF extension {name}, which is not supported; export the file without it")
    return _GltfReader(path, document, chunk, textures, files, warn).parts(max_parts)


def _version(text: str) -> tuple[int, ...]:
    """Returns the numbers of a version, () if it has none."""
    return tuple(map(int, re.findall("[0-9]{1,9}", text)))


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
    if _JSON_CHUNK not in chunks:
        raise MeshError(f"{path}: is a GLB without its JSON chunk; the file is broken, export it again")
    document = _json(path, chunks[_JSON_CHUNK])
    if not isinstance(document, dict):
        raise MeshError(f"{path}: is not a glTF file: its JSON holds no object")
    return document, chunks.get(_BINARY_CHUNK, b"")


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
        self._images: dict[int, tuple[Any, list[str]]] = {}
        self._light_maps: dict[int, tuple[Any, list[str]]] = {}
        self._draco: dict[int, DracoMesh] | None = None
        """Index of a buffer view -> mesh; None = not decoded yet."""
        self._decoded: dict[int, NDArray[Any]] = {}
        """Index of an accessor -> values from Draco, for the current primitive."""
        self._unpacked: dict[int, bytes] = {}
        self._unpacked_bytes = 0
        self._parents = {child: k for k, node in enumerate(document.get("nodes", [])) for child in node.get("children", [])}

    def parts(self, most: int | None) -> list[MeshPart]:
        """Returns all parts, at most ``most``."""
        self._warn_of_what_is_left_out()
        parts: list[MeshPart] = []
        nodes, allowed = len(self.document.get("nodes", [])), min(_MAX_NODES, _NODES_PER_PART * (most or _MAX_NODES))
        if nodes > allowed:
            reason = f"has {nodes} nodes, must have at most {allowed}; join its meshes"
            raise MeshError(f"{self.path}: {reason}").with_public(reason)
        for node, matrix in self._instances():
            mesh = self._item("meshes", node["mesh"])
            for primitive in mesh["primitives"]:
                if most is not None and len(parts) >= most:
                    reason = f"has more than {most} meshes in its nodes; join them before it is spawned, or load it as a world"
                    raise MeshError(f"{self.path}: {reason}").with_public(reason)
                part = self._primitive(primitive, matrix, node, node.get("weights", mesh.get("weights", [])))
                if part is not None:
                    parts.append(part)
        return parts

    def _item(self, kind: str, index: int) -> dict[str, Any]:
        items = self.document.get(kind, [])
        if not 0 <= index < len(items):
            raise MeshError(f"{self.path}: names number {index} of {kind}, but there are {len(items)}; the file is broken")
        item: dict[str, Any] = items[index]
        return item

    def _warn_of_what_is_left_out(self) -> None:
        """Warns of what no mesh or material says."""
        for name in self.document.get("extensionsUsed", []):
            if name in _LEFT_OUT:
                self.warn(f"{self.path}: {name}: {_LEFT_OUT[name]}")
            elif name not in _KNOWN_EXTENSIONS | _METADATA:
                self.warn(f"{self.path}: extension {clipped(name, 60)} is not read; what it adds or changes is left out")
        scenes = len(self.document.get("scenes", []))
        if scenes > 1:
            self.warn(f"{self.path}: has {scenes} scenes; only scene {self.document.get('scene', 0)} is drawn")
        both = [k for k, node in enumerate(self.document.get("nodes", [])) if "matrix" in node and _TRANSFORMS & set(node)]
        if both:
            which = f"nodes {both[0]} and {len(both) - 1} more have" if len(both) > 1 else f"node {both[0]} has"
            self.warn(
                f"{self.path}: {which} a matrix and a translation, rotation or scale, must have one or the other; the matrix is used"
            )
        if self.document.get("cameras"):
            self.warn(f"{self.path}: its cameras are left out; add cameras to the robot or the scene")
        if any(
            self._moves(channel, animation["samplers"])
            for animation in self.document.get("animations", [])
            for channel in animation["channels"]
        ):
            self.warn(f"{self.path}: its animations are left out; everything stays in the pose of the nodes")

    def _moves(self, channel: dict[str, Any], samplers: list[dict[str, Any]]) -> bool:
        """Returns whether an animation changes a node from its pose in the file."""
        target = channel["target"]
        if "node" not in target or not 0 <= channel["sampler"] < len(samplers):
            return True  # what an extension animates
        node = self._item("nodes", target["node"])
        weights = node.get("weights") or self.document["meshes"][node["mesh"]].get("weights", []) if "mesh" in node else []
        rest = {
            "translation": node.get("translation", (0, 0, 0)),
            "rotation": node.get("rotation", (0, 0, 0, 1)),
            "scale": node.get("scale", (1, 1, 1)),
            "weights": weights,
        }.get(target["path"])
        if rest is None or samplers[channel["sampler"]].get("interpolation") == "CUBICSPLINE":
            return True
        values = self._accessor(samplers[channel["sampler"]]["output"])
        if target["path"] == "weights":
            values = values.reshape(-1, len(rest)) if rest and values.size % len(rest) == 0 else values
        if values.shape[1] != len(rest):
            return bool(np.any(values))
        return not np.allclose(values, rest, atol=1e-6)

    # Nodes

    def _instances(self) -> Iterator[tuple[dict[str, Any], F64]]:
        """Yields every node of the default scene that has a mesh, once for each of its instances, and its T_zup_node, (4, 4)."""
        count = 0
        for node, matrix in self._nodes():
            if "mesh" not in node:
                continue
            attributes = node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).get("attributes")
            if attributes is None:
                yield node, matrix
                continue
            columns = {name: self._accessor(attributes[name]) for name in _INSTANCE_WIDTHS if name in attributes}
            lengths = {len(values) for values in columns.values()}
            if len(lengths) != 1 or any(values.shape[1] != _INSTANCE_WIDTHS[name] for name, values in columns.items()):
                raise MeshError(
                    f"{self.path}: the attributes of EXT_mesh_gpu_instancing do not fit each other; the file is broken"
                )
            count += lengths.pop()
            if count > _MAX_NODES:
                raise MeshError(f"{self.path}: has more than {_MAX_NODES} instances of meshes; split it")
            for row in range(len(next(iter(columns.values())))):
                yield node, matrix @ _node_matrix({name.lower(): values[row] for name, values in columns.items()})

    def _world_matrix(self, index: int) -> F64:
        """Returns T_zup_node, (4, 4), of any node."""
        matrix, seen = np.eye(4), set[int]()
        current: int | None = index
        while current is not None and current not in seen:
            seen.add(current)
            matrix = _node_matrix(self._item("nodes", current)) @ matrix
            current = self._parents.get(current)
        return _TO_Z_UP @ matrix

    def _nodes(self) -> Iterator[tuple[dict[str, Any], F64]]:
        """Yields every node of the default scene and its T_zup_node, (4, 4)."""
        nodes = self.document.get("nodes", [])
        scenes = self.document.get("scenes")
        if scenes:
            named = self._item("scenes", self.document.get("scene", 0)).get("nodes", [])
            roots = list(dict.fromkeys(named))
            if len(roots) < len(named):
                twice = Counter(named).most_common(1)[0][0]
                self.warn(f"{self.path}: its scene names node {twice} more than once; each node is drawn once")
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [k for k in range(len(nodes)) if k not in children]
        stack = [(root, _TO_Z_UP) for root in reversed(roots)]
        seen: set[int] = set()
        while stack:
            index, parent = stack.pop()
            if index in seen:
                problem = (
                    "is a child, but also a root of the scene" if index in roots else "has two parents or is its own ancestor"
                )
                raise MeshError(f"{self.path}: node {index} {problem}; the file is broken")
            seen.add(index)
            node = self._item("nodes", index)
            if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True):
                continue  # nor are its children drawn
            matrix = parent @ _node_matrix(node)
            yield node, matrix
            stack += [(child, matrix) for child in reversed(node.get("children", []))]

    # Geometry

    def _primitive(
        self, primitive: dict[str, Any], matrix: F64, node: dict[str, Any], weights: Sequence[float]
    ) -> MeshPart | None:
        mode = primitive.get("mode", 4)
        attributes = primitive["attributes"]
        if mode not in (4, 5, 6) or "POSITION" not in attributes:
            if "POSITION" in attributes:
                self.warn(f"{self.path}: points and lines are not drawn")
            return None
        draco = self._draco_of(primitive)
        self._decoded = {} if draco is None else self._draco_arrays(primitive, draco)
        positions = self._accessor(attributes["POSITION"])
        if positions.shape[1] != 3:
            raise MeshError(f"{self.path}: positions have {positions.shape[1]} coordinates, must be 3; the file is broken")
        count = len(positions)
        targets = [(w, target) for w, target in zip(weights, primitive.get("targets", []), strict=False) if w]
        vertices = self._morphed("POSITION", positions, targets)
        normals = self._attribute("NORMAL", attributes, count, 3, targets)
        if draco is not None:
            indices: I64 = draco.indices
        elif "indices" in primitive:
            indices = self._accessor(primitive["indices"])[:, 0].astype(np.int64)
        else:
            indices = np.arange(count)
        material, uv_set, uv_matrix = self._material_of(primitive)
        uvs = self._attribute(f"TEXCOORD_{uv_set}", attributes, count, 2, targets)
        # Not by the textures of the material, since those are not decoded where only their names matter.
        maps = self._maps_of(primitive)
        if uvs is None and maps:
            self.warn(
                f"{self.path}: material {quoted(material.name)} needs TEXCOORD_{uv_set}; a mesh without it is drawn without textures"
            )
        if "TANGENT" in attributes and "normalTexture" in maps:
            self.warn(f"{self.path}: TANGENT is not read; normal textures are turned by the texture coordinates")
        if uvs is not None and uv_matrix is not None:
            uvs = uvs @ uv_matrix[:2, :2].T + uv_matrix[:2, 2]
        material, light_uvs = self._light_of(material, primitive, count, targets)
        colors = None
        if "COLOR_0" in attributes:
            colors = self._colors(attributes["COLOR_0"], count, targets)
            material = replace(material, colored=True)
        triangles = _triangles(indices, mode)
        placed: F64 | None = matrix
        if "skin" in node and "JOINTS_0" in attributes:
            vertices, normals, mirrored = self._skinned(node["skin"], attributes, vertices, normals)
            triangles = triangles[:, ::-1] if mirrored else triangles
            placed = None  # the joints replace the matrix of the node
        if normals is None and not material.unlit and len(triangles) and 0 <= triangles.min() <= triangles.max() < count:
            # By the specification flat, so no two triangles share a vertex. Without light nothing shows it, and scans stay small.
            corners = triangles.ravel()
            vertices, triangles = vertices[corners], np.arange(len(corners)).reshape(-1, 3)
            uvs, colors, light_uvs = (None if array is None else array[corners] for array in (uvs, colors, light_uvs))
        return build_part(str(self.path), vertices, triangles, normals, uvs, material, placed, colors, light_uvs)

    def _light_of(
        self, material: Material, primitive: dict[str, Any], count: int, targets: _Targets
    ) -> tuple[Material, NDArray[Any] | None]:
        """Returns the material of a primitive with its light map, and the texture coordinates in it; None = it has none."""
        source = self._item("materials", primitive["material"]) if "material" in primitive else {}
        info = source.get("extensions", {}).get(LIGHT_MAP)
        if info is None:
            return material, None
        uv_set, transform = _uv_mapping(info)
        uvs = self._attribute(f"TEXCOORD_{uv_set}", primitive["attributes"], count, 2, targets)
        if uvs is None:
            self.warn(
                f"{self.path}: {LIGHT_MAP} of material {quoted(material.name)} needs TEXCOORD_{uv_set}; "
                "a mesh without it is drawn in its base colour"
            )
            return material, None
        light = replace(
            material, unlit=True, light_map=self._light_map(info["index"]), light_intensity=float(info.get("intensity", 1.0))
        )
        matrix = _uv_matrix(transform)
        return light, uvs if matrix is None else uvs @ matrix[:2, :2].T + matrix[:2, 2]

    def _light_map(self, index: int) -> Any:
        """Returns the light map in a texture, whose sampler is not read; each image is read once."""
        source = self._item("textures", index).get("source")
        if source is None:
            self.warn(f"{self.path}: texture {index} of a light map has no source; the surface is drawn without its light")
            return None
        if source not in self._light_maps:
            problems: list[str] = []
            store = self.textures
            self._light_maps[source] = (
                self._image(source, problems.append, store.light_map_from_bytes, store.light_map_from_uri), problems,
            )  # fmt: skip
        image, problems = self._light_maps[source]
        for problem in problems:
            self.warn(problem)
        return image

    def _maps_of(self, primitive: dict[str, Any]) -> set[str]:
        """Returns the names of the textures that the material of a primitive is drawn with."""
        if "material" not in primitive:
            return set()
        source = self._item("materials", primitive["material"])
        colors = {"baseColorTexture"} & set(source.get("pbrMetallicRoughness", {})) | {"diffuseTexture"} & set(_gloss(source))
        unlit = "KHR_materials_unlit" in source.get("extensions", {})
        return colors | (
            set() if unlit else {name for name in _MAPS if _map_info(source, name) is not None and _has_effect(source, name)}
        )

    def _morphed(self, name: str, values: NDArray[Any], targets: _Targets) -> NDArray[Any]:
        """Returns an attribute (V, C) with the weighted displacements of morph targets."""
        for weight, target in targets:
            if name in target:
                moved = self._accessor(target[name])
                if moved.shape[0] != values.shape[0] or moved.shape[1] > values.shape[1]:
                    raise MeshError(
                        f"{self.path}: a morph target of {name} has shape {moved.shape}, must be {values.shape}; the file is broken"
                    )
                values = values.astype(np.float64)
                values[:, : moved.shape[1]] += weight * moved
        return values

    def _skinned(
        self, skin_index: int, attributes: dict[str, int], vertices: NDArray[Any], normals: NDArray[Any] | None
    ) -> tuple[F64, F64 | None, bool]:
        """Returns vertices and normals in the current pose of the joints, z up, and whether the joints mirror them."""
        skin = self._item("skins", skin_index)
        joints = np.array([self._world_matrix(joint) for joint in skin["joints"]]).reshape(-1, 4, 4)
        if "inverseBindMatrices" in skin:
            inverse = self._accessor(skin["inverseBindMatrices"])
            if inverse.shape[1] != 16 or len(inverse) < len(joints):
                problem = f"has {len(inverse)} inverse bind matrices, must have {len(joints)}"
                raise MeshError(f"{self.path}: skin {skin_index} {problem}; the file is broken")
            joints = joints @ inverse[: len(joints)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        blended, total = np.zeros((len(vertices), 4, 4)), np.zeros(len(vertices))
        for number in range(len(attributes)):
            numbers = self._attribute(f"JOINTS_{number}", attributes, len(vertices), 4)
            shares = self._attribute(f"WEIGHTS_{number}", attributes, len(vertices), 4)
            if numbers is None or shares is None:
                break
            for column in range(4):
                share, joint = np.nan_to_num(shares[:, column].astype(np.float64)), numbers[:, column].astype(np.int64)
                joint = np.where(share == 0.0, 0, joint)
                if len(joint) and not 0 <= joint.min() <= joint.max() < len(joints):
                    raise MeshError(
                        f"{self.path}: a vertex names joint {joint.max()}, but skin {skin_index} has {len(joints)}; the file is broken"
                    )
                blended += share[:, None, None] * joints[joint]
                total += share
        blended[total == 0.0] = _TO_Z_UP
        blended /= np.where(total == 0.0, 1.0, total)[:, None, None]
        moved = np.einsum("vij,vj->vi", blended[:, :3, :3], vertices.astype(np.float64)) + blended[:, :3, 3]
        linear = blended[:, :3, :3]
        mirrored = float(np.linalg.det(linear).sum()) < 0.0
        if normals is None:
            return moved, None, mirrored
        x, y, z = linear[:, 0], linear[:, 1], linear[:, 2]
        cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
        turned = np.einsum("vij,vj->vi", cofactors, normals.astype(np.float64)) * (-1.0 if mirrored else 1.0)
        return moved, turned, mirrored

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
        """Returns index of an accessor -> values (V, C), for the accessors in the Draco mesh; checks their widths.

        The number of vertices is that of the Draco mesh: encoders split vertices, and some leave ``count`` as it was.
        """
        arrays: dict[int, NDArray[Any]] = {}
        for name, number in primitive["extensions"][DRACO].get("attributes", {}).items():
            index = primitive["attributes"].get(name)
            if index is None or number not in draco.attributes:
                continue
            values, accessor = draco.attributes[number], self._item("accessors", index)
            width = _WIDTHS[accessor["type"]]
            if values.shape[1] != width:
                problem = f"Draco holds {name} of {values.shape[1]} components, must be {width}"
                raise MeshError(f"{self.path}: {problem}; the file is broken")
            if accessor["count"] != len(values):
                self.warn(
                    f"{self.path}: accessor {index} says {accessor['count']} vertices, its Draco mesh has {len(values)}; these are drawn"
                )
            arrays[index] = values
        if primitive["attributes"]["POSITION"] not in arrays:
            raise MeshError(f"{self.path}: a Draco mesh has no POSITION; the file is broken")
        return arrays

    def _attribute(
        self, name: str, attributes: dict[str, Any], count: int, width: int, targets: _Targets = ()
    ) -> NDArray[Any] | None:
        """Returns a vertex attribute (count, width), displaced by morph targets; None if the primitive does not have it."""
        if name not in attributes:
            return None
        array = self._accessor(attributes[name])
        if array.shape != (count, width):
            raise MeshError(f"{self.path}: {name} has shape {array.shape}, must be ({count}, {width}); the file is broken")
        return self._morphed(name, array, targets)

    def _colors(self, index: int, count: int, targets: _Targets) -> NDArray[np.uint8]:
        """Returns the vertex colours, (V, 3 or 4) uint8 sRGB and linear alpha, converted from the linear RGB of the file."""
        linear = self._accessor(index)
        if linear.shape[0] != count or linear.shape[1] not in (3, 4):
            raise MeshError(f"{self.path}: COLOR_0 has shape {linear.shape}, must be ({count}, 3 or 4); the file is broken")
        linear = self._morphed("COLOR_0", linear, targets).astype(np.float64)
        colors = srgb8_from_linear(linear)
        colors[:, 3:] = np.rint(255.0 * np.clip(np.nan_to_num(linear[:, 3:]), 0.0, 1.0))
        return colors

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
            return Material(base_color=_WHITE), 0, None  # matte: nobody means the rough metal of the specification's defaults
        index = primitive["material"]
        source = self._item("materials", index)
        extensions = source.get("extensions", {})
        gloss = _gloss(source)
        pbr = source.get("pbrMetallicRoughness", {})
        info = pbr.get("baseColorTexture") or gloss.get("diffuseTexture")
        factor = pbr.get("baseColorFactor") or gloss.get("diffuseFactor")
        mapping = _uv_mapping(info or next(filter(None, (_map_info(source, name) for name in _MAPS)), {}))
        if index not in self._materials:
            texture = None if info is None else self._texture(info["index"])
            color = _WHITE
            if factor is not None:
                *rgb, alpha = (float(c) for c in factor)
                red, green, blue = srgb_from_linear(rgb).tolist()
                color = (red, green, blue, min(max(alpha, 0.0), 1.0))
            material = Material(
                str(source.get("name", "")),
                color,
                texture,
                "KHR_materials_unlit" in extensions,
                _ALPHA_MODES.get(source.get("alphaMode", "OPAQUE"), "opaque"),
                float(source.get("alphaCutoff", 0.5)),
                bool(source.get("doubleSided", False)),
            )
            if not material.unlit:
                self._warn_of_extensions(material.name, source)
            self._materials[index] = material if material.unlit else self._with_surface(material, source, mapping)
        return self._materials[index], mapping[0], _uv_matrix(mapping[1])

    def _warn_of_extensions(self, name: str, source: dict[str, Any]) -> None:
        """Warns of extensions of a material that change its appearance and are left out."""
        extensions = source.get("extensions", {})
        for extension, values in extensions.items():
            key, neutral, change = _MATERIAL_EXTENSIONS.get(extension, ("", None, "what it adds or changes is left out"))
            if extension in _READ_MATERIAL_EXTENSIONS:
                continue
            inert = isinstance(values, dict) and bool(key) and values.get(key, neutral) == neutral
            if extension == "KHR_materials_specular" and isinstance(values, dict):
                inert &= not set(values) - {"specularFactor", "specularColorFactor"} and values.get(
                    "specularColorFactor", [1, 1, 1]
                ) == [1, 1, 1]
            if not inert:
                self.warn(f"{self.path}: {clipped(extension, 60)} of material {quoted(name)} is not drawn: {change}")
        gloss = _gloss(source)
        if not gloss and _GLOSS in extensions:
            self.warn(f"{self.path}: {_GLOSS} of material {quoted(name)} is left out; it is drawn by its pbrMetallicRoughness")
        if {"specularFactor", "specularGlossinessTexture"} & set(gloss):
            self.warn(f"{self.path}: the specular colours of material {quoted(name)} are left out; it is drawn as a non-metal")

    def _with_surface(self, material: Material, source: dict[str, Any], mapping: _UvMapping) -> Material:
        """Returns the material with metallic, roughness and emissive factors and the other textures."""
        maps: dict[str, Any] = {}
        for name, field in _MAPS.items():
            info = _map_info(source, name)
            if info is None:
                continue
            if _uv_mapping(info) != mapping:
                if not _has_effect(source, name):
                    continue
                # A second set of coordinates for each vertex would take memory in all scenes, and few need it.
                self.warn(
                    f"{self.path}: {name} of material {quoted(material.name)} has other texture coordinates than its base colour; left out"
                )
                continue
            maps[field] = self._texture(info["index"])
        pbr, extensions = source.get("pbrMetallicRoughness", {}), source.get("extensions", {})
        gloss = _gloss(source)
        # By the standard, a material without these keys is a rough metal; exporters that omit all of them mean a non-metal.
        unspecified = not {"metallicFactor", "roughnessFactor", "metallicRoughnessTexture"} & set(pbr)
        if unspecified and not gloss:
            self.warn(
                f"{self.path}: materials without metallicFactor and roughnessFactor are drawn matte; by the specification they are rough "
                "metal, which few exporters mean. Give metallicFactor 1 for metal"
            )
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
        fallback = texture.get("source", source)
        if source is None:
            ktx = "KHR_texture_basisu" in texture.get("extensions", {})
            what = "is KTX2, which is not read" if ktx else "has a format that cannot be read"
            remedy = "; make it PNG: npx @gltf-transform/cli ktxdecompress in.glb out.glb (needs KTX-Software)" if ktx else ""
            text = f"{self.path}: texture {index} {what}; the surface is drawn without it{remedy}"
            self.warn(Omission(text, OmissionKind.UNSUPPORTED_ASSET))
            return None
        if source != fallback and self._image_of(source)[1]:
            self.warn(f"{self.path}: the WebP image of texture {index} cannot be read; its fallback image is drawn")
            source = fallback
        image, problems = self._image_of(source)
        for problem in problems:
            self.warn(problem)
        return image and self.textures.with_sampling(image, self._sampling(texture))

    def _sampling(self, texture: dict[str, Any]) -> Sampling:
        """Returns how a texture is read between and beyond its pixels."""
        if "sampler" not in texture:
            return Sampling()
        sampler = self._item("samplers", texture["sampler"])
        minified, between_levels = _MINIFIED[sampler.get("minFilter", 9987)]
        wraps = (_WRAPS[sampler.get("wrapS", 10497)], _WRAPS[sampler.get("wrapT", 10497)])
        return Sampling(*wraps, "nearest" if sampler.get("magFilter") == 9728 else "linear", minified, between_levels)

    def _image_of(self, index: int) -> tuple[Any, list[str]]:
        """Returns an image, and the warnings about it; each is read once."""
        if index not in self._images:
            problems: list[str] = []
            store = self.textures
            self._images[index] = self._image(index, problems.append, store.from_bytes, store.from_uri), problems
        return self._images[index]

    def _image(self, index: int, warn: Warn, from_bytes: Callable[..., Any], from_uri: Callable[..., Any]) -> Any:
        """Returns an image by one of two methods of ``TextureStore``, or None with a warning."""
        image = self._item("images", index)
        name = f"{self.path}: image {index}"
        if "bufferView" in image:
            view = self._item("bufferViews", image["bufferView"])
            data = self._view(image["bufferView"], 0, np.dtype("u1"), int(view["byteLength"]), 1).tobytes()
            return from_bytes(name, data, warn)
        uri = image.get("uri")
        if uri is None:
            raise MeshError(f"{self.path}: image {index} has neither uri nor bufferView; the file is broken, export it again")
        return from_bytes(name, _data_uri(uri), warn) if uri.startswith("data:") else from_uri(uri, self.path, self.files, warn)


def _gloss(source: dict[str, Any]) -> dict[str, Any]:
    """Returns the KHR_materials_pbrSpecularGlossiness of a material, empty if its ``pbrMetallicRoughness`` says how to draw it.

    Without specular colours, which only metals need, the latter is nearer to what the author saw.
    """
    if {"baseColorTexture", "baseColorFactor"} & set(source.get("pbrMetallicRoughness", {})):
        return {}
    found: dict[str, Any] = source.get("extensions", {}).get(_GLOSS, {})
    return found


def _map_info(source: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Returns the textureInfo of a texture of a material, or None."""
    holder = source.get("pbrMetallicRoughness", {}) if name == "metallicRoughnessTexture" else source
    info: dict[str, Any] | None = holder.get(name)
    return info


def _has_effect(source: dict[str, Any], name: str) -> bool:
    """Returns whether a texture of a material changes the picture: its factor is not 0."""
    if name == "emissiveTexture":
        strength = source.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
        return bool(strength) and any(source.get("emissiveFactor", ()))
    return name != "occlusionTexture" or bool(source[name].get("strength", 1.0))


def _uv_mapping(info: dict[str, Any]) -> _UvMapping:
    """Returns the mapping of a textureInfo."""
    given = info.get("extensions", {}).get("KHR_texture_transform", {})
    transform = {k: given[k] for k, neutral in _NO_TRANSFORM.items() if given.get(k, neutral) != neutral}
    return int(given.get("texCoord", info.get("texCoord", 0))), transform


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
