"""Builds objects from triangles with a material, a tint, pattern coordinates and a chart in a light map. NumPy only.

Metres, z up, triangles counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Tint = tuple[float, float, float]
WHITE: Tint = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Surface:
    """Pattern, tint and texel density of a part."""

    material: str
    """Pattern of the material, a key of ``tiles.PATTERNS``, ``plain``, or one of ``appearances.UNLIT``."""
    tint: Tint = WHITE
    """Colour, sRGB, 0 to 1."""
    importance: float = 1.0
    """Factor of the texel density."""


@dataclass
class SurfacePart:
    """Triangles of one surface."""

    vertices: F64
    """Vertices, (V, 3), m."""
    triangles: I64
    """Triangles, (F, 3)."""
    surface: Surface
    uv: F64
    """Position of each corner in its chart, (F, 3, 2), m."""
    chart: I64
    """Index of the chart of each triangle, from 0, (F,)."""
    pattern: F64
    """Pattern coordinates of each corner, m, x along the grain, and the number of a single picture, (F, 3, 3)."""
    importance: F64
    """Factor of the texel density of each triangle, (F,)."""
    thin: bool = False
    """Whether it is a sheet, seen from both sides, not the surface of a solid."""


class ObjectBuilder:
    """Builds the mesh and the collision boxes of one object."""

    def __init__(self, rng: np.random.Generator, style: int = 0) -> None:
        self.style = style
        """Seed of the properties shared by all pieces of a building."""
        self.parts: list[SurfacePart] = []
        self.boxes: list[tuple[F64, F64]] = []
        """Lower and upper corners of the collision boxes, m."""
        self.rng = rng

    def collide(self, low: ArrayLike, high: ArrayLike) -> None:
        """Adds a collision box between two opposite corners, m."""
        a, b = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        self.boxes.append((np.minimum(a, b), np.maximum(a, b)))

    def add(
        self,
        vertices: ArrayLike,
        triangles: ArrayLike,
        surface: Surface,
        uv: F64 | None = None,
        chart: ArrayLike | None = None,
        pattern: F64 | None = None,
    ) -> SurfacePart:
        """Adds triangles; without ``uv`` each is projected along the axis nearest to its normal. ``pattern``: pattern coordinates, (F, 3, 2)."""
        v, t = np.asarray(vertices, dtype=float), np.asarray(triangles, dtype=np.int64)
        corners = v[t]
        sides = facing_sides(corners)
        if uv is None:
            uv = project_along_sides(corners, sides)
        if pattern is None:
            pattern = _project_with_grain(corners, sides)
        placed = np.concatenate([pattern + self.rng.uniform(0, 50, 3)[:2], np.zeros((len(t), 3, 1))], axis=2)
        chart_indices = sides if chart is None else np.asarray(chart, dtype=np.int64)
        part = SurfacePart(v, t, surface, uv, chart_indices, placed, np.full(len(t), surface.importance))
        self.parts.append(part)
        return part

    def box(
        self, low: ArrayLike, high: ArrayLike, surface: Surface, bevel: float = 0.004, open_sides: str = "", solid: bool = False
    ) -> SurfacePart:
        """Adds a box with chamfered edges.

        Args:
            low: a corner, (3,), metres.
            high: the opposite corner.
            surface: surface of the box.
            bevel: width of the chamfer, metres; 0 = sharp edges.
            open_sides: hidden sides, which get few texels: some of ``-x +x -y +y -z +z``, separated by spaces.
            solid: whether to add it to the collision boxes, too.
        """
        a, b = np.minimum(low, high).astype(float), np.maximum(low, high).astype(float)
        if solid:
            self.collide(a, b)
        bevel = float(min(bevel, 0.3 * (b - a).min()))
        vertices, triangles = _chamfered(a, b, bevel) if bevel > 1e-5 else _sharp(a, b)
        part = self.add(vertices, triangles, surface)
        # A chamfer has the light of the side to which it belongs: it would be narrower than a texel.
        inner = np.array([[1, 2], [0, 2], [0, 1]])[part.chart // 2]
        part.uv = np.clip(part.uv, (a + bevel)[inner][:, None], (b - bevel)[inner][:, None]) if bevel > 1e-5 else part.uv
        for side in open_sides.split():
            chart_index = "xyz".index(side[1]) * 2 + (side[0] == "-")
            part.importance[part.chart == chart_index] *= 0.15
        return part

    def cushion(
        self,
        low: ArrayLike,
        high: ArrayLike,
        surface: Surface,
        power: float = 4.0,
        steps: int = 6,
        sag: float = 0.0,
        noise: float = 0.0,
    ) -> SurfacePart:
        """Adds a soft superellipsoid box, rounder for a smaller ``power``; ``sag`` and ``noise``: m."""
        a, b = np.minimum(low, high).astype(float), np.maximum(low, high).astype(float)
        grid, triangles = _cube_grid(steps)
        sphere = grid / (np.abs(grid) ** power).sum(axis=1, keepdims=True) ** (1.0 / power)
        middle, half = (a + b) / 2, (b - a) / 2
        points = sphere * half
        if noise:
            phase = self.rng.uniform(0, 6.3, (3, 3))
            wave = sum(np.sin(points @ self.rng.normal(0, 9.0, 3) + phase[k, 0]) for k in range(3))
            points = points * (1 + (noise / half.mean() / 3) * np.asarray(wave)[:, None])
        if sag:
            along = np.clip(1 - (sphere[:, :2] ** 2).sum(axis=1), 0, 1)
            points[:, 2] -= sag * along * (sphere[:, 2] > 0)
        points = np.clip(points, -half, half)
        # The charts are the sides of the cube, not those that the normals face, so that their borders are straight.
        sides = np.repeat([1, 0, 3, 2, 5, 4], len(triangles) // 6)
        corners = (points + middle)[triangles]
        uv, pattern = project_along_sides(corners, sides), _project_with_grain(corners, sides)
        return self.add(points + middle, triangles, surface, uv, sides, pattern)

    def lathe(self, middle: ArrayLike, profile: Sequence[tuple[float, float]], surface: Surface, sides: int = 14) -> SurfacePart:
        """Adds a body of revolution about the vertical axis through ``middle``.

        Args:
            middle: point of the axis at height 0, (3,), metres.
            profile: radii and heights, metres, upwards on the outside; a radius of 0 closes it.
            surface: surface of the body.
            sides: number of facets.
        """
        rows = np.asarray(profile, dtype=float)
        angle = np.arange(sides) * (2 * np.pi / sides)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points = np.concatenate([np.column_stack([ring * r, np.full(sides, z)]) for r, z in rows]) + np.asarray(
            middle, dtype=float
        )
        return self._rings(points, len(rows), sides, surface, rows)

    def tube(self, path: ArrayLike, radius: ArrayLike, surface: Surface, sides: int = 8) -> SurfacePart:
        """Adds a curved round bar along ``path``, (N, 3), m, closed at both ends."""
        p = np.asarray(path, dtype=float)
        radii = np.broadcast_to(np.asarray(radius, dtype=float), (len(p),))
        tangent = np.gradient(p, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        helper = np.eye(3)[int(np.argmin(np.abs(tangent).max(axis=0)))]
        side = np.cross(tangent, helper)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(tangent, side)
        angle = np.arange(sides) * (2 * np.pi / sides)
        circle = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
        rings = p[:, None] + circle * radii[:, None, None]
        points = np.concatenate([np.tile(p[:1], (sides, 1)), rings.reshape(-1, 3), np.tile(p[-1:], (sides, 1))])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        rows = np.column_stack([np.concatenate([[0.0], radii, [0.0]]), np.concatenate([[length[0]], length, [length[-1]]])])
        return self._rings(points, len(rows), sides, surface, rows)

    def _rings(self, points: F64, count: int, sides: int, surface: Surface, rows: F64) -> SurfacePart:
        """Adds the surface through rings of points; charts of steep bands are unrolled, those of flat bands projected from above."""
        steps = np.diff(rows, axis=0)
        flat = np.abs(steps[:, 1]) < 0.35 * np.abs(steps[:, 0])
        chart_of_band = np.cumsum(np.concatenate([[0], flat[1:] != flat[:-1]]))  # adjacent bands of the same kind share a chart
        max_radii = np.maximum(rows[:-1, 0], rows[1:, 0])
        widest = np.array([max_radii[chart_of_band == n].max() for n in chart_of_band])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
        band, j = (k.ravel() for k in np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij"))
        columns = np.stack([j, j + 1, j + 1, j], axis=1)
        levels = np.stack([band, band, band + 1, band + 1], axis=1)
        quads = levels * sides + columns % sides
        angle = columns * (2 * np.pi / sides)
        unrolled = np.stack([angle * widest[band][:, None], length[levels]], axis=-1)
        from_above = rows[levels, 0][..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        chart_coords = np.where(flat[band][:, None, None], from_above, unrolled)
        corner_indices = np.array([(0, 1, 2), (0, 2, 3)])
        triangles, uv, chart = (
            quads[:, corner_indices].reshape(-1, 3),
            chart_coords[:, corner_indices].reshape(-1, 3, 2),
            np.repeat(chart_of_band[band], 2),
        )
        ends = points[triangles]
        is_valid = np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1) >= 1e-12
        is_unrolled = ~np.repeat(flat[band], 2)[:, None, None]
        pattern = np.where(is_unrolled, uv[..., ::-1], uv)  # the grain runs along bars
        return self.add(points, triangles[is_valid], surface, uv[is_valid], chart[is_valid], pattern[is_valid])

    def sheet(self, grid: ArrayLike, surface: Surface) -> SurfacePart:
        """Adds a sheet, such as a cloth or a leaf, from a grid of points, (A, B, 3); seen from its front, A runs to the right and B upwards."""
        g = np.asarray(grid, dtype=float)
        a, b = g.shape[:2]
        u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(g, axis=0), axis=2).mean(axis=1))])
        v = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(g, axis=1), axis=2).mean(axis=0))])
        triangles = grid_triangles(a, b)
        chart_coords = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        part = self.add(g.reshape(-1, 3), triangles, surface, chart_coords[triangles], np.zeros(len(triangles), dtype=np.int64))
        part.thin = True
        part.pattern = np.concatenate([chart_coords, np.zeros((len(chart_coords), 1))], axis=1)[triangles]
        return part

    def quad(self, corners: ArrayLike, surface: Surface, pattern: ArrayLike | None = None) -> SurfacePart:
        """Adds a flat quad, (4, 3), counter-clockwise seen from outside. ``pattern``: pattern coordinates and number, (4, 3)."""
        c = np.asarray(corners, dtype=float)
        triangles = np.array([[0, 1, 2], [0, 2, 3]])
        first = (c[1] - c[0]) / np.linalg.norm(c[1] - c[0])
        normal = np.cross(c[1] - c[0], c[3] - c[0])
        second = np.cross(normal / np.linalg.norm(normal), first)
        chart_coords = np.stack([(c - c[0]) @ first, (c - c[0]) @ second], axis=1)
        part = self.add(c, triangles, surface, chart_coords[triangles], [0, 0])
        if pattern is not None:
            part.pattern = np.asarray(pattern, dtype=float)[triangles]
        return part

    def transform(self, since: int, T_new_old: ArrayLike) -> None:
        """Transforms the parts from index ``since`` on by a matrix, (4, 4)."""
        matrix = np.asarray(T_new_old, dtype=float)
        for part in self.parts[since:]:
            part.vertices = part.vertices @ matrix[:3, :3].T + matrix[:3, 3]


def pose_matrix(position: Sequence[float], yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> F64:
    """Returns a transform, (4, 4): roll about x, pitch about y, yaw about z (radians), then translation (m)."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw, pitch, roll))
    yaw_pitch = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    matrix = np.eye(4)
    matrix[:3, :3] = yaw_pitch @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    matrix[:3, 3] = position
    return matrix


