"""Builds meshes from quads, z up, and writes them as binary glTF 2.0, y up, with external textures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.formats.glb import GlbBuilder
from gibson_sim.writing import write_file

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class MeshMaterial:
    """A material: a texture file beside the mesh, or a plain colour."""

    name: str
    texture: str = ""
    """File name of the texture; empty = none."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Linear colour, 0 to 1; multiplies the texture."""
    metres: float = 1.0
    """Size of one repeat of the texture, m."""
    unlit: bool = False


@dataclass
class MeshBuilder:
    """Builds a mesh from primitives, grouped by material. Metres, z up."""

    points: dict[MeshMaterial, list[F32]] = field(default_factory=dict)
    """Blocks of vertices, (N, 8): position, normal, uv (v = 0 at the top of the image)."""
    faces: dict[MeshMaterial, list[NDArray[np.uint32]]] = field(default_factory=dict)
    """Blocks of triangles, (F, 3)."""

    def add(self, material: MeshMaterial, positions: ArrayLike, normals: ArrayLike, uvs: ArrayLike, triangles: ArrayLike) -> None:
        """Adds triangles (F, 3) over positions (N, 3), normals (N, 3) and uvs (N, 2)."""
        vertex_count = sum(len(block) for block in self.points.setdefault(material, []))
        block = np.hstack([np.asarray(a, dtype=np.float32) for a in (positions, normals, uvs)])
        self.points[material].append(block)
        self.faces.setdefault(material, []).append(np.asarray(triangles, dtype=np.uint32) + np.uint32(vertex_count))

    def quad(self, material: MeshMaterial, corners: ArrayLike, uvs: ArrayLike | None = None) -> None:
        """Adds a flat quad. ``corners``: (4, 3), counter-clockwise seen from outside, the first at the lower left.

        Without ``uvs``, (4, 2), the texture repeats every ``material.metres``, upright along the first edge.
        """
        p = np.asarray(corners, dtype=np.float64)
        u, v = p[1] - p[0], p[3] - p[0]
        normal = np.cross(u, v)
        normal /= np.linalg.norm(normal)
        w, h = np.linalg.norm(u) / material.metres, np.linalg.norm(v) / material.metres
        repeated = np.array([[0, 0], [w, 0], [w, -h], [0, -h]])
        self.add(material, p, np.tile(normal, (4, 1)), repeated if uvs is None else uvs, [[0, 1, 2], [0, 2, 3]])

    def box(self, low: ArrayLike, high: ArrayLike, material: MeshMaterial, *, omit: Iterable[str] = ()) -> None:
        """Adds a box between two corners, m, without the sides in ``omit`` (-x +x -y +y -z +z); a box on the floor has no underside."""
        hidden = {*omit, "-z"} if np.asarray(low, dtype=float)[2] <= 0.0 else set(omit)
        (x0, y0, z0), (x1, y1, z1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        corners = {
            "-x": [(x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1)],
            "+x": [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
            "-y": [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
            "+y": [(x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1)],
            "-z": [(x0, y1, z0), (x1, y1, z0), (x1, y0, z0), (x0, y0, z0)],
            "+z": [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        }
        for side, quad in corners.items():
            if side not in hidden:
                self.quad(material, quad)

    def cylinder(
        self,
        center: ArrayLike,
        radius: float,
        height: float,
        material: MeshMaterial,
        *,
        top: float | None = None,
        sides: int = 20,
    ) -> None:
        """Adds a vertical cylinder with its base at ``center``, or a truncated cone with the upper radius ``top``, m."""
        c, top = np.asarray(center, dtype=float), radius if top is None else top
        angle = np.linspace(0.0, 2 * np.pi, sides + 1)
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        low, high = c + circle * radius, c + circle * top + np.array([0, 0, height])
        u = angle / (2 * np.pi) * (2 * np.pi * radius / material.metres)
        uv = np.concatenate([np.stack([u, 0 * u], 1), np.stack([u, 0 * u - height / material.metres], 1)])
        i = np.arange(sides)
        n = sides + 1
        triangles = np.concatenate([np.stack([i, i + 1, i + 1 + n], 1), np.stack([i, i + 1 + n, i + n], 1)])
        self.add(material, np.concatenate([low, high]), np.tile(circle, (2, 1)), uv, triangles)
        for ring, r, up in ((high, top, 1.0), (low, radius, -1.0)):
            if r <= 0.0 or (up < 0 and c[2] <= 0.0):
                continue
            middle = c + np.array([0, 0, height if up > 0 else 0.0])
            fan = np.stack([np.zeros(sides, int), i + 1, i + 2], 1)[:, :: 1 if up > 0 else -1]
            points = np.concatenate([middle[None], ring])
            self.add(material, points, np.tile([0, 0, up], (len(points), 1)), points[:, :2] / material.metres, fan)

    def cushion(self, low: ArrayLike, high: ArrayLike, material: MeshMaterial, round_by: float = 0.05, steps: int = 2) -> None:
        """Adds a box with rounded edges and corners of radius ``round_by``, m."""
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        center, half = (low + high) / 2, (high - low) / 2
        inner = np.maximum(half - round_by, 0.0)
        ramp = np.linspace(0.0, 1.0, steps + 1)
        for axis in range(3):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            along = [np.concatenate([-half[k] + round_by * ramp, (half[k] - round_by * ramp)[::-1]]) for k in (a, b)]
            ga, gb = np.meshgrid(*along, indexing="ij")
            n = ga.shape[1]
            i = (np.arange(ga.shape[0] - 1)[:, None] * n + np.arange(n - 1)).ravel()
            for side in (-1.0, 1.0):
                p = np.empty((ga.size, 3))
                p[:, axis], p[:, a], p[:, b] = side * half[axis], ga.ravel(), gb.ravel()
                core = np.clip(p, -inner, inner)
                normal = p - core
                normal /= np.linalg.norm(normal, axis=1, keepdims=True)
                triangles = np.concatenate([np.stack([i, i + n, i + n + 1], 1), np.stack([i, i + n + 1, i + 1], 1)])
                uv = np.stack([ga.ravel(), -gb.ravel()], 1) / material.metres
                self.add(material, core + round_by * normal + center, normal, uv, triangles if side > 0 else triangles[:, ::-1])

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return sum(len(f) for blocks in self.faces.values() for f in blocks)


def write_glb(path: Path, mesh: MeshBuilder) -> None:
    """Writes a mesh as GLB with external textures, y up."""
    builder = GlbBuilder()
    for material, blocks in mesh.points.items():
        rows = np.concatenate(blocks)
        attributes = {
            "POSITION": builder.attribute(_y_up(rows[:, :3]), bounds=True),
            "NORMAL": builder.attribute(_y_up(rows[:, 3:6])),
            "TEXCOORD_0": builder.attribute(rows[:, 6:8]),
        }
        indices = builder.indices(np.concatenate(mesh.faces[material]))
        builder.primitive(attributes, indices, builder.material(_material(material, builder)))
    write_file(path, builder.to_bytes(path.stem), durable=False)


def _y_up(z_up: F32) -> F32:
    """Converts vectors, (N, 3), from z up to the y-up axes of glTF."""
    return np.stack([z_up[:, 0], z_up[:, 2], -z_up[:, 1]], axis=1)


def _material(material: MeshMaterial, builder: GlbBuilder) -> dict[str, Any]:
    pbr: dict[str, Any] = {"baseColorFactor": [*material.color, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9}
    if material.texture:
        pbr["baseColorTexture"] = {"index": builder.texture_file(material.texture)}
    gltf_material: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": pbr, "doubleSided": True}
    if material.unlit:
        gltf_material["extensions"] = {"KHR_materials_unlit": {}}
    return gltf_material
