"""Writes the meshes of finished scenes: small binary glTF 2.0 files with quantised positions and external textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.writing import write_file

F64 = NDArray[np.float64]
_MAX_QUANTISED = 65535


@dataclass(frozen=True)
class BakedMaterial:
    """A material with baked light."""

    texture: str = ""
    """File name, beside the mesh; empty = plain colour."""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """sRGB colour and opacity, 0 to 1."""


@dataclass(frozen=True)
class Patch:
    """Triangles of one material."""

    material: BakedMaterial
    corners: F64
    """Corners, (F, 3, 3), m, z up."""
    uv: F64 | None = None
    """Texture coordinates, (F, 3, 2), 0 to 1 from the lower left; None without a texture."""


def write_glb(path: Path, patches: Sequence[Patch]) -> None:
    """Writes an object; corners with equal position and texture coordinates share a vertex."""
    all_corners = np.concatenate([p.corners.reshape(-1, 3) for p in patches])
    low, size = all_corners.min(axis=0), np.maximum(np.ptp(all_corners, axis=0), 1e-4)
    builder = GlbBuilder()
    builder.require("KHR_mesh_quantization")
    for patch in patches:
        columns = [np.round((patch.corners.reshape(-1, 3) - low) / size * _MAX_QUANTISED).astype(np.uint16)]
        if patch.uv is not None:
            flipped = patch.uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]
            columns.append(np.round(np.clip(flipped, 0, 1) * _MAX_QUANTISED).astype(np.uint16))
        rows, index = np.unique(np.concatenate(columns, axis=1), axis=0, return_inverse=True)
        triangles = np.asarray(index).reshape(-1, 3)
        triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
        attributes = {"POSITION": builder.attribute(rows[:, :3], "u2", bounds=True)}
        if patch.uv is not None:
            attributes["TEXCOORD_0"] = builder.attribute(rows[:, 3:], "u2", normalized=True)
        indices = builder.indices(triangles, "u2" if not len(triangles) or triangles.max() < _MAX_QUANTISED else "u4")
        builder.primitive(attributes, indices, builder.material(_material(patch.material, builder)))
    # Quantised positions range from 0 to 65535 along the axes of the z-up frame.
    T_zup_quantised = np.block([[np.diag(size / _MAX_QUANTISED), low[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    write_file(path, builder.to_bytes(path.stem, Z_UP_TO_Y_UP @ T_zup_quantised), durable=False)


def write_boxes(path: Path, boxes: ArrayLike) -> None:
    """Writes boxes, lower and upper corners (B, 2, 3), m, as one collision mesh."""
    pairs = np.asarray(boxes, dtype=float).reshape(-1, 2, 3)
    unit_corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
    triangles = np.array([t for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
    corners = np.where(unit_corners[None], pairs[:, 1:2], pairs[:, :1])
    write_glb(path, [Patch(BakedMaterial(), corners[:, triangles].reshape(-1, 3, 3))])


def _material(material: BakedMaterial, builder: GlbBuilder) -> dict[str, Any]:
    pbr: dict[str, Any] = {
        "baseColorFactor": [*linear_from_srgb(material.color[:3]).tolist(), material.color[3]],
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    if material.texture:
        pbr["baseColorTexture"] = {"index": builder.texture_file(material.texture)}
    gltf_material: dict[str, Any] = {"pbrMetallicRoughness": pbr, "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}
    if material.color[3] < 1.0:
        gltf_material["alphaMode"] = "BLEND"
    return gltf_material
