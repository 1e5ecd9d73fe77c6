"""Writes the meshes of finished scenes: small glTF 2.0 files (binary) with textures beside them and quantised positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.formats.glb import glb_bytes
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.writing import write_file

F64 = NDArray[np.float64]
_ARRAY, _INDICES = 34962, 34963
_USHORT, _UINT = 5123, 5125
_STEPS = 65535


@dataclass(frozen=True)
class Paint:
    """A surface whose light is baked in."""

    texture: str = ""
    """File name, beside the mesh; empty = one colour."""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """sRGB and opacity."""


@dataclass(frozen=True)
class Patch:
    """Triangles of one paint."""

    paint: Paint
    corners: F64
    """(F, 3, 3): metres, z up."""
    uv: F64 | None = None
    """(F, 3, 2): 0 to 1 from the lower left; None without a texture."""


def write_glb(path: Path, patches: Sequence[Patch]) -> None:
    """Writes an object; corners of like place and texture are shared."""
    every = np.concatenate([p.corners.reshape(-1, 3) for p in patches])
    low, size = every.min(axis=0), np.maximum(np.ptp(every, axis=0), 1e-4)
    writer = _Writer()
    primitives: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    textures: list[str] = []
    for patch in patches:
        place = np.round((patch.corners.reshape(-1, 3) - low) / size * _STEPS).astype(np.uint16)
        columns = [place]
        if patch.uv is not None:
            flipped = patch.uv.reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]
            columns.append(np.round(np.clip(flipped, 0, 1) * _STEPS).astype(np.uint16))
        rows, index = np.unique(np.concatenate(columns, axis=1), axis=0, return_inverse=True)
        triangles = np.asarray(index).reshape(-1, 3)
        distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
        attributes = {"POSITION": writer.attribute(rows[:, :3], "VEC3", bounds=True)}
        if patch.uv is not None:
            attributes["TEXCOORD_0"] = writer.attribute(rows[:, 3:], "VEC2", normalized=True)
            if patch.paint.texture not in textures:
                textures.append(patch.paint.texture)
        primitives.append({"attributes": attributes, "indices": writer.indices(triangles[distinct]), "material": len(materials)})
        materials.append(_material(patch.paint, textures))
    # Positions go from 0 to 65535 along the axes of our frame; the node brings them to metres and to the axes of glTF (y up).
    matrix = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    matrix = matrix @ np.block([[np.diag(size / _STEPS), low[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
    node = {"mesh": 0, "name": path.stem, "matrix": matrix.T.ravel().tolist()}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "gibson_sim_tools.making"},
        "extensionsUsed": ["KHR_materials_unlit", "KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node], "meshes": [{"primitives": primitives}], "materials": materials,
    }  # fmt: skip
    if textures:
        document["images"] = [{"uri": name} for name in textures]
        document["textures"] = [{"source": k} for k in range(len(textures))]
    writer.write(path, document)


def write_boxes(path: Path, boxes: ArrayLike) -> None:
    """Writes boxes (B, 2, 3), low and high corners, as one mesh for physics."""
    pairs = np.asarray(boxes, dtype=float).reshape(-1, 2, 3)
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
    triangles = np.array([t for q in quads for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
    points = np.where(corner[None], pairs[:, 1:2], pairs[:, :1])
    write_glb(path, [Patch(Paint(), points[:, triangles].reshape(-1, 3, 3))])


def _material(paint: Paint, textures: list[str]) -> dict[str, Any]:
    surface: dict[str, Any] = {
        "baseColorFactor": [*linear_from_srgb(paint.color[:3]).tolist(), paint.color[3]],
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    if paint.texture:
        surface["baseColorTexture"] = {"index": textures.index(paint.texture)}
    material: dict[str, Any] = {"pbrMetallicRoughness": surface, "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}
    if paint.color[3] < 1.0:
        material["alphaMode"] = "BLEND"
    return material


class _Writer:
    """The binary part of a file in the making."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []

    def attribute(self, values: NDArray[np.uint16], kind: str, *, normalized: bool = False, bounds: bool = False) -> int:
        """Adds (N, 2 or 3) numbers, each vertex at a multiple of 4 bytes."""
        width = values.shape[1]
        padded = np.zeros((len(values), width + width % 2), dtype="<u2")
        padded[:, :width] = values
        more: dict[str, Any] = {"normalized": True} if normalized else {}
        if bounds:
            more |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self._add(padded, _ARRAY, len(values), kind, _USHORT, padded.shape[1] * 2, more)

    def indices(self, triangles: NDArray[np.int64]) -> int:
        """Adds triangles."""
        small = not len(triangles) or triangles.max() < _STEPS
        flat = triangles.ravel().astype("<u2" if small else "<u4")
        return self._add(flat, _INDICES, flat.size, "SCALAR", _USHORT if small else _UINT, None, {})

    def _add(
        self, data: NDArray[Any], target: int, count: int, kind: str, component: int, stride: int | None, more: dict[str, Any]
    ) -> int:
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": data.nbytes, "target": target}
        if stride is not None:
            view["byteStride"] = stride
        self._views.append(view)
        self._binary.extend(data.tobytes())
        self._binary.extend(b"\0" * (-len(self._binary) % 4))
        self._accessors.append(
            {"bufferView": len(self._views) - 1, "componentType": component, "count": count, "type": kind, **more}
        )
        return len(self._accessors) - 1

    def write(self, path: Path, document: dict[str, Any]) -> None:
        """Writes the file."""
        document |= {"accessors": self._accessors, "bufferViews": self._views, "buffers": [{"byteLength": len(self._binary)}]}
        write_file(path, glb_bytes(document, self._binary), durable=False)
