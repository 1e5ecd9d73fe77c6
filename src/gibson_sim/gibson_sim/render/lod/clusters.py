"""Levels of detail: splits triangles into clusters, and builds coarser clusters that replace several finer ones.

The method is that of Karis, Stubbe and Wihlidal, "Nanite: A Deep Dive" (SIGGRAPH 2021 course). Neighbouring clusters form a group. The
group is simplified with the vertices that it shares with other groups locked, and the result is split into clusters again. The next level
forms other groups, so that borders locked at one level are simplified at the next. Each group has an error, and a box around everything
that it replaces. A renderer draws a cluster if the screen-space error of the group that it was built from is small enough and the error
of the group that replaces it is not. Errors and boxes never shrink from one level to the next, so all clusters of a group pass or fail
together and no cracks open. Simplification uses meshoptimizer. No OpenGL.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_log = logging.getLogger(__name__)
GROUP = 4
"""Approximate number of full clusters in a group."""
SLIDE_WEIGHT = 0.5
"""Weight of texture sliding along the surface against displacement of the surface, m/m."""
FIRST_ERROR = 0.02
"""Error limit of the first simplified level, as a multiple of the median edge length."""
ERROR_STEP = 1.7
"""Ratio of the error limits of successive levels."""
REDUCTION = 0.85
"""Largest ratio of the number of triangles after simplification to that before; a group above it keeps its triangles."""
NORMAL_WEIGHT_M = 0.2
"""Weight of rotation of normals against displacement of the surface, m/rad. It determines the order of edge collapses: with far smaller
weights, the normals of a rounded edge spread over the flat side beside it."""
COLOR_WEIGHT_M = 0.1
"""Weight of a change of vertex colour from black to white against displacement of the surface, m."""
SMALLEST = 64
"""Minimum number of triangles of a mesh that is simplified: smaller meshes gain nothing."""
COARSEST = 16
"""Number of triangles at which simplification ends."""

_SPARSE, _ERROR_ABSOLUTE = 2, 4
_LEAST_ERROR = 1e-9
"""Minimum error of a group, metres."""
_GROUPING_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Clusters of all levels, finest first. A group consists of the clusters that were simplified together; it has one error and one box."""

    triangles: I64
    """(F, 3), rows in the input vertices, sorted by cluster."""
    ends: I64
    """(C,), end of each cluster in ``triangles``, exclusive."""
    level: I64
    """(C,), level of detail; 0 = the input triangles."""
    group: I64
    """(C,), group whose simplification produced the cluster; -1 for the finest clusters, which have no error."""
    next_group: I64
    """(C,), group whose simplification replaces the cluster; -1 = none."""
    group_error: F64
    """(G,), distance from the input triangles, metres; never less than the errors of the groups that it was built from."""
    group_box: F64
    """(G, 6), minimum and maximum corner, metres, of everything that the group replaces."""

    @property
    def starts(self) -> I64:
        """(C,), row of the first triangle of each cluster."""
        return np.concatenate([[0], self.ends[:-1]])


Simplify = Callable[..., int]


def simplifier() -> Simplify | None:
    """Returns meshoptimizer's ``meshopt_simplifyWithAttributes``, or None if it is not installed; without it there are no levels of detail."""
    try:
        from meshoptimizer.simplifier import lib
    except ImportError:
        return None
    # The package's wrapper declares no argument types: sizes beyond the sixth argument would have garbage in their upper half.
    size, real, pointer = ctypes.c_size_t, ctypes.c_float, ctypes.c_void_p
    function: Simplify = ctypes.CFUNCTYPE(
        size,
        *(pointer, pointer, size, pointer, size, size, pointer, size, pointer, size, pointer, size, real, ctypes.c_uint, pointer),
    )(("meshopt_simplifyWithAttributes", lib))
    return function


def build_clusters(
    positions: F32,
    normals: F32,
    uvs: F32,
    triangles: I64,
    size: int,
    fixed: NDArray[np.bool_] | None = None,
    levels_of_detail: bool = True,
    colors: F32 | None = None,
    light_uvs: F32 | None = None,
) -> Clusters:
    """Returns clusters of at most ``size`` triangles.

    Args:
        positions: (V, 3), metres.
        normals: (V, 3).
        uvs: (V, 2), in units of the texture's size.
        triangles: (F, 3), rows in the vertices.
        size: maximum number of triangles in a cluster.
        fixed: (V,), mask of vertices that are always locked; None = none.
        levels_of_detail: build coarser levels too.
        colors: (V, 3), linear, 0 to 1; None = the vertices have no colours.
        light_uvs: (V, 2), in units of the light map's size; None = the vertices have no light map.
    """
    order, ends = split(positions[triangles].mean(axis=1, dtype=np.float64), size)
    out = _ClusterList()
    out.add(np.split(triangles[order], ends[:-1]), _boxes(positions, triangles[order], ends), -1, 0.0, 0)
    simplify = simplifier() if levels_of_detail and len(triangles) >= SMALLEST else None
    if simplify is not None:
        _LevelBuilder(
            simplify, positions, normals, (uvs,) if light_uvs is None else (uvs, light_uvs), triangles, size, fixed, colors
        ).build(out)
    return out.clusters()


