"""Occlusion culling: the occluders and subclusters of a scene, and the test of boxes against a depth image. No OpenGL.

The test is a hierarchical z-buffer (Greene, Kass and Miller 1993). It is conservative: drawing a box reported as hidden would not change a
pixel. It pays off where triangles are expensive, as in software rendering; on a GPU, waiting for the depth image takes longer than drawing the
hidden triangles. Occluders are large triangles of opaque clusters, such as walls and floors, which hide most of a building from inside. Clusters
are split into subclusters with their own boxes, for finer culling. A box is computed when its cluster is first drawn: most clusters of a large
scene are never drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling.occlusion_culling import DEPTH_MARGIN, TILE_PX, SubclusterTable

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
LARGE_M2 = 0.1
"""Minimum area of an occluder, square metres."""
SUBCLUSTER_TRIANGLES = 32
"""Maximum number of triangles in a subcluster; they are neighbours."""


class DepthPyramid:
    """Minima of ``near / depth`` over tiles of an image, at increasing tile sizes: bounds of the largest depth in each tile.

    Args:
        depth: (H, W) float32, ``near / depth``, 0 = nothing.
    """

    def __init__(self, depth: F32) -> None:
        self.height, self.width = depth.shape
        levels = [_least_of_tiles(depth, TILE_PX)]
        while levels[-1].size > 1:
            levels.append(_least_of_tiles(levels[-1], 2))
        self._widths = np.array([level.shape[1] for level in levels])
        self._firsts = np.cumsum([0, *(level.size for level in levels[:-1])])
        self._values = np.concatenate([level.ravel() for level in levels])

    def least(self, x0: I64, y0: I64, x1: I64, y1: I64) -> F32:
        """Returns lower bounds, (N,), of the values in rectangles with inclusive ends inside the image."""
        x0, y0, x1, y1 = x0 // TILE_PX, y0 // TILE_PX, x1 // TILE_PX, y1 // TILE_PX
        # The level at which a rectangle touches at most two tiles per side.
        level = np.frexp(np.maximum(np.maximum(x1 - x0, y1 - y0) - 1, 0))[1]
        np.minimum(level, len(self._widths) - 1, out=level)
        first, width = self._firsts[level], self._widths[level]
        top, bottom = first + (y0 >> level) * width, first + (y1 >> level) * width
        left, right = x0 >> level, x1 >> level
        v = self._values
        least: F32 = np.minimum(np.minimum(v[top + left], v[top + right]), np.minimum(v[bottom + left], v[bottom + right]))
        return least


def _least_of_tiles(values: F32, side: int) -> F32:
    """Returns the minimum of each tile; tiles at the right and bottom edges may be cropped."""
    missing = -np.array(values.shape) % side
    if missing.any():
        values = np.pad(values, ((0, missing[0]), (0, missing[1])), mode="edge")
    rows = values[0::side]
    for k in range(1, side):
        rows = np.minimum(rows, values[k::side])
    least = rows[:, 0::side]
    for k in range(1, side):
        least = np.minimum(least, rows[:, k::side])
    return least


def pixels_from_links(T_camera_links: F64, intrinsics: F64) -> F64:
    """Returns the projection matrices, (L, 3, 4), from points in each link to (u z, v z, z), pixels and metres.

    Args:
        T_camera_links: (L, 4, 4): optical frame from the frame of each link.
        intrinsics: K, (3, 3), pixels.
    """
    pixels: F64 = np.vstack([np.asarray(intrinsics, dtype=np.float64)[:2], [0.0, 0.0, 1.0]]) @ T_camera_links[:, :3]
    return pixels


class ScreenBounds:
    """Screen-space bounds of boxes, computed while the depth image is not yet available.

    Args:
        boxes: (N, 6), centre and half extents, metres.
        pixels_from_box: (N, 3, 4), projection matrix of each box, see ``pixels_from_links``.
        size: width and height of the picture, pixels.
        near: depth of the near plane, metres.
    """

    def __init__(self, boxes: F64, pixels_from_box: F64, size: tuple[int, int], near: float) -> None:
        matrices = pixels_from_box[:, :, :3]
        centre = np.matmul(matrices, boxes[:, :3, None])[:, :, 0] + pixels_from_box[:, :, 3]
        half = np.ascontiguousarray((matrices * boxes[:, None, 3:]).transpose(1, 2, 0))
        # (3, 8, N): NumPy is fastest along the axis of the boxes, the longest one.
        corners = np.matmul(_CORNERS, half)
        corners += centre.T[:, None]
        nearest = corners[2].min(axis=0)
        self._ahead = nearest > near
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = corners[:2] / corners[2]
        # A box that is not entirely beyond the near plane is never hidden.
        low = np.floor(np.where(self._ahead, uv.min(axis=1), 0.0))
        high = np.ceil(np.where(self._ahead, uv.max(axis=1), 0.0))
        end = np.array([[size[0]], [size[1]]])
        self._outside = ((high < 0) | (low >= end)).any(axis=0)
        self._first, self._last = (np.clip(ends, 0, end - 1).astype(np.int64) for ends in (low, high))
        self._reversed_depth = near / np.maximum(nearest, near)

    def hidden(self, pyramid: DepthPyramid) -> NDArray[np.bool_]:
        """Returns a mask, (N,), of the boxes hidden behind the depth image of the picture."""
        deeper = self._reversed_depth < pyramid.least(*self._first, *self._last) * (1.0 - DEPTH_MARGIN)
        covered: NDArray[np.bool_] = self._ahead & (self._outside | deeper)
        return covered


class Occluders:
    """Large triangles of opaque clusters, in a separate index array."""

    def __init__(self) -> None:
        self.indices: NDArray[np.uint32] = np.zeros(0, dtype=np.uint32)
        """(3 T,), rows in ``SceneGeometry.vertices``."""
        self.first: I64 = np.zeros(0, dtype=np.int64)
        """(C,), offset in ``indices`` of the first occluder of each cluster."""
        self.count: I64 = np.zeros(0, dtype=np.int64)
        """(C,), number of indices; 0 = none."""
        # Searched index ranges, ascending: their starts and ends, and the starts and ends of their occluders in ``indices``.
        self._starts = self._ends = self._large = self._large_ends = np.zeros(0, dtype=np.int64)

    def update(self, b: SceneGeometry, same_indices: int) -> None:
        """Finds the occluders of a geometry.

        Args:
            b: the geometry.
            same_indices: number of its leading indices that are unchanged since the last call.
        """
        old = self._ends <= same_indices
        self._starts, self._ends = self._starts[old], self._ends[old]
        self._large, self._large_ends = self._large[old], self._large_ends[old]
        self.indices = self.indices[: int(self._large_ends[-1]) if len(self._large_ends) else 0]
        starts, cluster, range_of = np.unique(b.cluster_first.astype(np.int64), return_index=True, return_inverse=True)
        new = starts >= (int(self._ends[-1]) if len(self._ends) else 0)
        self._search(b, starts[new], b.cluster_count[cluster[new]].astype(np.int64))
        opaque = np.zeros(len(b.cluster_first), dtype=bool)
        for batch in b.batches:
            opaque[batch.first_cluster : batch.end_cluster] = batch.alpha_mode == "opaque"
        row = np.searchsorted(self._starts, starts)[range_of]
        self.first = self._large[row]
        self.count = np.where(opaque, self._large_ends[row] - self._large[row], 0)

    def _search(self, b: SceneGeometry, starts: I64, counts: I64) -> None:
        """Appends the large triangles of index ranges given in ascending order."""
        if not len(starts):
            return
        ends = np.cumsum(counts)
        every = np.arange(int(ends[-1])) + np.repeat(starts - (ends - counts), counts)
        triangles = b.indices[every].reshape(-1, 3)
        positions = np.ascontiguousarray(b.vertices["position"])
        corner = positions[triangles[:, 0]]
        u, v = positions[triangles[:, 1]] - corner, positions[triangles[:, 2]] - corner
        # Areas of kilometre-sized triangles may overflow; such triangles do not become occluders.
        with np.errstate(over="ignore", invalid="ignore"):
            uu, vv, uv = (np.einsum("tk,tk->t", one, other) for one, other in ((u, u), (v, v), (u, v)))
            large = uu * vv - uv * uv >= np.float32(4.0 * LARGE_M2**2)  # the square of twice the area (Lagrange)
        upto = 3 * np.concatenate([[0], np.cumsum(large)])
        offset = len(self.indices)
        self._starts = np.concatenate([self._starts, starts])
        self._ends = np.concatenate([self._ends, starts + counts])
        self._large = np.concatenate([self._large, offset + upto[(ends - counts) // 3]])
        self._large_ends = np.concatenate([self._large_ends, offset + upto[ends // 3]])
        self.indices = np.concatenate([self.indices, triangles[large].ravel()])


class Subclusters:
    """Subclusters of the clusters of one scene."""

    def __init__(self, geometry: SceneGeometry) -> None:
        self._geometry = geometry
        counts = geometry.cluster_count.astype(np.int64)
        self._number = -(-counts // (3 * SUBCLUSTER_TRIANGLES))
        """(C,), number of subclusters of each cluster."""
        self._row = np.full(len(counts), -1)
        """(C,), row of the first subcluster; -1 = not computed yet."""
        self._rows = 0
        self._box = np.zeros((0, 6))
        """(P, 6), centre and half extents, metres, frame of the link."""
        self._span = np.zeros((0, 2), dtype=np.uint32)
        """(P, 2), number of indices, and offset of the first one."""

    @property
    def table(self) -> SubclusterTable:
        """Table of the subclusters computed so far."""
        return SubclusterTable(self._row, self._number, self._box, self._span)

    def prepare(self, clusters: I64) -> None:
        """Computes missing subclusters of clusters, (N,)."""
        new = self._row[clusters] < 0
        if new.any():
            self._compute(np.unique(clusters[new]))

    def of(self, clusters: I64) -> tuple[I64, F64, NDArray[np.uint32]]:
        """Returns the subclusters of clusters, in order, P in total.

        Args:
            clusters: (N,).

        Returns:
            The position in ``clusters`` of each subcluster, (P,); its box, (P, 6), centre and half extents, metres, frame of the link;
            and its number of indices and the offset of the first one, (P, 2).
        """
        self.prepare(clusters)
        number = self._number[clusters]
        ends = np.cumsum(number)
        rows = np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(self._row[clusters] - (ends - number), number)
        return np.repeat(np.arange(len(clusters)), number), self._box[rows], self._span[rows]

    def _compute(self, clusters: I64) -> None:
        b, number = self._geometry, self._number[clusters]
        ends = np.cumsum(number)
        owner, total = np.repeat(clusters, number), int(ends[-1])
        offset = 3 * SUBCLUSTER_TRIANGLES * (np.arange(total) - np.repeat(ends - number, number))
        first = b.cluster_first[owner].astype(np.int64) + offset
        count = np.minimum(b.cluster_count[owner].astype(np.int64) - offset, 3 * SUBCLUSTER_TRIANGLES)
        stops = np.cumsum(count)
        corners = b.vertices["position"][b.indices[np.arange(int(stops[-1])) + np.repeat(first - (stops - count), count)]]
        low = np.minimum.reduceat(corners, stops - count, axis=0).astype(np.float64)
        high = np.maximum.reduceat(corners, stops - count, axis=0).astype(np.float64)
        self._reserve(self._rows + total)
        rows = slice(self._rows, self._rows + total)
        self._box[rows] = np.hstack([(low + high) / 2, (high - low) / 2])
        self._span[rows, 0], self._span[rows, 1] = count, first
        self._row[clusters] = self._rows + ends - number
        self._rows += total

    def _reserve(self, rows: int) -> None:
        if rows > len(self._box):
            size = max(rows, 2 * len(self._box))
            box, span = np.zeros((size, 6)), np.zeros((size, 2), dtype=np.uint32)
            box[: self._rows], span[: self._rows] = self._box[: self._rows], self._span[: self._rows]
            self._box, self._span = box, span
