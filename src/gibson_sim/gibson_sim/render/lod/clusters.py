"""Levels of detail: cuts triangles into clusters, and makes coarser clusters that can replace several finer ones.

The scheme is that of Karis, Stubbe and Wihlidal, "Nanite: A Deep Dive" (SIGGRAPH 2021 course): neighbouring clusters form a group; the
group is simplified while the vertices that it shares with other groups are locked; the result is cut into clusters again, and
so on with other groups, so that borders that were locked at one level vanish at the next. Each group has an error, and a box around all
that it replaces. A renderer draws a cluster if the error of the group that made it is small enough on the image and that of the group
that replaces it is not. Neighbours pass or fail together, so no cracks open: an error never is less, nor its box smaller, than those of
the groups it was made from. The simplifier is meshoptimizer's. No OpenGL here.
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
"""Full clusters in a group, about."""
SLIDE_WEIGHT = 0.5
"""Weight of texture sliding along the surface against displacement of the surface, m/m."""
FIRST_ERROR = 0.02
"""Error of the first coarser level, in median lengths of an edge."""
ERROR_STEP = 1.7
"""Ratio of the errors that successive levels may reach."""
REDUCTION = 0.85
"""Largest ratio of triangles after simplification to those before: a group that stays above it keeps its triangles."""
NORMAL_WEIGHT_M = 0.2
"""Weight of rotation of normals against displacement of the surface, m/rad: it decides which edges collapse first. With far less, the
normals of a round edge spread over the flat side beside it."""
COLOR_WEIGHT_M = 0.1
"""Weight of a change of vertex colour from black to white against displacement of the surface, m."""
SMALLEST = 64
"""Least number of triangles of a mesh with coarser levels: fewer gain nothing."""
COARSEST = 16
"""Triangles at which simplification ends."""

_SPARSE, _ERROR_ABSOLUTE = 2, 4
_LEAST_ERROR = 1e-9
"""Metres."""
_GROUPING_ROUNDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Clusters of all levels, the finest first. A group is the clusters that were simplified together: it has one error and one box."""

    triangles: I64
    """(F, 3), rows of the given vertices; cluster by cluster."""
    ends: I64
    """(C,), row of ``triangles`` after the last one of each cluster."""
    level: I64
    """(C,), 0 = the given triangles."""
    group: I64
    """(C,), the group whose simplification made this cluster; -1 for the finest, which have no error."""
    next_group: I64
    """(C,), the group whose simplification replaces this cluster; -1 = none."""
    group_error: F64
    """(G,), metres from the given triangles; never less than the errors of the groups it was made from."""
    group_box: F64
    """(G, 6), smallest and largest corner, metres, of what that error applies to."""

    @property
    def starts(self) -> I64:
        """(C,), row of the first triangle of each cluster."""
        return np.concatenate([[0], self.ends[:-1]])


Simplify = Callable[..., int]


def simplifier() -> Simplify | None:
    """Returns meshoptimizer's ``meshopt_simplifyWithAttributes``, or None if it is not installed; then there are no coarser levels."""
    try:
        from meshoptimizer.simplifier import lib
    except ImportError:
        return None
    # The package's own wrapper declares no types: sizes beyond the sixth argument would have garbage in their upper half.
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
    coarser: bool = True,
    colors: F32 | None = None,
) -> Clusters:
    """Returns clusters of at most ``size`` triangles.

    Args:
        positions: (V, 3), metres.
        normals: (V, 3).
        uvs: (V, 2), in units of the texture's size.
        triangles: (F, 3), rows of the vertices.
        size: most triangles in a cluster.
        fixed: (V,), vertices that are always locked; None = none.
        coarser: make coarser levels too.
        colors: (V, 3), linear, 0 to 1; None = the vertices have none.
    """
    order, ends = split(positions[triangles].mean(axis=1, dtype=np.float64), size)
    made = _ClusterList()
    made.add(np.split(triangles[order], ends[:-1]), _boxes(positions, triangles[order], ends), -1, 0.0, 0)
    simplify = simplifier() if coarser and len(triangles) >= SMALLEST else None
    if simplify is not None:
        _Coarsener(simplify, positions, normals, uvs, triangles, size, fixed, colors).coarsen(made)
    return made.clusters()


@dataclass(slots=True)
class _ClusterList:
    """Clusters and groups while they are made."""

    triangles: list[I64] = field(default_factory=list)
    box: list[F64] = field(default_factory=list)
    group: list[int] = field(default_factory=list)
    next_group: list[int] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    level: list[int] = field(default_factory=list)
    group_error: list[float] = field(default_factory=list)
    group_box: list[F64] = field(default_factory=list)

    def add(self, clusters: Sequence[I64], boxes: Sequence[F64] | F64, group: int, error: float, level: int) -> range:
        """Adds clusters of one group, each (F, 3), and returns their numbers."""
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