@dataclass(slots=True)
class _ClusterList:
    """Clusters and groups under construction."""

    triangles: list[I64] = field(default_factory=list)
    box: list[F64] = field(default_factory=list)
    group: list[int] = field(default_factory=list)
    next_group: list[int] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    level: list[int] = field(default_factory=list)
    group_error: list[float] = field(default_factory=list)
    group_box: list[F64] = field(default_factory=list)

    def add(self, clusters: Sequence[I64], boxes: Sequence[F64] | F64, group: int, error: float, level: int) -> range:
        """Adds clusters, each (F, 3), produced by one group, and returns their numbers."""
        first = len(self.triangles)
        self.triangles += clusters
        self.box += list(boxes)
        self.group += [group] * len(clusters)
        self.next_group += [-1] * len(clusters)
        self.error += [error] * len(clusters)
        self.level += [level] * len(clusters)
        return range(first, len(self.triangles))

    def clusters(self) -> Clusters:
        return Clusters(
            triangles=np.concatenate(self.triangles),
            ends=np.cumsum([len(t) for t in self.triangles]),
            level=np.array(self.level),
            group=np.array(self.group),
            next_group=np.array(self.next_group),
            group_error=np.array(self.group_error, dtype=np.float64),
            group_box=np.array(self.group_box, dtype=np.float64).reshape(-1, 6),
        )


