"""Clusters split into subclusters with their own boxes, for finer occlusion culling.

A box is computed when its cluster is first drawn: most clusters of a large scene are never drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.scene_geometry import SceneGeometry
from gibson_sim.render.culling.occlusion_culling import SubclusterTable

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
SUBCLUSTER_TRIANGLES = 32
"""Maximum number of triangles in a subcluster; they are neighbours."""


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
