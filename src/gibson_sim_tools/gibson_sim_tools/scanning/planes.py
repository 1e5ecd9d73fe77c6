"""Makes the walls, floors and ceilings of a fused mesh plane: vertices that noise moved are projected onto the planes that they lie on.

Planes are found by growing regions of flat cells and selecting, in each region, the plane with most area. A vertex moves only within the noise
of its plane, never farther than a limit; where two or three planes meet, vertices between them move onto their edge or corner. No triangle is turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_CELL_VOXELS, _LEAST_CELL = 5.0, 0.12
"""Edge of a cell, voxels and metres, whichever is more."""
_FLAT, _LEAST_POINTS = 0.1, 8
"""Largest variance across a flat cell relative to the smaller one along it, and least number of its vertices."""
_SMOOTHED, _MOST_SMOOTHED = 6.0, 8
"""Rounds in which normals are averaged with those beside them, for each voxel of noise, and at most: noise turns them anywhere."""
_ALIKE = math.cos(math.radians(10.0))
"""Least cosine between the normals of neighbouring cells of a region, and between those of a plane and its cells."""
_LEAST_AREA = 0.5
"""Least area of a plane, square metres; smaller flat things stay as they are."""
_TRIALS = 24
"""Planes that are tried in a region; the one with most area is selected."""
_MOST_PLANES = 400
_NOISE = 3.0
"""Distance within which a vertex belongs to a plane, standard deviations of the noise of the plane."""
_MEDIAN = 1.4826
"""Standard deviation of a normal distribution divided by the median absolute deviation."""
_LEAST_VOXELS = 0.25
"""Least distance within which a vertex belongs to a plane, voxels."""
_FULL = 0.7
"""Part of that distance up to which vertices move all the way; beyond, ever less, so that no step remains."""
_BOWED = 1.0
"""Largest height of the arc of a plane, limits of the displacement; a higher one is a curved wall."""
_FACES, _EDGE = math.cos(math.radians(45.0)), math.cos(math.radians(65.0))
"""Least cosine between a plane and the normal of a vertex on it, and of one at an edge of it."""
_PARALLEL = 0.1
"""Least determinant of the products of the normals of planes that have an edge or a corner."""
_HALF = 0.9
"""Least share of the sum of the areas of a flat cell that points along its normal."""
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class SnapReport:
    """What was made plane."""

    planes: int
    """Number of planes."""
    share: float
    """Share of the surface that lies on them now, 0 to 1."""
    mean_mm: float
    """Mean displacement of the vertices that moved, millimetres."""
    max_mm: float
    """Largest displacement, millimetres."""
    noise_mm: float
    """Median over the planes of the standard deviation of their vertices before, millimetres."""

    def text(self) -> str:
        """Returns the report in words."""
        planes = f"{self.planes} plane{'' if self.planes == 1 else 's'} with {100.0 * self.share:.0f} % of the surface"
        moved = f"vertices moved by {self.mean_mm:.1f} mm on average, at most {self.max_mm:.1f}"
        return f"{planes}; their noise was {self.noise_mm:.1f} mm; {moved}"


@dataclass(frozen=True, slots=True, eq=False)
class _Plane:
    """Points x with ``normal @ x == offset``."""

    normal: F64
    """(3,), unit length, on the visible side."""
    offset: float
    """Metres."""
    cells: I64
    """Cells on it."""
    noise: float = 0.0
    """Standard deviation of its vertices, metres."""
    reach: float = 0.0
    """Distance within which vertices belong to it, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Cubes of space with the surface in them."""

    of_vertex: I64
    """(V,), cell of each vertex."""
    centres: F64
    """(C, 3), centroids."""
    normals: F64
    """(C, 3), unit length."""
    areas: F64
    """(C,), square metres, without what noise adds; 0 = not flat."""
    noise: float
    """Median standard deviation of the vertices across the flat cells, metres."""
    pairs: I64
    """(P, 2), neighbouring cells."""


def snapped(mesh: ColouredMesh, voxel: float, limit: float) -> tuple[ColouredMesh, SnapReport]:
    """Returns the mesh with its planes plane.

    Args:
        mesh: a fused mesh, welded.
        voxel: edge of the voxels that it was made of, metres.
        limit: largest displacement of a vertex, metres.
    """
    vertices = mesh.vertices.astype(np.float64)
    crosses = mesh.crosses()
    sums = _vertex_sums(mesh, crosses)
    cells = _cells(vertices, sums, max(_CELL_VOXELS * voxel, _LEAST_CELL), limit)
    normals = _smoothed(sums, mesh.triangles, min(_MOST_SMOOTHED, math.ceil(_SMOOTHED * cells.noise / voxel)))
    order = np.argsort(cells.of_vertex, kind="stable")
    first = np.searchsorted(cells.of_vertex[order], np.arange(len(cells.centres) + 1))
    planes = [_measured(p, vertices, normals, order, first, voxel, limit) for p in _planes(cells, limit)]
    out, edge = _projected(vertices, normals, planes, cells, order, first, limit)
    out = _without_folds(vertices, out, mesh.triangles, crosses, edge)
    away = np.linalg.norm(out - vertices, axis=1)
    moved = away > 0.0
    on = np.zeros(len(vertices), dtype=bool)
    for p in planes:
        rows = _vertices_of(p.cells, order, first)
        on[rows] |= (np.abs(out[rows] @ p.normal - p.offset) < 1e-6) & (normals[rows] @ p.normal > _EDGE)
    sizes = np.linalg.norm(crosses, axis=1)
    report = SnapReport(
        len(planes),
        float(sizes[on[mesh.triangles].all(axis=1)].sum() / max(float(sizes.sum()), 1e-12)),
        1000.0 * float(away[moved].mean()) if moved.any() else 0.0,
        1000.0 * float(away.max(initial=0.0)),
        1000.0 * float(np.median([p.noise for p in planes])) if planes else 0.0,
    )
    return replace(mesh, vertices=out.astype(np.float32)), report


def _vertex_sums(mesh: ColouredMesh, crosses: F64) -> F64:
    """Returns (V, 3): a third of the areas of the triangles around each vertex, along their normals, square metres."""
    count = len(mesh.vertices)
    sums = np.zeros((count, 3))
    for k in range(3):
        for axis in range(3):
            sums[:, axis] += np.bincount(mesh.triangles[:, k], crosses[:, axis] / 6.0, minlength=count)
    return sums


def _smoothed(sums: F64, triangles: NDArray[np.int32], rounds: int) -> F64:
    """Returns unit normals (V, 3), averaged with those beside them as many rounds as given."""
    ends = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    beside = sparse.coo_matrix((np.ones(len(ends), dtype=np.float32), tuple(ends.T)), shape=(len(sums),) * 2).tocsr()
    normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    for _ in range(rounds):
        normals = normals + beside @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return np.asarray(normals)


def _cells(vertices: F64, sums: F64, edge: float, limit: float) -> _Cells:
    """Returns the cubes of vertices (V, 3) around which the surface sums to ``sums`` (V, 3)."""
    grid = np.floor(vertices / edge).astype(np.int64)
    grid -= grid.min(axis=0, initial=0)
    sides = grid.max(axis=0, initial=0) + 1
    codes, of_vertex = np.unique((grid[:, 0] * sides[1] + grid[:, 1]) * sides[2] + grid[:, 2], return_inverse=True)
    of_vertex, number = of_vertex.reshape(-1), len(codes)
    counts = np.bincount(of_vertex, minlength=number)

    def totals(values: F64) -> F64:
        return np.stack([np.bincount(of_vertex, values[:, k], minlength=number) for k in range(3)], axis=1)

    centres = totals(vertices) / np.maximum(counts, 1)[:, None]
    off = vertices - centres[of_vertex]
    spread = np.empty((number, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            spread[:, i, j] = spread[:, j, i] = np.bincount(of_vertex, off[:, i] * off[:, j], minlength=number)
    values, vectors = np.linalg.eigh(spread / np.maximum(counts, 1)[:, None, None])
    # What noise adds to the area points anywhere, so that it is not in the sum of the areas along their normals.
    facing = totals(sums)
    areas = np.abs((facing * vectors[:, :, 0]).sum(axis=1))
    normals = vectors[:, :, 0] * np.where((facing * vectors[:, :, 0]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    flat = (counts >= _LEAST_POINTS) & (values[:, 0] <= min(limit, edge / 4.0) ** 2) & (values[:, 0] < _FLAT * values[:, 1])
    flat &= areas > _HALF * np.linalg.norm(facing, axis=1)
    noise = float(np.median(np.sqrt(np.maximum(values[flat, 0], 0.0)))) if flat.any() else 0.0
    places = np.stack([codes // (sides[1] * sides[2]), codes // sides[2] % sides[1], codes % sides[2]], axis=1)
    # Cells that share a face, an edge or a corner.
    pairs = cKDTree(places).query_pairs(1.8, output_type="ndarray")
    return _Cells(of_vertex, centres, normals, np.where(flat, areas, 0.0), noise, pairs.astype(np.int64))


def _planes(cells: _Cells, limit: float) -> list[_Plane]:
    """Returns the planes of the flat cells, each with the cells on it; the largest regions first."""
    rng = np.random.default_rng(0)
    flat = cells.areas > 0.0
    a, b = cells.pairs.T
    alike = flat[a] & flat[b] & ((cells.normals[a] * cells.normals[b]).sum(axis=1) > _ALIKE)
    between = cells.centres[b] - cells.centres[a]
    middle = (cells.normals[a] + cells.normals[b]) / 2.0
    alike &= np.abs((between * middle).sum(axis=1)) < limit
    pairs = cells.pairs[alike]
    found: list[_Plane] = []
    waiting = [part for part in _parts(np.flatnonzero(flat), pairs, len(flat)) if cells.areas[part].sum() >= _LEAST_AREA]
    while waiting and len(found) < _MOST_PLANES:
        waiting.sort(key=lambda part: float(cells.areas[part].sum()))
        part = waiting.pop()
        plane = _best_plane(cells, part, limit, rng)
        if plane is None:
            continue
        rest = np.setdiff1d(part, plane.cells)
        for piece in _parts(plane.cells, pairs, len(flat)):
            if cells.areas[piece].sum() >= _LEAST_AREA and not _bowed(cells, piece, plane, limit):
                found.append(replace(plane, cells=piece))
        waiting += [p for p in _parts(rest, pairs, len(flat)) if cells.areas[p].sum() >= _LEAST_AREA]
    return found


def _parts(rows: I64, pairs: I64, count: int) -> list[I64]:
    """Returns the connected parts of some cells."""
    if not len(rows):
        return []
    inside = np.zeros(count, dtype=bool)
    inside[rows] = True
    kept = pairs[inside[pairs].all(axis=1)]
    graph = sparse.coo_matrix((np.ones(len(kept), dtype=bool), (kept[:, 0], kept[:, 1])), shape=(count, count))
    label = csgraph.connected_components(graph, directed=False)[1][rows]
    order = np.argsort(label, kind="stable")
    return np.split(rows[order], np.flatnonzero(np.diff(label[order])) + 1)


def _best_plane(cells: _Cells, part: I64, limit: float, rng: np.random.Generator) -> _Plane | None:
    """Returns the plane with most area among the cells of a part; None if there is none that is large enough."""
    centres, normals, areas = cells.centres[part], cells.normals[part], cells.areas[part]
    tried = rng.choice(len(part), size=min(_TRIALS, len(part)), replace=False, p=areas / areas.sum())
    best, most = None, 0.0
    for k in tried:
        normal, offset = normals[k], float(normals[k] @ centres[k])
        inside = np.zeros(0, dtype=bool)
        for _ in range(4):
            inside = (np.abs(centres @ normal - offset) < limit) & (normals @ normal > _ALIKE)
            if inside.sum() < 4:
                break
            normal, offset = _fitted(centres[inside], areas[inside], normal)
        area = float(areas[inside].sum())
        if inside.sum() >= 4 and area > most:
            best, most = _Plane(normal, offset, part[inside]), area
    return best if most >= _LEAST_AREA else None


def _fitted(points: F64, weights: F64, towards: F64) -> tuple[F64, float]:
    """Returns normal (3,), on the side of ``towards``, and offset of the plane through points (N, 3)."""
    middle = np.average(points, axis=0, weights=weights)
    off = points - middle
    normal = np.linalg.eigh((off * weights[:, None]).T @ off)[1][:, 0]
    normal = normal * (1.0 if float(normal @ towards) >= 0.0 else -1.0)
    return normal, float(normal @ middle)


def _bowed(cells: _Cells, piece: I64, plane: _Plane, limit: float) -> bool:
    """Returns whether a piece of a plane is an arc rather than noise: a curved wall keeps its shape."""
    off = cells.centres[piece] @ plane.normal - plane.offset
    u, v = (cells.centres[piece] @ side for side in np.linalg.svd(plane.normal[None])[2][1:])
    u, v = u - u.mean(), v - v.mean()
    terms = np.stack([np.ones(len(u)), u, v, u * u, u * v, v * v], axis=1)
    weights = np.sqrt(cells.areas[piece])
    factors = np.linalg.lstsq(terms * weights[:, None], off * weights, rcond=None)[0]
    arc = terms[:, 3:] @ factors[3:]
    low, high = np.percentile(arc, (2.0, 98.0))
    return bool(high - low > _BOWED * limit)


def _vertices_of(cells: I64, order: I64, first: I64) -> I64:
    """Returns the vertices in some cells."""
    counts = first[cells + 1] - first[cells]
    starts = np.repeat(first[cells] - np.cumsum(counts) + counts, counts)
    return order[starts + np.arange(int(counts.sum()))]


def _measured(plane: _Plane, vertices: F64, normals: F64, order: I64, first: I64, voxel: float, limit: float) -> _Plane:
    """Returns the plane through the vertices of its cells, with their noise."""
    rows = _vertices_of(plane.cells, order, first)
    rows = rows[normals[rows] @ plane.normal > _FACES]
    normal, offset, noise = plane.normal, plane.offset, limit / _NOISE
    for _ in range(3):
        off = vertices[rows] @ normal - offset
        close = rows[np.abs(off) <= np.clip(_NOISE * noise, _LEAST_VOXELS * voxel, limit)]
        if len(close) < 4:
            break
        normal, offset = _fitted(vertices[close], np.ones(len(close)), normal)
        noise = _MEDIAN * float(np.median(np.abs(vertices[close] @ normal - offset)))
    reach = float(min(max(_NOISE * noise, _LEAST_VOXELS * voxel), limit))
    return replace(plane, normal=normal, offset=offset, noise=noise, reach=reach)


def _projected(
    vertices: F64, normals: F64, planes: list[_Plane], cells: _Cells, order: I64, first: I64, limit: float
) -> tuple[F64, Bools]:
    """Returns the vertices (V, 3) on their planes, and which of them, (V,), moved onto an edge or a corner."""
    out = vertices.copy()
    near: list[tuple[I64, I64]] = []
    beside = sparse.coo_matrix(
        (np.ones(len(cells.pairs), dtype=bool), (cells.pairs[:, 0], cells.pairs[:, 1])), shape=(len(cells.centres),) * 2
    ).tocsr()
    beside = beside + beside.T
    closest = np.full(len(vertices), np.inf)
    for number, plane in enumerate(planes):
        inside = np.zeros(len(cells.centres), dtype=bool)
        inside[plane.cells] = True
        inside |= np.asarray(beside @ inside > 0)
        rows = _vertices_of(np.flatnonzero(inside), order, first)
        off = vertices[rows] @ plane.normal - plane.offset
        facing = normals[rows] @ plane.normal
        close = (np.abs(off) < plane.reach) & (facing > _EDGE)
        rows, off, facing = rows[close], off[close], facing[close]
        near.append((rows, np.full(len(rows), number)))
        on = (facing > _FACES) & (np.abs(off) < closest[rows])
        part = np.clip((plane.reach - np.abs(off[on])) / ((1.0 - _FULL) * plane.reach), 0.0, 1.0)
        out[rows[on]] = vertices[rows[on]] - (part * off[on])[:, None] * plane.normal
        closest[rows[on]] = np.abs(off[on])
    edge = np.zeros(len(vertices), dtype=bool)
    if near:
        _to_edges(vertices, out, edge, planes, np.concatenate([r for r, _ in near]), np.concatenate([k for _, k in near]), limit)
    return out, edge


def _to_edges(vertices: F64, out: F64, edge: Bools, planes: list[_Plane], rows: I64, numbers: I64, limit: float) -> None:
    """Moves vertices that lie on several planes onto their edge or corner, in ``out``, and marks them in ``edge``."""
    order = np.lexsort((numbers, rows))
    rows, numbers = rows[order], numbers[order]
    counts = np.bincount(rows, minlength=len(vertices))
    start = np.cumsum(counts) - counts
    every, offsets = np.stack([p.normal for p in planes]), np.array([p.offset for p in planes])
    for count in (2, 3):
        which = np.flatnonzero(counts == count)
        if not len(which):
            continue
        chosen = numbers[start[which][:, None] + np.arange(count)]
        N, d = every[chosen], offsets[chosen]
        products = N @ N.transpose(0, 2, 1)
        distinct = np.linalg.det(products) > _PARALLEL
        which, N, d, products = which[distinct], N[distinct], d[distinct], products[distinct]
        off = np.einsum("vij,vj->vi", N, vertices[which]) - d
        step = np.einsum("vij,vi->vj", N, np.linalg.solve(products, off[:, :, None])[:, :, 0])
        short = np.linalg.norm(step, axis=1) <= limit
        out[which[short]] = vertices[which[short]] - step[short]
        edge[which[short]] = True


def _without_folds(vertices: F64, out: F64, triangles: NDArray[np.int32], crosses: F64, edge: Bools) -> F64:
    """Returns the moved vertices, but for those whose move would turn a triangle or take its area."""
    out = out.copy()
    sizes = np.linalg.norm(crosses, axis=1)
    for turn in range(_ROUNDS):
        corners = out[triangles]
        now = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        bad = (now * crosses).sum(axis=1) <= 0.02 * sizes**2
        bad &= sizes > 0.0
        if not bad.any():
            return out
        again = triangles[bad].reshape(-1)
        # Vertices on edges go back first; they alone move along a surface.
        back = again[edge[again]] if turn < _ROUNDS // 2 else again
        back = back if len(back) else again
        out[back] = vertices[back]
    corners = out[triangles]
    now = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    bad = ((now * crosses).sum(axis=1) <= 0.0) & (sizes > 0.0)
    while bad.any():
        out[triangles[bad].reshape(-1)] = vertices[triangles[bad].reshape(-1)]
        corners = out[triangles]
        now = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        bad = ((now * crosses).sum(axis=1) <= 0.0) & (sizes > 0.0)
    return out
