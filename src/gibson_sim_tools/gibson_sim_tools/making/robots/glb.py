"""Writes closed surfaces and their materials as one binary glTF 2.0 file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.types import Vec3
from gibson_sim.writing import write_file
from gibson_sim_tools.making.robots.surfaces import ClosedSurface


@dataclass(frozen=True, slots=True)
class Finish:
    """A material."""

    color: Vec3
    """Base colour, sRGB, 0 to 1."""
    roughness: float = 0.5
    metallic: float = 0.0
    emissive: Vec3 = (0.0, 0.0, 0.0)
    """Emitted colour, linear, 0 to 1."""


def write_solids(path: Path, solids: Sequence[ClosedSurface], finishes: Mapping[str, Finish]) -> None:
    """Writes solids, metres, z up; solids with the same finish become one primitive."""
    builder = GlbBuilder()
    builder.require("KHR_mesh_quantization")
    for name in dict.fromkeys(solid.finish for solid in solids):
        vertices, normals, triangles = _merged([solid for solid in solids if solid.finish == name])
        attributes = {
            "POSITION": builder.attribute(vertices, bounds=True),
            "NORMAL": builder.attribute(np.round(normals * 127.0), "i1", normalized=True),
        }
        builder.primitive(attributes, builder.indices(triangles, "u2"), builder.material(_material(name, finishes[name])))
    write_file(path, builder.to_bytes(path.stem, Z_UP_TO_Y_UP))


def _merged(solids: Sequence[ClosedSurface]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Returns the vertices (V, 3), normals (V, 3) and triangles (F, 3) of several solids, concatenated."""
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
