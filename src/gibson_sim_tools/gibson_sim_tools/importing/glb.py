"""Writes a mesh as one GLB file with embedded textures: glTF 2.0, y up, metres."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.glb import GlbBuilder
from gibson_sim.formats.light_maps import encoded_light_map, light_map_extensions
from gibson_sim.formats.mesh import TO_Z_UP, LightMapSource, Material, Mesh, TextureSource
from gibson_sim.geometry.colours import linear16_from_srgb8, linear_from_srgb
from gibson_sim.writing import write_file

_JPEG_QUALITY = 94
_ALPHA = {"opaque": "OPAQUE", "mask": "MASK", "blend": "BLEND"}


def write_glb(path: Path, mesh: Mesh, images: dict[int, bytes] | None = None) -> None:
    """Writes all parts of a mesh.

    Args:
        path: path of the file; its folder must exist.
        mesh: mesh to write, with all its material maps.
        images: encoded PNG or JPEG images by ``id()`` of their ``TextureSource``; other textures are encoded by this function.
    """
    builder = GlbBuilder()
    materials = _Materials(builder, images or {})
    to_file = TO_Z_UP["y"].astype(np.float32)
    for part in mesh.parts:
        attributes = {
            "POSITION": builder.attribute(part.vertices @ to_file, bounds=True),
            "NORMAL": builder.attribute(part.normals @ to_file),
        }
        if part.uvs is not None:
            attributes["TEXCOORD_0"] = builder.attribute(part.uvs)
        if part.light_uvs is not None:
            light_uvs = np.rint(np.clip(part.light_uvs, 0.0, 1.0) * 65535.0)
            attributes["TEXCOORD_1"] = builder.attribute(light_uvs, "u2", normalized=True)
        if part.colors is not None and part.material.colored:
            attributes["COLOR_0"] = builder.attribute(_linear16_rgba(part.colors), "u2", normalized=True)
        builder.primitive(attributes, builder.indices(part.triangles), materials.index(part.material))
    write_file(path, builder.to_bytes(path.stem), durable=False)


def encoded(pixels: NDArray[np.uint8]) -> bytes:
    """Encodes an image, (H, W, 3 or 4) uint8 sRGB, as PNG if any pixel is transparent, else as JPEG."""
    transparent = pixels.shape[2] == 4 and bool((pixels[:, :, 3] < 255).any())
    suffix, code = (".png", cv2.COLOR_RGBA2BGRA) if transparent else (".jpg", cv2.COLOR_RGB2BGR)
    bgr = cv2.cvtColor(np.ascontiguousarray(pixels if transparent else pixels[:, :, :3]), code)
    ok, data = cv2.imencode(suffix, bgr, [] if transparent else [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not ok:
        raise SceneError(f"a texture of {pixels.shape[1]} x {pixels.shape[0]} pixels cannot be written as {suffix}")
    return bytes(data)


class _Materials:
    """Adds materials and textures to a file, each once."""

    def __init__(self, builder: GlbBuilder, images: dict[int, bytes]) -> None:
        self._builder, self._encoded_images = builder, images
        self._materials: dict[Material, int] = {}
        self._textures: dict[int, int] = {}

    def index(self, material: Material) -> int:
        """Returns the index of a material in the file."""
        if material not in self._materials:
            self._materials[material] = self._builder.material(self._gltf_material(material))
        return self._materials[material]

    def _gltf_material(self, m: Material) -> dict[str, Any]:
        linear = linear_from_srgb(m.base_color[:3]).tolist()
        pbr: dict[str, Any] = {
            "baseColorFactor": [*linear, m.base_color[3]], "metallicFactor": m.metallic, "roughnessFactor": m.roughness,
        }  # fmt: skip
        gltf_material: dict[str, Any] = {"name": m.name, "pbrMetallicRoughness": pbr, "doubleSided": m.double_sided}
        gltf_material["alphaMode"] = _ALPHA[m.alpha_mode]
        if m.alpha_mode == "mask":
            gltf_material["alphaCutoff"] = m.alpha_cutoff
        if m.unlit:
            gltf_material["extensions"] = {"KHR_materials_unlit": {}}
        if any(m.emissive):
            gltf_material["emissiveFactor"] = [min(c, 1.0) for c in m.emissive]
        for texture, holder, key, extra in (
            (m.texture, pbr, "baseColorTexture", {}),
            (m.metallic_roughness_texture, pbr, "metallicRoughnessTexture", {}),
            (m.normal_texture, gltf_material, "normalTexture", {"scale": m.normal_scale}),
            (m.occlusion_texture, gltf_material, "occlusionTexture", {"strength": m.occlusion_strength}),
            (m.emissive_texture, gltf_material, "emissiveTexture", {}),
        ):
            if texture is not None:
                holder[key] = {"index": self._texture(texture), **extra}
        if m.light_map is not None:
            gltf_material["extensions"] = light_map_extensions(self._light_map(m.light_map), m.light_intensity)
        return gltf_material

    def _texture(self, texture: TextureSource) -> int:
        if id(texture) not in self._textures:
            self._textures[id(texture)] = self._builder.texture_data(
                self._encoded_images.get(id(texture)) or encoded(texture.pixels)
            )
        return self._textures[id(texture)]

    def _light_map(self, light_map: LightMapSource) -> int:
        if id(light_map) not in self._textures:
            self._textures[id(light_map)] = self._builder.texture_data(
                self._encoded_images.get(id(light_map)) or encoded_light_map(light_map.pixels)
            )
        return self._textures[id(light_map)]


def _linear16_rgba(colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Returns linear RGBA, (V, 4) uint16, from ``MeshPart.colors``; without alpha it is 1."""
    alpha = (
        colors[:, 3:].astype(np.uint16) * np.uint16(257)
        if colors.shape[1] == 4
        else np.full((len(colors), 1), 65535, dtype=np.uint16)
    )
    return np.concatenate([linear16_from_srgb8(colors[:, :3]), alpha], axis=1)
