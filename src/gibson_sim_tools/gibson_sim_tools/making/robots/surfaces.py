"""Lofts smooth closed surfaces through cross-sections: rounded boxes, tubes, barrels; writes them and their materials as one binary glTF 2.0 file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.formats.mesh import area_normals
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.types import Vec3
from gibson_sim.writing import write_file

F64 = NDArray[np.float64]
_FINE_M, _COARSE_M = 0.1, 0.02
"""Half edge lengths above which corners have many points, and below which they have few, m."""
_BEVEL_RINGS = 4
"""Number of rings of a rounded edge."""


@dataclass(frozen=True, slots=True)
class Section:
    """A cross-section normal to z, metres: a rectangle with round corners; a circle if the radius equals both half edges."""

    z: float
    half_x: float
    half_y: float
    radius: float
    """Radius of the corners."""
    x: float = 0.0
    """Centre, x."""
    y: float = 0.0
    """Centre, y."""

    def inset(self, depth: float, z: float) -> Section:
        """Returns the section inset by ``depth``, at height ``z``."""
        half_x, half_y = max(self.half_x - depth, 1e-5), max(self.half_y - depth, 1e-5)
        return Section(z, half_x, half_y, min(max(self.radius - depth, 1e-5), half_x, half_y), self.x, self.y)

    def outline(self, points: int) -> F64:
        """Returns the outline, (P, 3), counter-clockwise seen from +z, with ``points`` points on each corner."""
        turns = np.linspace(0.0, math.pi / 2, points)
        corners = []
        for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            angles = turns + quarter * math.pi / 2
            middle = (self.x + sx * (self.half_x - self.radius), self.y + sy * (self.half_y - self.radius))
            corners.append(np.stack([middle[0] + self.radius * np.cos(angles), middle[1] + self.radius * np.sin(angles)], axis=1))
        flat = np.concatenate(corners)
        return np.concatenate([flat, np.full((len(flat), 1), self.z)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class ClosedSurface:
    """A closed smooth surface of one material."""

    vertices: F64
    """Vertices, (V, 3), m."""
    normals: F64
    """Outward normals, (V, 3)."""
    triangles: NDArray[np.int64]
    """Triangles, (F, 3), counter-clockwise seen from outside."""
    finish: str
    """Name of its material."""

    def transformed(self, xyz: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0)) -> ClosedSurface:
        """Returns the surface rotated (radians) and translated (metres)."""
        T = matrix_from_pose(pose_from_xyz_rpy(xyz, rpy))
        rotation = T[:3, :3]
        return ClosedSurface(self.vertices @ rotation.T + T[:3, 3], self.normals @ rotation.T, self.triangles, self.finish)


def loft(sections: Sequence[Section], finish: str, bevel: float = 0.0, bevel_end: float | None = None) -> ClosedSurface:
    """Returns the surface through sections stacked along z, closed by flat ends with rounded edges.

    Args:
        sections: two or more sections, the lowest first.
        finish: name of the material.
        bevel: radius of the edge at the lower end, metres.
        bevel_end: radius of the edge at the upper end, metres; None = ``bevel``.
    """
    first, last = sections[0], sections[-1]
    upper = bevel if bevel_end is None else bevel_end
    rings = [*_rounded(first, bevel, up=False), *sections[1:-1], *reversed(_rounded(last, upper, up=True))]
    widest = max(max(ring.half_x, ring.half_y) for ring in rings)
    points = 12 if widest > _FINE_M else 8 if widest > _COARSE_M else 5
    outlines = [ring.outline(points) for ring in rings]
    ring_size, ends = len(outlines[0]), (np.array([[s.x, s.y, s.z]]) for s in (first, last))
    vertices = np.concatenate([*outlines, *ends])
    side = np.arange(ring_size)
    next_side = (side + 1) % ring_size
    triangles = []
    for ring in range(len(rings) - 1):
        below, above = ring * ring_size, (ring + 1) * ring_size
        triangles.append(np.stack([below + side, below + next_side, above + next_side], axis=1))
        triangles.append(np.stack([below + side, above + next_side, above + side], axis=1))
    top = (len(rings) - 1) * ring_size
    bottom_middle, top_middle = len(vertices) - 2, len(vertices) - 1
    triangles.append(np.stack([next_side, side, np.full(ring_size, bottom_middle)], axis=1))
    triangles.append(np.stack([top + side, top + next_side, np.full(ring_size, top_middle)], axis=1))
    return _merge_vertices(vertices, np.concatenate(triangles), finish)


def tube(radii: Sequence[tuple[float, float]], finish: str, bevel: float = 0.0, bevel_end: float | None = None) -> ClosedSurface:
    """Returns the body of revolution through (z, radius) pairs, metres, z ascending."""
    return loft([Section(z, radius, radius, radius) for z, radius in radii], finish, bevel, bevel_end)


def box(low: Vec3, high: Vec3, finish: str, corner: float, bevel: float) -> ClosedSurface:
    """Returns a box between two corners. ``corner``: radius of its vertical edges, ``bevel``: radius of the others, m."""
    x, y = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2
    half_x, half_y = (high[0] - low[0]) / 2, (high[1] - low[1]) / 2
    radius = min(corner, half_x, half_y)
    return loft([Section(z, half_x, half_y, radius, x, y) for z in (low[2], high[2])], finish, bevel)


def _rounded(end: Section, bevel: float, *, up: bool) -> list[Section]:
    """Returns the rings of a rounded edge, from the flat end to the side."""
    if bevel <= 0.0:
        return [end]
    angles = np.linspace(math.pi / 2, 0.0, _BEVEL_RINGS + 1)
    inward = -1.0 if up else 1.0
    return [end.inset(bevel * (1.0 - math.cos(a)), end.z + inward * bevel * (1.0 - math.sin(a))) for a in angles.tolist()]


def _merge_vertices(vertices: F64, triangles: NDArray[np.int64], finish: str) -> ClosedSurface:
    """Returns the surface with coincident vertices merged and degenerate triangles removed."""
    _, first, shared = np.unique(np.round(vertices, 7), axis=0, return_index=True, return_inverse=True)
    merged = np.asarray(shared).reshape(-1)[triangles]
    distinct = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]
    return ClosedSurface(vertices[first], area_normals(vertices[first], distinct), distinct, finish)


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
