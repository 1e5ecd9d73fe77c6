"""Writes solids with their finishes as one binary glTF 2.0 file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.formats.glb import glb_bytes
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.types import Vec3
from gibson_sim.writing import write_file
from gibson_sim_tools.making.robots.surfaces import Solid

_BYTE, _USHORT, _FLOAT, _ARRAY, _INDICES = 5120, 5123, 5126, 34962, 34963
_Z_UP_TO_Y_UP = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]
"""By columns, as glTF has matrices."""


@dataclass(frozen=True, slots=True)
class Finish:
    """What a surface is made of."""

    color: Vec3
    """sRGB, 0 to 1."""
    roughness: float = 0.5
    metallic: float = 0.0
    emissive: Vec3 = (0.0, 0.0, 0.0)
    """Linear, 0 to 1."""


def write_solids(path: Path, solids: Sequence[Solid], finishes: Mapping[str, Finish]) -> None:
    """Writes solids, metres, z up; those of one finish become one mesh."""
    used = list(dict.fromkeys(solid.finish for solid in solids))
    binary = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def add(values: np.ndarray[Any, Any], component: int, kind: str, target: int, stride: int = 0) -> int:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes, "target": target})
        if stride:
            views[-1]["byteStride"] = stride
        binary.extend(values.tobytes() + b"\0" * (-values.nbytes % 4))
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        return len(accessors) - 1

    primitives = []
    for number, name in enumerate(used):
        vertices, normals, triangles = _merged([solid for solid in solids if solid.finish == name])
        position = add(vertices.astype("<f4"), _FLOAT, "VEC3", _ARRAY)
        accessors[position] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
        packed = np.zeros((len(normals), 4), dtype=np.int8)  # the fourth byte only fills
        packed[:, :3] = np.round(normals * 127.0)
        attributes = {"POSITION": position, "NORMAL": add(packed, _BYTE, "VEC3", _ARRAY, stride=4)}
        accessors[-1]["normalized"] = True
        indices = add(triangles.reshape(-1).astype("<u2"), _USHORT, "SCALAR", _INDICES)
        primitives.append({"attributes": attributes, "indices": indices, "material": number})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "gibson_sim_tools.making"},
        "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": path.stem, "matrix": _Z_UP_TO_Y_UP}],
        "meshes": [{"primitives": primitives}], "materials": [_material(name, finishes[name]) for name in used],
        "bufferViews": views, "accessors": accessors, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    write_file(path, glb_bytes(document, binary))


def _merged(solids: Sequence[Solid]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Returns (vertices (V, 3), normals (V, 3), triangles (F, 3)) of several solids."""
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    triangles = np.concatenate([solid.triangles + start for solid, start in zip(solids, starts, strict=False)])
    return np.concatenate([s.vertices for s in solids]), np.concatenate([s.normals for s in solids]), triangles


def _material(name: str, finish: Finish) -> dict[str, Any]:
    surface = {
        "baseColorFactor": [*np.round(linear_from_srgb(finish.color), 5).tolist(), 1.0],
        "metallicFactor": finish.metallic,
        "roughnessFactor": finish.roughness,
    }
    return {"name": name, "pbrMetallicRoughness": surface, "emissiveFactor": list(finish.emissive)}