def facing_sides(corners: F64) -> I64:
    """Returns the side nearest to each triangle's normal, (F,): 0 = +x, 1 = -x, 2 = +y, 3 = -y, 4 = +z, 5 = -z. ``corners``: (F, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.argmax(np.abs(normal) + np.array([0, 1e-9, 2e-9]), axis=1)
    return np.asarray(axis * 2 + (normal[np.arange(len(normal)), axis] < 0), dtype=np.int64)


def project_along_sides(corners: F64, sides: I64) -> F64:
    """Projects corners, (F, 3, 3), along the axes of their sides; returns (F, 3, 2)."""
    axis = sides // 2
    others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    return np.take_along_axis(corners, others[:, None, :], axis=2)


def _project_with_grain(corners: F64, sides: I64) -> F64:
    """Projects corners, (F, 3, 3), along the axes of their sides; x of the result, (F, 3, 2), is along their longest extent where it can be."""
    longest_axis = int(np.argmax(np.ptp(corners.reshape(-1, 3), axis=0)))
    rolled = np.roll(corners, -longest_axis, axis=2)
    others = np.array([[1, 2], [0, 2], [0, 1]])[(sides // 2 - longest_axis) % 3]
    return np.take_along_axis(rolled, others[:, None, :], axis=2)


def grid_triangles(a: int, b: int) -> I64:
    """Returns the triangles, (F, 3), of a grid of a x b points in row-major order."""
    i = (np.arange(a - 1)[:, None] * b + np.arange(b - 1)).ravel()
    return np.concatenate([np.stack([i, i + b, i + b + 1], 1), np.stack([i, i + b + 1, i + 1], 1)])


def _sharp(a: F64, b: F64) -> tuple[F64, I64]:
    return np.where(_CORNERS, b, a), _SHARP


def _chamfered(a: F64, b: F64, bevel: float) -> tuple[F64, I64]:
    """Returns a box with three points at each corner, one in each adjacent side."""
    corner, inward = np.where(_CORNERS, b, a), np.where(_CORNERS, -bevel, bevel)
    points = corner[:, None, :] + inward[:, None, :] * (1 - np.eye(3))[None]  # corner * 3 + axis of its side
    return points.reshape(-1, 3), _CHAMFERED


def _chamfered_triangles() -> I64:
    """Returns the triangles of a chamfered box: those of sides, edges and corners."""
    polygons = [
        [c * 3 + axis for c in quad] for axis, quads in enumerate((_QUADS[:2], _QUADS[2:4], _QUADS[4:])) for quad in quads
    ]
    for axis in range(3):
        p, q = (k for k in range(3) if k != axis)
        for sp in (0, 1):
            for sq in (0, 1):
                ends = [4 * s[0] + 2 * s[1] + s[2] for s in (_signs(axis, e, p, sp, q, sq) for e in (0, 1))]
                polygons.append([ends[0] * 3 + p, ends[1] * 3 + p, ends[1] * 3 + q, ends[0] * 3 + q])
    polygons += [[c * 3, c * 3 + 1, c * 3 + 2] for c in range(8)]
    points = (_CORNERS[:, None, :] * 2.0 - 1.0 - 0.2 * (_CORNERS[:, None, :] * 2 - 1) * (1 - np.eye(3))[None]).reshape(-1, 3)
    triangles = []
    for polygon in polygons:
        for k in range(1, len(polygon) - 1):
            t = [polygon[0], polygon[k], polygon[k + 1]]
            normal = np.cross(points[t[1]] - points[t[0]], points[t[2]] - points[t[0]])
            triangles.append(t if normal @ points[t].mean(axis=0) > 0 else t[::-1])
    return np.array(triangles)


def _signs(axis: int, end: int, p: int, sp: int, q: int, sq: int) -> list[int]:
    signs = [0, 0, 0]
    signs[axis], signs[p], signs[q] = end, sp, sq
    return signs


def _cube_grid(steps: int) -> tuple[F64, I64]:
    """Returns the surface of the cube from -1 to 1 as a grid with shared points."""
    line = np.linspace(-1, 1, steps + 1)
    line = np.sin(line * np.pi / 2) * 0.6 + line * 0.4  # denser towards the edges
    blocks: list[F64] = []
    triangles: list[I64] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            p, q = np.meshgrid(line, line, indexing="ij")
            block = np.empty((p.size, 3))
            block[:, axis], block[:, (axis + 1) % 3], block[:, (axis + 2) % 3] = sign, p.ravel(), q.ravel()
            faces = grid_triangles(steps + 1, steps + 1)
            triangles.append((faces if sign > 0 else faces[:, ::-1]) + sum(len(k) for k in blocks))
            blocks.append(block)
    points = np.concatenate(blocks)
    _, first, index = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    return points[first], np.asarray(index).reshape(-1)[np.concatenate(triangles)]


_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_QUADS = [(4, 6, 7, 5), (0, 1, 3, 2), (2, 3, 7, 6), (0, 4, 5, 1), (1, 5, 7, 3), (0, 2, 6, 4)]
"""Sides of a box: +x, -x, +y, -y, +z, -z."""
_SHARP = np.array([t for q in _QUADS for t in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))])
_CHAMFERED = _chamfered_triangles()