class _LevelBuilder:
    """Builds the coarser levels of one mesh."""

    def __init__(
        self,
        simplify: Simplify,
        positions: F32,
        normals: F32,
        uv_sets: tuple[F32, ...],
        triangles: I64,
        size: int,
        fixed: NDArray[np.bool_] | None,
        colors: F32 | None,
    ) -> None:
        self._function = simplify
        self._size = size
        self._positions = np.ascontiguousarray(positions, dtype=np.float32)
        tints = () if colors is None else (colors,)
        self._attributes = np.ascontiguousarray(np.hstack([normals, *uv_sets, *tints]), dtype=np.float32)
        # Attribute errors have the unit of positions: the error of uvs is the distance that the texture slides over the surface.
        slides = [SLIDE_WEIGHT * _metres_per_uv(positions, uvs, triangles) for uvs in uv_sets]
        self._weights = np.array(
            [NORMAL_WEIGHT_M] * 3 + [slide for slide in slides for _ in "uv"] + [COLOR_WEIGHT_M] * 3 * len(tints),
            dtype=np.float32,
        )
        # Vertices at the same position with different attributes move together.
        self._welded = weld(self._positions)
        self._fixed = np.zeros(int(self._welded.max()) + 1, dtype=bool)
        if fixed is not None:
            self._fixed[self._welded[fixed]] = True

    def build(self, out: _ClusterList) -> None:
        """Adds coarser clusters until few triangles are left, or the error is as large as the mesh.

        The error limit grows by a constant factor from level to level. A group that cannot be simplified within it is kept and tried
        again at the next level: flat surfaces need few triangles long before round ones.
        """
        current = np.arange(len(out.triangles))
        size = float(np.ptp(self._positions, axis=0).max())
        # Where most triangles are degenerate, the median is 0.
        error_limit = max(FIRST_ERROR * _median_edge(self._positions, np.concatenate(out.triangles)), 1e-6 * size)
        level = 1
        while sum(len(out.triangles[c]) for c in current) > COARSEST and error_limit < size:
            coarser = self._next_level(out, current, error_limit, level)
            # After a level with almost no change the limit grows faster.
            error_limit *= ERROR_STEP if len(coarser) < 0.98 * len(current) else ERROR_STEP**2
            current = coarser
            level += 1

    def _next_level(self, out: _ClusterList, current: I64, error_limit: float, level: int) -> I64:
        """Adds the clusters of the next level; returns the numbers of the clusters that represent all triangles at ``error_limit`` metres."""
        triangles = np.concatenate([out.triangles[c] for c in current])
        sizes = np.array([len(out.triangles[c]) for c in current])
        clusters = np.repeat(np.arange(len(current)), sizes)
        centres = _means(self._positions[triangles].mean(axis=1, dtype=np.float64), np.cumsum(sizes))
        group_of = self._groups(triangles, clusters, centres, sizes)
        lock = self._locks(triangles, group_of[clusters])
        order = np.argsort(group_of, kind="stable")
        coarser: list[int] = []
        for rows in np.split(order, np.cumsum(np.bincount(group_of))[:-1]):
            members = current[rows].tolist()
            merged = np.concatenate([out.triangles[c] for c in members])
            simplified, error = self._simplify(merged, lock, error_limit)
            if len(simplified) > REDUCTION * len(merged):
                coarser += members
                continue
            error = max(error, *(out.error[c] for c in members), _LEAST_ERROR)
            boxes = np.array([out.box[c] for c in members])
            box = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
            number = len(out.group_error)
            out.group_error.append(error)
            out.group_box.append(box)
            for c in members:
                out.next_group[c] = number
            if len(simplified):
                sequence, ends = split(self._positions[simplified].mean(axis=1, dtype=np.float64), self._size)
                new_clusters = np.split(simplified[sequence], ends[:-1])
                coarser += out.add(new_clusters, [box] * len(new_clusters), number, error, level)
        return np.array(coarser, dtype=np.int64)

    def _groups(self, triangles: I64, clusters: I64, centres: F64, sizes: I64) -> I64:
        """Returns the group of each cluster, (C,): clusters that share the most vertices are grouped.

        The locked border of an earlier group is denser than the rest, so it has the largest weight and ends up inside the next group.
        """
        count = len(centres)
        pairs = np.unique(np.repeat(clusters, 3) + self._welded[triangles].ravel() * count)
        vertices, members = pairs // count, pairs % count
        edges = []
        for step in (1, 2, 3):
            same = vertices[step:] == vertices[:-step]
            edges.append(members[:-step][same] * count + members[step:][same])
        codes, weights = np.unique(np.concatenate(edges), return_counts=True)
        rank = np.empty(count, dtype=np.int64)
        rank[np.argsort(morton(centres), kind="stable")] = np.arange(count)
        group_of = np.arange(count)
        for _ in range(_GROUPING_ROUNDS):
            open_ = np.bincount(group_of, weights=sizes) < GROUP * self._size / 2
            if open_.sum() < 2:
                break
            group_of = _join_pairs(group_of, codes // count, codes % count, weights, rank, open_)
        return group_of

    def _locks(self, triangles: I64, groups: I64) -> NDArray[np.uint8]:
        """Returns 1 for every vertex, (V,), that is fixed or whose position is shared by several groups, else 0."""
        welded = self._welded[triangles].ravel()
        group = np.repeat(groups, 3)
        lowest = np.full(len(self._fixed), np.iinfo(np.int64).max)
        highest = np.full(len(self._fixed), -1)
        np.minimum.at(lowest, welded, group)
        np.maximum.at(highest, welded, group)
        locked: NDArray[np.bool_] = ((lowest < highest) & (highest >= 0)) | self._fixed
        return np.ascontiguousarray(locked[self._welded], dtype=np.uint8)

    def _simplify(self, triangles: I64, lock: NDArray[np.uint8], error_limit: float) -> tuple[I64, float]:
        """Returns as few triangles as an error of ``error_limit`` metres permits, and their error."""
        indices = np.ascontiguousarray(triangles.ravel(), dtype=np.uint32)
        out = np.empty_like(indices)
        error = ctypes.c_float(0.0)
        positions, attributes = self._positions, self._attributes
        # The simplifier scales its input to size 1, and expects weights in that unit.
        weights = self._weights / np.float32(max(float(np.ptp(positions[indices], axis=0).max()), 1e-9))
        count = self._function(
            out.ctypes.data, indices.ctypes.data, len(indices), positions.ctypes.data, len(positions), positions.strides[0],
            attributes.ctypes.data, attributes.strides[0], weights.ctypes.data, len(weights), lock.ctypes.data,
            0, error_limit, _SPARSE | _ERROR_ABSOLUTE, ctypes.addressof(error),
        )  # fmt: skip
        return out[:count].reshape(-1, 3).astype(np.int64), error.value


def _join_pairs(group_of: I64, a: I64, b: I64, weights: I64, rank: I64, open_: NDArray[np.bool_]) -> I64:
    """Joins open groups in pairs: first along the heaviest edges (a, b) between two of them, then the rest in the order of ``rank``."""
    first, second = np.minimum(group_of[a], group_of[b]), np.maximum(group_of[a], group_of[b])
    count = int(group_of.max()) + 1
    apart = (first < second) & open_[first] & open_[second]
    codes, inverse = np.unique(first[apart] * count + second[apart], return_inverse=True)
    sums = np.bincount(inverse, weights=weights[apart]).astype(np.int64)
    partner = np.full(count, -1)
    for code in codes[np.argsort(-sums, kind="stable")].tolist():
        one, other = divmod(code, count)
        if partner[one] < 0 and partner[other] < 0:
            partner[one], partner[other] = other, one
    place = np.full(count, np.iinfo(np.int64).max)
    np.minimum.at(place, group_of, rank)
    alone = np.flatnonzero((partner < 0) & open_)
    alone = alone[np.argsort(place[alone], kind="stable")]
    for one, other in zip(alone[0::2].tolist(), alone[1::2].tolist(), strict=False):
        partner[one], partner[other] = other, one
    joined = np.minimum(np.arange(count), np.where(partner < 0, np.arange(count), partner))
    result: I64 = np.unique(joined, return_inverse=True)[1][group_of]
    return result


def _median_edge(positions: F32, triangles: I64) -> float:
    """Returns the median length of the edges, metres."""
    a, b = positions[triangles[:, 0]].astype(np.float64), positions[triangles[:, 1]].astype(np.float64)
    return float(np.median(np.linalg.norm(b - a, axis=1)))


def _metres_per_uv(positions: F32, uvs: F32, triangles: I64) -> float:
    """Returns the mean size of the texture on the surface, metres per unit of uv, weighted by area."""
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    p, q, r = (uvs[triangles[:, k]].astype(np.float64) for k in range(3))
    u, v = q - p, r - p
    area_uv = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    return float(np.sqrt(area / area_uv)) if area_uv > 1e-12 * max(area, 1e-12) else 0.0


def _means(values: F64, ends: I64) -> F64:
    """Returns the mean of each range of rows; ``ends`` are the ends of the ranges."""
    starts = np.concatenate([[0], ends[:-1]])
    means: F64 = np.add.reduceat(values, starts, axis=0) / (ends - starts)[:, None]
    return means


def _boxes(positions: F32, triangles: I64, ends: I64) -> F64:
    """Returns the bounding box (minimum, maximum corner) of the triangles of each cluster, (C, 6)."""
    starts = np.concatenate([[0], ends[:-1]])
    corners = positions[triangles].astype(np.float64)
    low = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
    return np.hstack([low, np.maximum.reduceat(corners.max(axis=1), starts, axis=0)])


def weld(positions: F32) -> I64:
    """Returns the number, 0, 1, 2, ..., of each vertex's position, (V,): vertices at the same position have the same number."""
    bits = np.ascontiguousarray(positions + np.float32(0.0)).view(np.uint32).astype(np.uint64)  # + 0 turns -0 into 0
    # Positions whose hashes collide, which is all but impossible, would move together, which is harmless.
    key = (
        bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        ^ bits[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ bits[:, 2] * np.uint64(0x165667B19E3779F9)
    )
    numbers: I64 = np.unique(key ^ (key >> np.uint64(29)), return_inverse=True)[1].astype(np.int64)
    return numbers


def split(points: F64, size: int) -> tuple[I64, I64]:
    """Splits points, (N, 3), into neighbourhoods of at most ``size``, recursively along the longest side.

    Returns:
        The order of the points, (N,), and the end of each neighbourhood in it, (C,).
    """
    leaves = list(_leaves(points, np.argsort(morton(points), kind="stable"), size))
    return np.concatenate(leaves), np.cumsum([len(leaf) for leaf in leaves])


def _leaves(points: F64, rows: I64, size: int) -> Iterator[I64]:
    stack = [rows]
    while stack:
        rows = stack.pop()
        if len(rows) <= size:
            yield rows
            continue
        subset = points[rows]
        axis = int(np.argmax(np.ptp(subset, axis=0)))
        # The lower side gets full neighbourhoods; a stable sort keeps the order of equal coordinates.
        full = (len(rows) + size - 1) // size
        lower = size * (full // 2)
        by_axis = np.argsort(subset[:, axis], kind="stable")
        upper = np.zeros(len(rows), dtype=bool)
        upper[by_axis[lower:]] = True
        stack += [rows[upper], rows[~upper]]


def morton(points: F64) -> I64:
    """Returns Morton codes, (N,), of points, (N, 3): their order along a Z-order curve."""
    low = points.min(axis=0)
    size = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cells = ((points - low) / size * 1023.0).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
