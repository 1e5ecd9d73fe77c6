"""Writes a mesh as one GLB file, its textures inside: glTF 2.0, y up, metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.glb import glb_bytes
from gibson_sim.formats.mesh import TO_Z_UP, Material, Mesh, MeshPart, TextureSource
from gibson_sim.geometry.colours import linear16_from_srgb8, linear_from_srgb
from gibson_sim.writing import write_file

_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_JPEG_QUALITY = 94
_MIME = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_ALPHA = {"opaque": "OPAQUE", "mask": "MASK", "blend": "BLEND"}


def write_glb(path: Path, mesh: Mesh, images: dict[int, bytes] | None = None) -> None:
    """Writes all parts of a mesh.

    Args:
        path: of the file; its folder must exist.
        mesh: what to write. Normals, occlusion and other further textures are written too.
        images: encoded PNG or JPEG files to take for textures, by ``id()`` of the ``TextureSource``; others are encoded.
    """
    document = _Document(images or {})
    for part in mesh.parts:
        document.add(part)
    write_file(path, document.glb(path.stem), durable=False)


def encoded(pixels: NDArray[np.uint8]) -> bytes:
    """Returns an image as PNG where it has an alpha that matters, else as JPEG."""
    clear = pixels.shape[2] == 4 and bool((pixels[:, :, 3] < 255).any())
    suffix, code = (".png", cv2.COLOR_RGBA2BGRA) if clear else (".jpg", cv2.COLOR_RGB2BGR)
    bgr = cv2.cvtColor(np.ascontiguousarray(pixels if clear else pixels[:, :, :3]), code)
    ok, data = cv2.imencode(suffix, bgr, [] if clear else [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not ok:
        raise SceneError(f"a texture of {pixels.shape[1]} x {pixels.shape[0]} pixels cannot be written as {suffix}")
    return bytes(data)


class _Document:
    """A glTF file while it is put together."""

    def __init__(self, images: dict[int, bytes]) -> None:
        self._given = images
        self._binary = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._materials: dict[Material, int] = {}
        self._sources: list[dict[str, Any]] = []
        self._textures: dict[int, int] = {}
        self._images: list[dict[str, Any]] = []
        self._primitives: list[dict[str, Any]] = []
        self._unlit = False

    def add(self, part: MeshPart) -> None:
        to_file = TO_Z_UP["y"].astype(np.float32)
        position = np.ascontiguousarray(part.vertices @ to_file)
        attributes = {
            "POSITION": self._accessor(position, "VEC3", _FLOAT, min=position.min(0).tolist(), max=position.max(0).tolist()),
            "NORMAL": self._accessor(np.ascontiguousarray(part.normals @ to_file), "VEC3", _FLOAT),
        }
        if part.uvs is not None:
            attributes["TEXCOORD_0"] = self._accessor(part.uvs, "VEC2", _FLOAT)
        if part.colors is not None and part.material.colored:
            attributes["COLOR_0"] = self._accessor(_linear16(part.colors), "VEC4", _USHORT, normalized=True)
        indices = self._accessor(part.triangles.astype(np.uint32).ravel(), "SCALAR", _UINT)
        self._primitives.append({"attributes": attributes, "indices": indices, "material": self._material(part.material)})

    def glb(self, name: str) -> bytes:
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "gibson_sim_tools.importing"},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": name}],
            "meshes": [{"primitives": self._primitives}], "materials": self._sources,
            "accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": len(self._binary)}],
        }  # fmt: skip
        if self._images:
            document["images"] = self._images
            document["textures"] = [{"source": k} for k in range(len(self._images))]
        if self._unlit:
            document["extensionsUsed"] = ["KHR_materials_unlit"]
        return glb_bytes(document, self._binary)

    def _view(self, data: bytes) -> int:
        self._binary.extend(b"\0" * (-len(self._binary) % 4))
        self._views.append({"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data)})
        self._binary.extend(data)
        return len(self._views) - 1

    def _accessor(self, values: NDArray[Any], kind: str, component: int, **more: Any) -> int:
        view = self._view(np.ascontiguousarray(values).tobytes())
        self._accessors.append({"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more})
        return len(self._accessors) - 1

    def _material(self, material: Material) -> int:
        if material not in self._materials:
            self._materials[material] = len(self._sources)
            self._sources.append(self._source(material))
        return self._materials[material]

    def _source(self, m: Material) -> dict[str, Any]:
        linear = linear_from_srgb(m.base_color[:3]).tolist()
        surface: dict[str, Any] = {
            "baseColorFactor": [*linear, m.base_color[3]], "metallicFactor": m.metallic, "roughnessFactor": m.roughness,
        }  # fmt: skip
        out: dict[str, Any] = {"name": m.name, "pbrMetallicRoughness": surface, "doubleSided": m.double_sided}
        out["alphaMode"] = _ALPHA[m.alpha_mode]
        if m.alpha_mode == "mask":
            out["alphaCutoff"] = m.alpha_cutoff
        if m.unlit:
            self._unlit = True
            out["extensions"] = {"KHR_materials_unlit": {}}
        if any(m.emissive):
            out["emissiveFactor"] = [min(c, 1.0) for c in m.emissive]
        for texture, holder, key, more in (
            (m.texture, surface, "baseColorTexture", {}),
            (m.metallic_roughness_texture, surface, "metallicRoughnessTexture", {}),
            (m.normal_texture, out, "normalTexture", {"scale": m.normal_scale}),
            (m.occlusion_texture, out, "occlusionTexture", {"strength": m.occlusion_strength}),
            (m.emissive_texture, out, "emissiveTexture", {}),
        ):
            if texture is not None:
                holder[key] = {"index": self._texture(texture), **more}
        return out

    def _texture(self, texture: TextureSource) -> int:
        if id(texture) not in self._textures:
            data = self._given.get(id(texture)) or encoded(texture.pixels)
            kind = next((kind for magic, kind in _MIME.items() if data.startswith(magic)), "image/png")
            self._textures[id(texture)] = len(self._images)
            self._images.append({"bufferView": self._view(data), "mimeType": kind})
        return self._textures[id(texture)]


def _linear16(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Returns (V, 4) linear red, green, blue and 1 as 16-bit numbers."""
    return np.concatenate([linear16_from_srgb8(colors), np.full((len(colors), 1), 65535, dtype=np.uint16)], axis=1)
