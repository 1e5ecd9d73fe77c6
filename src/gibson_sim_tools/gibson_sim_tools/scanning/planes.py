"""Plane snapping: detects the planes of walls, floors and ceilings in a fused mesh and projects their noisy vertices onto them.

Plane detection: vertices are binned into cells, flat cells (PCA) are grouped by region growing, and sample consensus selects the plane of largest
area in each region. A vertex moves only within the noise of its plane, at most a limit. Where two or three planes meet, vertices move onto their
common edge or corner. Moves that would flip a triangle are undone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

_CELL_VOXELS, _MIN_CELL_SIZE = 5.0, 0.12
"""Edge of a cell, voxels and metres; the larger one applies."""
_MAX_FLATNESS, _MIN_POINTS = 0.1, 8
"""Largest ratio of the smallest to the second eigenvalue of a flat cell's covariance, and least number of its vertices."""
_SMOOTHING_PER_NOISE, _MAX_SMOOTHING = 6.0, 8
"""Rounds of normal smoothing per voxel of noise, and their largest number."""
_MIN_NORMAL_COSINE = math.cos(math.radians(10.0))
"""Least cosine between normals of neighbouring cells of a region, and between the normals of a plane and its cells."""
_MIN_AREA = 0.5
"""Least area of a plane, square metres; smaller flat surfaces are not snapped."""
_TRIALS = 24
"""Number of hypotheses of the sample consensus in a region."""
_MAX_PLANES = 400
_NOISE_DEVIATIONS = 3.0
"""Largest distance of a plane's vertices, standard deviations of the plane's noise."""
_DEVIATION_PER_MAD = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""
_MIN_TOLERANCE_VOXELS = 0.25
"""Least value of that distance, voxels."""
_FULL_SNAP_FRACTION = 0.7
"""Fraction of that distance within which vertices are fully projected; beyond, the weight falls linearly to 0, which avoids steps."""
_MAX_CURVATURE_LIMITS = 1.0
"""Largest height of a plane's quadratic part, in limits of the displacement; a curved wall exceeds it."""
_FACE_COSINE, _EDGE_COSINE = math.cos(math.radians(45.0)), math.cos(math.radians(65.0))
"""Least cosine between the normals of a plane and of a vertex on its face, and of a vertex on one of its edges."""
_MIN_DETERMINANT = 0.1
"""Least determinant of the Gram matrix of the normals of planes that intersect in an edge or a corner."""
_MIN_AREA_FRACTION = 0.9
"""Least component along the normal of a flat cell's summed area vector, as a fraction of its length."""
_UNFOLD_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class SnapReport:
    """Report of plane snapping. The names of the fields are keys of its JSON."""

    planes: int
    """Number of planes."""
    share: float
    """Share of the surface on them after snapping, 0 to 1."""
    mean_mm: float
    """Mean displacement of the vertices that moved, millimetres."""
    max_mm: float
    """Largest displacement, millimetres."""
    noise_mm: float
    """Median over the planes of their noise before snapping (standard deviation), millimetres."""

    def text(self) -> str:
        """Returns the report as text."""
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
    """Indices of the cells on it."""
    noise: float = 0.0
    """Standard deviation of its vertices' distances, metres."""
    tolerance: float = 0.0
    """Largest distance of its vertices, metres."""


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """C occupied cells of a grid over V vertices."""

    of_vertex: I64
    """(V,), cell of each vertex."""
    centres: F64
    """(C, 3), centroids of the vertices, metres."""
    normals: F64
    """(C, 3), unit length."""
    areas: F64
    """(C,), surface area projected along the normal, square metres; 0 = not flat."""
    noise: float
    """Median over the flat cells of the standard deviation along the normal, metres."""
    pairs: I64
    """(P, 2), pairs of neighbouring cells (26-neighbourhood)."""


