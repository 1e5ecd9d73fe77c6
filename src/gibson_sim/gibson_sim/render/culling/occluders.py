"""Occluders: large triangles of opaque clusters, such as walls and floors, which hide most of a building from inside. No OpenGL."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.scene_geometry import SceneGeometry

I64 = NDArray[np.int64]
LARGE_M2 = 0.1
"""Minimum area of an occluder, square metres."""


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
