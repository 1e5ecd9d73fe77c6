"""Builds binary glTF 2.0 files (GLB), https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from gibson_sim.formats.light_maps import light_map_extensions

GENERATOR = "gibson_sim"
"""``asset.generator`` of every file."""
Z_UP_TO_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""T_yup_zup, (4, 4): from axes with z up to those of glTF."""

_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_ALIGNMENT = 4
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_COMPONENT_TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_MIME_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}


class GlbBuilder:
    """Builder of a glTF file of one node with one mesh. All methods that add an object return its index."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._primitives: list[dict[str, Any]] = []
        self._used: set[str] = set()
        self._required: set[str] = set()

    def attribute(self, values: ArrayLike, dtype: DTypeLike = "f4", *, normalized: bool = False, bounds: bool = False) -> int:
        """Adds an accessor of a vertex attribute; every vertex is aligned to 4 bytes.

        Args:
            values: (N, 2 to 4).
            dtype: component type of the file: i1, u1, i2, u2, u4 or f4.
            normalized: whether integers represent 0 to 1, or -1 to 1.
            bounds: whether to write ``min`` and ``max``, which POSITION must have.
        """
        rows = np.asarray(values)
        width, component = rows.shape[1], np.dtype(dtype).newbyteorder("<")
        stride = -(-width * component.itemsize // _ALIGNMENT) * _ALIGNMENT
        packed = np.zeros((len(rows), stride // component.itemsize), dtype=component)
        packed[:, :width] = rows
        extra: dict[str, Any] = {"normalized": True} if normalized else {}
        if bounds:
            extra |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        layout = {"target": _ARRAY_BUFFER} | ({"byteStride": stride} if component.itemsize < _ALIGNMENT else {})
        return self._accessor(packed, f"VEC{width}", len(rows), layout, extra)

    def indices(self, triangles: ArrayLike, dtype: DTypeLike = "u4") -> int:
        """Adds an accessor of the vertex indices of triangles, (F, 3); ``dtype`` is u1, u2 or u4."""
        flat = np.asarray(triangles).ravel().astype(np.dtype(dtype).newbyteorder("<"))
        return self._accessor(flat, "SCALAR", flat.size, {"target": _ELEMENT_ARRAY_BUFFER}, {})

    def texture_file(self, uri: str) -> int:
        """Adds a texture from an image file beside the GLB; equal files share one texture."""
        image = {"uri": uri}
        if image not in self._images:
            self._images.append(image)
        return self._images.index(image)

    def texture_data(self, encoded: bytes) -> int:
        """Adds a texture from an encoded PNG or JPEG, which is embedded in the file."""
        mime_type = next((mime for magic, mime in _MIME_TYPES.items() if encoded.startswith(magic)), "image/png")
        self._images.append({"bufferView": self._view(encoded, {}), "mimeType": mime_type})
        return len(self._images) - 1

    def material(self, material: Mapping[str, Any]) -> int:
        """Adds a glTF material object; its extensions are declared as used."""
        self._used |= set(material.get("extensions", {}))
        self._materials.append(dict(material))
        return len(self._materials) - 1

    def light_mapped_material(self, material: Mapping[str, Any], light_map: int, intensity: float) -> int:
        """Adds a glTF material object with a light map, whose primitives need TEXCOORD_1.

        Args:
            material: the material, with its base colour.
            light_map: texture with the light map, from ``texture_data`` or ``texture_file``.
            intensity: as ``Material.light_intensity``.
        """
        return self.material(
            {**material, "extensions": {**material.get("extensions", {}), **light_map_extensions(light_map, intensity)}}
        )

    def primitive(self, attributes: Mapping[str, int], indices: int, material: int) -> int:
        """Adds triangles of one material to the mesh; ``attributes`` are accessors by glTF semantic (``POSITION``)."""
        self._primitives.append({"attributes": dict(attributes), "indices": indices, "material": material})
        return len(self._primitives) - 1

    def require(self, extension: str) -> None:
        """Declares an extension without which the file cannot be read."""
        self._used.add(extension)
        self._required.add(extension)

    def to_bytes(self, name: str, T_scene_mesh: NDArray[Any] | None = None) -> bytes:
        """Returns the file.

        Args:
            name: name of the node.
            T_scene_mesh: (4, 4), in the axes of glTF (y up); None = identity.
        """
        node: dict[str, Any] = {"mesh": 0, "name": name}
        if T_scene_mesh is not None:
            node["matrix"] = T_scene_mesh.T.ravel().tolist()  # column-major
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": GENERATOR},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node], "meshes": [{"primitives": self._primitives}],
            "materials": self._materials, "accessors": self._accessors, "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
        }  # fmt: skip
        if self._images:
            document["images"] = self._images
            document["textures"] = [{"source": k} for k in range(len(self._images))]
        if self._used:
            document["extensionsUsed"] = sorted(self._used)
        if self._required:
            document["extensionsRequired"] = sorted(self._required)
        return glb_bytes(document, self._binary)

    def _accessor(self, data: NDArray[Any], kind: str, count: int, layout: Mapping[str, int], extra: Mapping[str, Any]) -> int:
        component_type = _COMPONENT_TYPES[data.dtype.str[1:]]
        view = self._view(data.tobytes(), layout)
        self._accessors.append({"bufferView": view, "componentType": component_type, "count": count, "type": kind, **extra})
        return len(self._accessors) - 1

    def _view(self, data: bytes, layout: Mapping[str, int]) -> int:
        """Adds bytes to the buffer, padded so that the next view is aligned."""
        self._views.append({"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data), **layout})
        self._binary += data
        self._binary += b"\0" * (-len(data) % _ALIGNMENT)
        return len(self._views) - 1


def glb_bytes(document: Mapping[str, Any], binary: bytes | bytearray) -> bytes:
    """Returns a GLB file.

    Args:
        document: the glTF; its first buffer, if any, is ``binary`` and has no ``uri``.
        binary: that buffer; empty = the file has no BIN chunk.
    """
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = _chunk(_JSON, text, b" ") + (_chunk(_BIN, binary, b"\0") if binary else b"")
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


def _chunk(kind: int, data: bytes | bytearray, padding: bytes) -> bytes:
    """Returns a chunk with its header; its length is a multiple of 4 and includes the padding."""
    padded = data + padding * (-len(data) % _ALIGNMENT)
    return struct.pack("<II", len(padded), kind) + padded
