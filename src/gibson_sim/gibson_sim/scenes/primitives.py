"""Boxes, spheres and cylinders as triangles, the same for drawing, maps and rays. Normals point outward."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from gibson_sim.errors import MeshError
from gibson_sim.geometry.triangles import areas_of
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.mesh_types import F64, I64, Material, Mesh, MeshPart

_Maker = Callable[[float, float, float], tuple[F64, F64, F64, I64]]
SEGMENTS = 48
"""Corners of a circle."""


@lru_cache(maxsize=256)
def primitive_mesh(shape: Shape) -> Mesh:
    """Returns a box, sphere or cylinder (about z), centred at the origin, metres."""
    makers: dict[str, _Maker] = {"box": _box, "sphere": _sphere, "cylinder": _cylinder}
    if shape.kind not in makers:
        raise MeshError(f"shape {quoted(shape.kind)} is no primitive; known: {', '.join(makers)}")
    needed = {"box": 3, "sphere": 1, "cylinder": 2}[shape.kind]
    if not all(math.isfinite(s) and s > 0 for s in shape.size[:needed]):
        raise MeshError(f"{shape.kind}: size is {tuple(shape.size)}, the first {needed} must be finite and above 0 (metres)")
    vertices, normals, uvs, triangles = makers[shape.kind](*shape.size)
    part = MeshPart(
        vertices.astype(np.float32), normals.astype(np.float32), uvs.astype(np.float32), triangles.astype(np.uint32), Material()
    )
    return Mesh((part,))


def _box(x: float, y: float, z: float) -> tuple[F64, F64, F64, I64]:
    faces = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = np.zeros(3)
            normal[axis] = sign
            right = np.array([0.0, 1.0, 0.0]) if axis == 0 else np.array([1.0, 0.0, 0.0])
            up = np.cross(normal, right)
            faces.append(np.stack([normal - right - up, normal + right - up, normal + right + up, normal - right + up]))
    vertices = np.concatenate(faces) * np.array([x, y, z]) / 2
    normals = np.repeat([np.eye(3)[k] * s for k in range(3) for s in (1.0, -1.0)], 4, axis=0)
    uvs = np.tile([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], (6, 1))
    quads = np.arange(24).reshape(6, 4)
    return vertices, normals, uvs, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _circle() -> F64:
    """Returns points around the unit circle, (SEGMENTS + 1, 2); the last one is the first, to the bit, so that what is closed has no gap."""
    around = 2 * math.pi * (np.arange(SEGMENTS + 1) % SEGMENTS) / SEGMENTS
    return np.column_stack([np.cos(around), np.sin(around)])


def _grid(rows: int, columns: int) -> I64:
    """Returns triangles (F, 3) of a grid of vertices, row by row, counter-clockwise where rows go down and columns right."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None, :]).ravel()
    lower = corner + columns
    return np.concatenate([np.stack([corner, lower, lower + 1], 1), np.stack([corner, lower + 1, corner + 1], 1)])


def _sphere(radius: float, _y: float, _z: float) -> tuple[F64, F64, F64, I64]:
    rings = SEGMENTS // 2
    u, v = np.meshgrid(np.linspace(0, 1, SEGMENTS + 1), np.linspace(0, 1, rings + 1))
    down = math.pi * v
    level = np.sin(down)
    level[-1] = 0.0  # sin(pi) is not quite
    around = np.tile(_circle(), (rings + 1, 1))
    normals = np.column_stack([level.ravel() * around[:, 0], level.ravel() * around[:, 1], np.cos(down).ravel()])
    triangles = _grid(rings + 1, SEGMENTS + 1)
    area = areas_of((radius * normals)[triangles])
    # At the poles half of the triangles collapse to a line.
    return radius * normals, normals, np.stack([u.ravel(), v.ravel()], 1), triangles[area > 5e-10 * radius * radius]


def _cylinder(radius: float, length: float, _z: float) -> tuple[F64, F64, F64, I64]:
    side = np.column_stack([_circle(), np.zeros(SEGMENTS + 1)])
    ring = side * radius
    up = np.array([0.0, 0.0, length / 2])
    top, bottom = ring + up, ring - up
    n = SEGMENTS + 1
    k = np.arange(SEGMENTS)
    vertices = np.concatenate([top, bottom, top, bottom, [[0, 0, length / 2], [0, 0, -length / 2]]])
    z = np.array([[0.0, 0.0, 1.0]])
    normals = np.concatenate([side, side, np.repeat(z, n, 0), np.repeat(-z, n, 0), z, -z])
    disc = 0.5 + 0.5 * side[:, :2] * [1, -1]
    strip = np.linspace(0, 1, n)
    uvs = np.concatenate([np.stack([strip, 0 * strip], 1), np.stack([strip, 0 * strip + 1], 1), disc, disc, [[0.5, 0.5]] * 2])
    upper = np.stack([np.full(SEGMENTS, 4 * n), 2 * n + k, 2 * n + k + 1], 1)
    lower = np.stack([np.full(SEGMENTS, 4 * n + 1), 3 * n + k + 1, 3 * n + k], 1)
    return vertices, normals, uvs, np.concatenate([_grid(2, n), upper, lower])
