"""The large triangles of chunks: few of them, walls and floors above all, hide most of a building from an eye inside it. No OpenGL here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.batches import Batches

I64 = NDArray[np.int64]
LARGE_M2 = 0.1
"""Triangles of at least this area, square metres, are taken."""


class Occluders:
    """Large triangles of solid chunks, in an array of indices of their own beside that of all triangles."""

    def __init__(self) -> None:
        self.indices: NDArray[np.uint32] = np.zeros(0, dtype=np.uint32)
        """(3 T,), rows of ``Batches.vertices``."""
        self.first: I64 = np.zeros(0, dtype=np.int64)
        """(C,), where those of each chunk begin in ``indices``."""
        self.count: I64 = np.zeros(0, dtype=np.int64)
        """(C,), how many indices; 0 = none."""
        # Of each run of indices that was looked at, by where it begins: where its large triangles begin and end.
        self._starts = self._ends = self._large = self._large_ends = np.zeros(0, dtype=np.int64)

    def take(self, b: Batches, same_indices: int) -> None:
        """Looks at the triangles of batches.

        Args:
            b: whose.
            same_indices: so many of their indices, from the first on, are those of the batches before.
        """
        old = self._ends <= same_indices
        self._starts, self._ends = self._starts[old], self._ends[old]
        self._large, self._large_ends = self._large[old], self._large_ends[old]
        self.indices = self.indices[: int(self._large_ends[-1]) if len(self._large_ends) else 0]
        starts, chunk, run_of = np.unique(b.chunk_first.astype(np.int64), return_index=True, return_inverse=True)
        new = starts >= (int(self._ends[-1]) if len(self._ends) else 0)
        self._look(b, starts[new], b.chunk_count[chunk[new]].astype(np.int64))
        solid = np.zeros(len(b.chunk_first), dtype=bool)
        for batch in b.batches:
            solid[batch.first_chunk : batch.end_chunk] = batch.kind == "opaque"
        row = np.searchsorted(self._starts, starts)[run_of]
        self.first = self._large[row]
        self.count = np.where(solid, self._large_ends[row] - self._large[row], 0)

    def _look(self, b: Batches, starts: I64, counts: I64) -> None:
        """Appends the large triangles of runs of indices, in ascending order."""
        if not len(starts):
            return
        ends = np.cumsum(counts)
        every = np.arange(int(ends[-1])) + np.repeat(starts - (ends - counts), counts)
        triangles = b.indices[every].reshape(-1, 3)
        positions = np.ascontiguousarray(b.vertices["position"])
        corner = positions[triangles[:, 0]]
        u, v = positions[triangles[:, 1]] - corner, positions[triangles[:, 2]] - corner
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # triangles of kilometres: too large to be sure of, so they hide nothing
            uu, vv, uv = (np.einsum("tk,tk->t", one, other) for one, other in ((u, u), (v, v), (u, v)))
            large = uu * vv - uv * uv >= np.float32(4.0 * LARGE_M2**2)  # the square of twice the area (Lagrange)
        upto = 3 * np.concatenate([[0], np.cumsum(large)])
        before = len(self.indices)
        self._starts = np.concatenate([self._starts, starts])
        self._ends = np.concatenate([self._ends, starts + counts])
        self._large = np.concatenate([self._large, before + upto[(ends - counts) // 3]])
        self._large_ends = np.concatenate([self._large_ends, before + upto[ends // 3]])
        self.indices = np.concatenate([self.indices, triangles[large].ravel()])