def snap_to_planes(mesh: TriangleMesh, voxel: float, limit: float) -> tuple[TriangleMesh, SnapReport]:
    """Returns the mesh with vertices snapped to its planes, and a report.

    Args:
        mesh: a fused mesh with welded vertices.
        voxel: edge of the voxels of the fusion, metres.
        limit: largest displacement of a vertex, metres.
    """
    vertices = mesh.vertices
    triangle_vectors = mesh.doubled_area_vectors()
    vertex_vectors = _vertex_area_vectors(mesh, triangle_vectors)
    cells = _cells(vertices, vertex_vectors, max(_CELL_VOXELS * voxel, _MIN_CELL_SIZE), limit)
    normals = _smooth_normals(
        vertex_vectors, mesh.triangles, min(_MAX_SMOOTHING, math.ceil(_SMOOTHING_PER_NOISE * cells.noise / voxel))
    )
    order = np.argsort(cells.of_vertex, kind="stable")
    first = np.searchsorted(cells.of_vertex[order], np.arange(len(cells.centres) + 1))
    planes = [_refit(p, vertices, normals, order, first, voxel, limit) for p in _planes(cells, limit)]
    moved_vertices, edge = _project_to_planes(vertices, normals, planes, cells, order, first, limit)
    moved_vertices = _undo_flips(vertices, moved_vertices, mesh.triangles, triangle_vectors, edge)
    displacement = np.linalg.norm(moved_vertices - vertices, axis=1)
    is_moved = displacement > 0.0
    is_on_plane = np.zeros(len(vertices), dtype=bool)
    for p in planes:
        rows = _vertices_of(p.cells, order, first)
        is_on_plane[rows] |= (np.abs(moved_vertices[rows] @ p.normal - p.offset) < 1e-6) & (
            normals[rows] @ p.normal > _EDGE_COSINE
        )
    doubled_areas = np.linalg.norm(triangle_vectors, axis=1)
    report = SnapReport(
        len(planes),
        float(doubled_areas[is_on_plane[mesh.triangles].all(axis=1)].sum() / max(float(doubled_areas.sum()), 1e-12)),
        1000.0 * float(displacement[is_moved].mean()) if is_moved.any() else 0.0,
        1000.0 * float(displacement.max(initial=0.0)),
        1000.0 * float(np.median([p.noise for p in planes])) if planes else 0.0,
    )
    return replace(mesh, vertices=moved_vertices).single(), report


def _vertex_area_vectors(mesh: TriangleMesh, triangle_vectors: F64) -> F64:
    """Returns the area vectors of the vertices, (V, 3): sum of a third of each adjacent triangle's area times its normal, square metres."""
    count = len(mesh.vertices)
    vertex_vectors = np.zeros((count, 3))
    for k in range(3):
        for axis in range(3):
            vertex_vectors[:, axis] += np.bincount(mesh.triangles[:, k], triangle_vectors[:, axis] / 6.0, minlength=count)
    return vertex_vectors