class _Coarsener:
    """Makes the coarser levels of one mesh."""

    def __init__(
        self,
        simplify: Simplify,
        positions: F32,
        normals: F32,
        uvs: F32,
        triangles: I64,
        size: int,
        fixed: NDArray[np.bool_] | None,
        colors: F32 | None,
    ) -> None:
        self._function = simplify
        self._size = size
        self._positions = np.ascontiguousarray(positions, dtype=np.float32)
        tints = () if colors is None else (colors,)
        self._attributes = np.ascontiguousarray(np.hstack([normals, uvs, *tints]), dtype=np.float32)
        # Errors of attributes are in the unit of positions: those of uvs are the distance that the texture slides over the surface.
        self._weights = np.array(
            [NORMAL_WEIGHT_M] * 3
            + [SLIDE_WEIGHT * _metres_per_uv(positions, uvs, triangles)] * 2
            + [COLOR_WEIGHT_M] * 3 * len(tints),
            dtype=np.float32,
        )
        # Vertices at one position that differ in their attributes move together.
        self._welded = weld(self._positions)
        self._fixed = np.zeros(int(self._welded.max()) + 1, dtype=bool)
        if fixed is not None:
            self._fixed[self._welded[fixed]] = True

    def coarsen(self, made: _ClusterList) -> None:
        """Makes coarser clusters until few triangles are left, or the error is as large as the mesh.

        Each level may reach an error that is larger by a constant factor than that of the level before. A group that cannot become
        coarser within it stays, and is tried again at the next level: flat things get few triangles long before round ones.
        """
        now = np.arange(len(made.triangles))
        size = float(np.ptp(self._positions, axis=0).max())
        # Where most triangles have no area, the median is 0.
        allowed = max(FIRST_ERROR * _median_edge(self._positions, np.concatenate(made.triangles)), 1e-6 * size)
        level = 1
        while sum(len(made.triangles[c]) for c in now) > COARSEST and allowed < size:
            after = self._coarser(made, now, allowed, level)
            # A level that changed almost nothing lets the next one go farther.
            allowed *= ERROR_STEP if len(after) < 0.98 * len(now) else ERROR_STEP**2
            now = after
            level += 1

    def _coarser(self, made: _ClusterList, now: I64, allowed: float, level: int) -> I64:
        """Returns the numbers of the clusters that represent all triangles when errors up to ``allowed`` metres are accepted."""
        triangles = np.concatenate([made.triangles[c] for c in now])
        sizes = np.array([len(made.triangles[c]) for c in now])
        clusters = np.repeat(np.arange(len(now)), sizes)
        centres = _means(self._positions[triangles].mean(axis=1, dtype=np.float64), np.cumsum(sizes))
        group_of = self._groups(triangles, clusters, centres, sizes)
        lock = self._locks(triangles, group_of[clusters])
        order = np.argsort(group_of, kind="stable")
        after: list[int] = []
        for rows in np.split(order, np.cumsum(np.bincount(group_of))[:-1]):
            members = now[rows].tolist()
            merged = np.concatenate([made.triangles[c] for c in members])
            simple, error = self._simplify(merged, lock, allowed)
            if len(simple) > REDUCTION * len(merged):
                after += members
                continue
            error = max(error, *(made.error[c] for c in members), _LEAST_ERROR)
            boxes = np.array([made.box[c] for c in members])
            box = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
            number = len(made.group_error)
            made.group_error.append(error)
            made.group_box.append(box)
            for c in members:
                made.next_group[c] = number
            if len(simple):
                inside, ends = split(self._positions[simple].mean(axis=1, dtype=np.float64), self._size)
                clusters_of = np.split(simple[inside], ends[:-1])
                after += made.add(clusters_of, [box] * len(clusters_of), number, error, level)
        return np.array(after, dtype=np.int64)

    def _groups(self, triangles: I64, clusters: I64, centres: F64, sizes: I64) -> I64:
        """Returns the group of each cluster, (C,): clusters that share most vertices are grouped.

        The locked border of an earlier group is denser than the rest, so it weighs most and ends up inside the next group.
        """
        count = len(centres)
        pairs = np.unique(np.repeat(clusters, 3) + self._welded[triangles].ravel() * count)
        vertices, members = pairs // count, pairs % count
        edges = []
        for step in (1, 2, 3):
            same = vertices[step:] == vertices[:-step]
            edges.append(members[:-step][same] * count + members[step:][same])
        codes, weights = np.unique(np.concatenate(edges), return_counts=True)
        along = np.empty(count, dtype=np.int64)
        along[np.argsort(morton(centres), kind="stable")] = np.arange(count)
        group_of = np.arange(count)
        for _ in range(_GROUPING_ROUNDS):
            open_ = np.bincount(group_of, weights=sizes) < GROUP * self._size / 2
            if open_.sum() < 2:
                break
            group_of = _matched(group_of, codes // count, codes % count, weights, along, open_)
        return group_of

    def _locks(self, triangles: I64, groups: I64) -> NDArray[np.uint8]:
        """Returns 1 for every vertex, (V,), that is fixed or whose position several groups share."""
        welded = self._welded[triangles].ravel()
        group = np.repeat(groups, 3)
        lowest = np.full(len(self._fixed), np.iinfo(np.int64).max)
        highest = np.full(len(self._fixed), -1)
        np.minimum.at(lowest, welded, group)
        np.maximum.at(highest, welded, group)
        locked: NDArray[np.bool_] = ((lowest < highest) & (highest >= 0)) | self._fixed
        return np.ascontiguousarray(locked[self._welded], dtype=np.uint8)

    def _simplify(self, triangles: I64, lock: NDArray[np.uint8], allowed: float) -> tuple[I64, float]:
        """Returns as few triangles as an error of ``allowed`` metres permits, and the error."""
        indices = np.ascontiguousarray(triangles.ravel(), dtype=np.uint32)
        out = np.empty_like(indices)
        error = ctypes.c_float(0.0)
        positions, attributes = self._positions, self._attributes
        # The simplifier scales its input to size 1, and expects weights in that unit.
        weights = self._weights / np.float32(max(float(np.ptp(positions[indices], axis=0).max()), 1e-9))
        count = self._function(
            out.ctypes.data, indices.ctypes.data, len(indices), positions.ctypes.data, len(positions), positions.strides[0],
            attributes.ctypes.data, attributes.strides[0], weights.ctypes.data, len(weights), lock.ctypes.data,
            0, allowed, _SPARSE | _ERROR_ABSOLUTE, ctypes.addressof(error),
        )  # fmt: skip
        return out[:count].reshape(-1, 3).astype(np.int64), error.value


def _matched(group_of: I64, a: I64, b: I64, weights: I64, along: I64, open_: NDArray[np.bool_]) -> I64:
    """Returns open groups joined in pairs: along the heaviest edges (a, b) between two of them first, the rest in the order ``along``."""
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
    np.minimum.at(place, group_of, along)
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
    """Returns the mean size of the texture on the surface, metres for each unit of uv, weighted by area."""
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    p, q, r = (uvs[triangles[:, k]].astype(np.float64) for k in range(3))
    u, v = q - p, r - p
    area_uv = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    return float(np.sqrt(area / area_uv)) if area_uv > 1e-12 * max(area, 1e-12) else 0.0


def _means(values: F64, ends: I64) -> F64:
    """Returns the mean of each range of rows, given by their ends."""
    starts = np.concatenate([[0], ends[:-1]])
    means: F64 = np.add.reduceat(values, starts, axis=0) / (ends - starts)[:, None]
    return means


def _boxes(positions: F32, triangles: I64, ends: I64) -> F64:
    """Returns the bounding box (smallest, largest corner) of the triangles of each cluster, (C, 6)."""
    starts = np.concatenate([[0], ends[:-1]])
    corners = positions[triangles].astype(np.float64)
    low = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
    return np.hstack([low, np.maximum.reduceat(corners.max(axis=1), starts, axis=0)])


def weld(positions: F32) -> I64:
    """Returns a number for each vertex, (V,), the same for all vertices at one position: 0, 1, 2, ..."""
    bits = np.ascontiguousarray(positions + np.float32(0.0)).view(np.uint32).astype(np.uint64)  # + 0 makes -0 to 0
    # Two positions with the same hash, all but impossible, would move together, which does no harm.
    key = (
        bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        ^ bits[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ bits[:, 2] * np.uint64(0x165667B19E3779F9)
    )
    numbers: I64 = np.unique(key ^ (key >> np.uint64(29)), return_inverse=True)[1].astype(np.int64)
    return numbers


def split(points: F64, size: int) -> tuple[I64, I64]:
    """Cuts points into neighbourhoods of at most ``size``, along the longest side first.

    Returns:
        The order of the points, (N,), and where each neighbourhood ends in it, (C,).
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
        here = points[rows]
        axis = int(np.argmax(np.ptp(here, axis=0)))
        # The lower side gets whole neighbourhoods; a stable sort keeps the order of equal coordinates.
        wholes = (len(rows) + size - 1) // size
        lower = size * (wholes // 2)
        by_axis = np.argsort(here[:, axis], kind="stable")
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