def _smooth_normals(vertex_vectors: F64, triangles: I64, rounds: int) -> F64:
    """Returns unit vertex normals (V, 3), averaged with those of neighbouring vertices in each round."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    neighbours = sparse.coo_matrix(
        (np.ones(len(edges), dtype=np.float32), tuple(edges.T)), shape=(len(vertex_vectors),) * 2
    ).tocsr()
    normals = vertex_vectors / np.maximum(np.linalg.norm(vertex_vectors, axis=1, keepdims=True), 1e-30)
    for _ in range(rounds):
        normals = normals + neighbours @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return np.asarray(normals)


def _cells(vertices: F64, vertex_vectors: F64, edge: float, limit: float) -> _Cells:
    """Returns the grid cells of vertices (V, 3), metres, with area vectors (V, 3), square metres.

    Args:
        vertices: (V, 3).
        vertex_vectors: (V, 3), of ``_vertex_area_vectors``.
        edge: edge of a cell, metres.
        limit: largest displacement of a vertex, metres.
    """
    grid = np.floor(vertices / edge).astype(np.int64)
    grid -= grid.min(axis=0, initial=0)
    sides = grid.max(axis=0, initial=0) + 1
    codes, of_vertex = np.unique((grid[:, 0] * sides[1] + grid[:, 1]) * sides[2] + grid[:, 2], return_inverse=True)
    of_vertex, number = of_vertex.reshape(-1), len(codes)
    counts = np.bincount(of_vertex, minlength=number)

    def totals(values: F64) -> F64:
        return np.stack([np.bincount(of_vertex, values[:, k], minlength=number) for k in range(3)], axis=1)

    centres = totals(vertices) / np.maximum(counts, 1)[:, None]
    offsets = vertices - centres[of_vertex]
    covariance = np.empty((number, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            covariance[:, i, j] = covariance[:, j, i] = np.bincount(of_vertex, offsets[:, i] * offsets[:, j], minlength=number)
    values, vectors = np.linalg.eigh(covariance / np.maximum(counts, 1)[:, None, None])
    # Noise increases the area of the triangles, but in random directions, so that it cancels in the sum of the area vectors.
    cell_vectors = totals(vertex_vectors)
    areas = np.abs((cell_vectors * vectors[:, :, 0]).sum(axis=1))
    normals = vectors[:, :, 0] * np.where((cell_vectors * vectors[:, :, 0]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    is_flat = (
        (counts >= _MIN_POINTS) & (values[:, 0] <= min(limit, edge / 4.0) ** 2) & (values[:, 0] < _MAX_FLATNESS * values[:, 1])
    )
    is_flat &= areas > _MIN_AREA_FRACTION * np.linalg.norm(cell_vectors, axis=1)
    noise = float(np.median(np.sqrt(np.maximum(values[is_flat, 0], 0.0)))) if is_flat.any() else 0.0
    grid_positions = np.stack([codes // (sides[1] * sides[2]), codes // sides[2] % sides[1], codes % sides[2]], axis=1)
    # Cells that share a face, an edge or a corner.
    pairs = cKDTree(grid_positions).query_pairs(1.8, output_type="ndarray")
    return _Cells(of_vertex, centres, normals, np.where(is_flat, areas, 0.0), noise, pairs.astype(np.int64))


def _planes(cells: _Cells, limit: float) -> list[_Plane]:
    """Returns the planes of the flat cells, each with its cells, in order of decreasing area of their regions."""
    rng = np.random.default_rng(0)
    is_flat = cells.areas > 0.0
    a, b = cells.pairs.T
    is_connected = is_flat[a] & is_flat[b] & ((cells.normals[a] * cells.normals[b]).sum(axis=1) > _MIN_NORMAL_COSINE)
    centre_offsets = cells.centres[b] - cells.centres[a]
    mean_normals = (cells.normals[a] + cells.normals[b]) / 2.0
    is_connected &= np.abs((centre_offsets * mean_normals).sum(axis=1)) < limit
    pairs = cells.pairs[is_connected]
    planes: list[_Plane] = []
    queue = [
        component
        for component in _connected_components(np.flatnonzero(is_flat), pairs, len(is_flat))
        if cells.areas[component].sum() >= _MIN_AREA
    ]
    while queue and len(planes) < _MAX_PLANES:
        queue.sort(key=lambda component: float(cells.areas[component].sum()))
        component = queue.pop()
        plane = _sample_consensus_plane(cells, component, limit, rng)
        if plane is None:
            continue
        rest = np.setdiff1d(component, plane.cells)
        for component_on_plane in _connected_components(plane.cells, pairs, len(is_flat)):
            if cells.areas[component_on_plane].sum() >= _MIN_AREA and not _is_curved(cells, component_on_plane, plane, limit):
                planes.append(replace(plane, cells=component_on_plane))
        queue += [p for p in _connected_components(rest, pairs, len(is_flat)) if cells.areas[p].sum() >= _MIN_AREA]
    return planes


def _connected_components(rows: I64, pairs: I64, count: int) -> list[I64]:
    """Returns the connected components of some of ``count`` cells, joined by pairs (P, 2)."""
    if not len(rows):
        return []
    is_inside = np.zeros(count, dtype=bool)
    is_inside[rows] = True
    inner_pairs = pairs[is_inside[pairs].all(axis=1)]
    graph = sparse.coo_matrix(
        (np.ones(len(inner_pairs), dtype=bool), (inner_pairs[:, 0], inner_pairs[:, 1])), shape=(count, count)
    )
    label = csgraph.connected_components(graph, directed=False)[1][rows]
    order = np.argsort(label, kind="stable")
    return np.split(rows[order], np.flatnonzero(np.diff(label[order])) + 1)


def _sample_consensus_plane(cells: _Cells, component: I64, limit: float, rng: np.random.Generator) -> _Plane | None:
    """Returns the plane of largest area among the cells of a region, by sample consensus; None = its area is below ``_MIN_AREA``."""
    centres, normals, areas = cells.centres[component], cells.normals[component], cells.areas[component]
    seeds = rng.choice(len(component), size=min(_TRIALS, len(component)), replace=False, p=areas / areas.sum())
    best, best_area = None, 0.0
    for k in seeds:
        normal, offset = normals[k], float(normals[k] @ centres[k])
        is_inlier = np.zeros(0, dtype=bool)
        for _ in range(4):
            is_inlier = (np.abs(centres @ normal - offset) < limit) & (normals @ normal > _MIN_NORMAL_COSINE)
            if is_inlier.sum() < 4:
                break
            normal, offset = _fit_plane(centres[is_inlier], areas[is_inlier], normal)
        area = float(areas[is_inlier].sum())
        if is_inlier.sum() >= 4 and area > best_area:
            best, best_area = _Plane(normal, offset, component[is_inlier]), area
    return best if best_area >= _MIN_AREA else None


def _fit_plane(points: F64, weights: F64, towards: F64) -> tuple[F64, float]:
    """Returns unit normal (3,), on the side of ``towards``, and offset, metres, of the least-squares plane of points (N, 3) with weights (N,)."""
    centroid = np.average(points, axis=0, weights=weights)
    offsets = points - centroid
    normal = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)[1][:, 0]
    normal = normal * (1.0 if float(normal @ towards) >= 0.0 else -1.0)
    return normal, float(normal @ centroid)


def _is_curved(cells: _Cells, component: I64, plane: _Plane, limit: float) -> bool:
    """Returns whether the cells of a plane lie on a curved wall, which keeps its shape, by a quadratic fit of their distances."""
    distances = cells.centres[component] @ plane.normal - plane.offset
    u, v = (cells.centres[component] @ side for side in np.linalg.svd(plane.normal[None])[2][1:])
    u, v = u - u.mean(), v - v.mean()
    terms = np.stack([np.ones(len(u)), u, v, u * u, u * v, v * v], axis=1)
    weights = np.sqrt(cells.areas[component])
    coefficients = np.linalg.lstsq(terms * weights[:, None], distances * weights, rcond=None)[0]
    quadratic_part = terms[:, 3:] @ coefficients[3:]
    low, high = np.percentile(quadratic_part, (2.0, 98.0))
    return bool(high - low > _MAX_CURVATURE_LIMITS * limit)


def _vertices_of(cells: I64, order: I64, first: I64) -> I64:
    """Returns the vertices in some cells; ``order`` sorts the vertices by cell, ``first`` (C + 1,) is the first of each cell."""
    counts = first[cells + 1] - first[cells]
    starts = np.repeat(first[cells] - np.cumsum(counts) + counts, counts)
    return order[starts + np.arange(int(counts.sum()))]


def _refit(plane: _Plane, vertices: F64, normals: F64, order: I64, first: I64, voxel: float, limit: float) -> _Plane:
    """Returns the plane refitted to the vertices of its cells, with noise and tolerance."""
    rows = _vertices_of(plane.cells, order, first)
    rows = rows[normals[rows] @ plane.normal > _FACE_COSINE]
    normal, offset, noise = plane.normal, plane.offset, limit / _NOISE_DEVIATIONS
    for _ in range(3):
        distances = vertices[rows] @ normal - offset
        inliers = rows[np.abs(distances) <= np.clip(_NOISE_DEVIATIONS * noise, _MIN_TOLERANCE_VOXELS * voxel, limit)]
        if len(inliers) < 4:
            break
        normal, offset = _fit_plane(vertices[inliers], np.ones(len(inliers)), normal)
        noise = _DEVIATION_PER_MAD * float(np.median(np.abs(vertices[inliers] @ normal - offset)))
    tolerance = float(min(max(_NOISE_DEVIATIONS * noise, _MIN_TOLERANCE_VOXELS * voxel), limit))
    return replace(plane, normal=normal, offset=offset, noise=noise, tolerance=tolerance)


def _project_to_planes(
    vertices: F64, normals: F64, planes: list[_Plane], cells: _Cells, order: I64, first: I64, limit: float
) -> tuple[F64, Bools]:
    """Returns the projected vertices (V, 3), metres, and the mask (V,) of those on an edge or a corner."""
    moved = vertices.copy()
    assignments: list[tuple[I64, I64]] = []
    neighbours = sparse.coo_matrix(
        (np.ones(len(cells.pairs), dtype=bool), (cells.pairs[:, 0], cells.pairs[:, 1])), shape=(len(cells.centres),) * 2
    ).tocsr()
    neighbours = neighbours + neighbours.T
    nearest_distance = np.full(len(vertices), np.inf)
    for number, plane in enumerate(planes):
        is_near_cell = np.zeros(len(cells.centres), dtype=bool)
        is_near_cell[plane.cells] = True
        is_near_cell |= np.asarray(neighbours @ is_near_cell > 0)
        rows = _vertices_of(np.flatnonzero(is_near_cell), order, first)
        distances = vertices[rows] @ plane.normal - plane.offset
        cosine = normals[rows] @ plane.normal
        is_near = (np.abs(distances) < plane.tolerance) & (cosine > _EDGE_COSINE)
        rows, distances, cosine = rows[is_near], distances[is_near], cosine[is_near]
        assignments.append((rows, np.full(len(rows), number)))
        is_snapped = (cosine > _FACE_COSINE) & (np.abs(distances) < nearest_distance[rows])
        weight = np.clip(
            (plane.tolerance - np.abs(distances[is_snapped])) / ((1.0 - _FULL_SNAP_FRACTION) * plane.tolerance), 0.0, 1.0
        )
        moved[rows[is_snapped]] = vertices[rows[is_snapped]] - (weight * distances[is_snapped])[:, None] * plane.normal
        nearest_distance[rows[is_snapped]] = np.abs(distances[is_snapped])
    is_edge = np.zeros(len(vertices), dtype=bool)
    if assignments:
        _snap_to_edges(
            vertices,
            moved,
            is_edge,
            planes,
            np.concatenate([r for r, _ in assignments]),
            np.concatenate([k for _, k in assignments]),
            limit,
        )
    return moved, is_edge


def _snap_to_edges(
    vertices: F64, moved: F64, is_edge: Bools, planes: list[_Plane], rows: I64, numbers: I64, limit: float
) -> None:
    """Moves vertices that belong to two or three planes onto the common edge or corner, in ``moved``, and marks them in ``is_edge``."""
    order = np.lexsort((numbers, rows))
    rows, numbers = rows[order], numbers[order]
    counts = np.bincount(rows, minlength=len(vertices))
    start = np.cumsum(counts) - counts
    plane_normals, offsets = np.stack([p.normal for p in planes]), np.array([p.offset for p in planes])
    for count in (2, 3):
        vertex_rows = np.flatnonzero(counts == count)
        if not len(vertex_rows):
            continue
        plane_numbers = numbers[start[vertex_rows][:, None] + np.arange(count)]
        N, d = plane_normals[plane_numbers], offsets[plane_numbers]
        products = N @ N.transpose(0, 2, 1)
        is_independent = np.linalg.det(products) > _MIN_DETERMINANT
        vertex_rows, N, d, products = vertex_rows[is_independent], N[is_independent], d[is_independent], products[is_independent]
        distances = np.einsum("vij,vj->vi", N, vertices[vertex_rows]) - d
        step = np.einsum("vij,vi->vj", N, np.linalg.solve(products, distances[:, :, None])[:, :, 0])
        is_short = np.linalg.norm(step, axis=1) <= limit
        moved[vertex_rows[is_short]] = vertices[vertex_rows[is_short]] - step[is_short]
        is_edge[vertex_rows[is_short]] = True


def _undo_flips(vertices: F64, moved: F64, triangles: I64, triangle_vectors: F64, is_edge: Bools) -> F64:
    """Returns the moved vertices (V, 3), without moves that flip a triangle or collapse its area."""
    moved = moved.copy()
    doubled_areas = np.linalg.norm(triangle_vectors, axis=1)
    for round_number in range(_UNFOLD_ROUNDS):
        corners = moved[triangles]
        current = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        is_flipped = (current * triangle_vectors).sum(axis=1) <= 0.02 * doubled_areas**2
        is_flipped &= doubled_areas > 0.0
        if not is_flipped.any():
            return moved
        affected = triangles[is_flipped].reshape(-1)
        # Vertices on edges are reset first, because only they move tangentially.
        reset = affected[is_edge[affected]] if round_number < _UNFOLD_ROUNDS // 2 else affected
        reset = reset if len(reset) else affected
        moved[reset] = vertices[reset]
    corners = moved[triangles]
    current = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_flipped = ((current * triangle_vectors).sum(axis=1) <= 0.0) & (doubled_areas > 0.0)
    while is_flipped.any():
        moved[triangles[is_flipped].reshape(-1)] = vertices[triangles[is_flipped].reshape(-1)]
        corners = moved[triangles]
        current = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        is_flipped = ((current * triangle_vectors).sum(axis=1) <= 0.0) & (doubled_areas > 0.0)
    return moved
