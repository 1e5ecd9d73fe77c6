"""Chunks cut into pieces with boxes of their own: more of them are hidden than of whole chunks.

Boxes are worked out when a chunk is first asked for: most chunks of a large scene never are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.render.batching.batches import Batches
from gibson_sim.render.culling.occlusion_culling import PieceTable

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
PIECE_TRIANGLES = 32
"""Neighbouring triangles of a chunk that make a piece."""


class Pieces:
    """Pieces of the chunks of one scene.

    Args:
        batches: of the scene.
    """

    def __init__(self, batches: Batches) -> None:
        self._b = batches
        counts = batches.chunk_count.astype(np.int64)
        self._number = -(-counts // (3 * PIECE_TRIANGLES))
        """(C,), pieces of each chunk."""
        self._row = np.full(len(counts), -1)
        """(C,), row of the first one; -1 = not worked out yet."""
        self._rows = 0
        self._box = np.zeros((0, 6))
        """(P, 6), centre and half the size, metres, frame of the link."""
        self._span = np.zeros((0, 2), dtype=np.uint32)
        """(P, 2), number of indices, and the first of them."""

    @property
    def table(self) -> PieceTable:
        """All that are known now."""
        return PieceTable(self._row, self._number, self._box, self._span)

    def prepare(self, chunks: I64) -> None:
        """Works out the pieces of chunks, (N,), of which they are not known yet."""
        new = self._row[chunks] < 0
        if new.any():
            self._work_out(np.unique(chunks[new]))

    def of(self, chunks: I64) -> tuple[I64, F64, NDArray[np.uint32]]:
        """Returns the pieces of chunks, in their order, P in all.

        Args:
            chunks: (N,).

        Returns:
            The place in ``chunks`` of each, (P,); its box, (P, 6), centre and half the size, metres, frame of the link; and its number of
            indices and the first of them, (P, 2).
        """
        self.prepare(chunks)
        number = self._number[chunks]
        ends = np.cumsum(number)
        rows = np.arange(int(ends[-1]) if len(ends) else 0) + np.repeat(self._row[chunks] - (ends - number), number)
        return np.repeat(np.arange(len(chunks)), number), self._box[rows], self._span[rows]

    def _work_out(self, chunks: I64) -> None:
        b, number = self._b, self._number[chunks]
        ends = np.cumsum(number)
        owner, total = np.repeat(chunks, number), int(ends[-1])
        offset = 3 * PIECE_TRIANGLES * (np.arange(total) - np.repeat(ends - number, number))
        first = b.chunk_first[owner].astype(np.int64) + offset
        count = np.minimum(b.chunk_count[owner].astype(np.int64) - offset, 3 * PIECE_TRIANGLES)
        stops = np.cumsum(count)
        corners = b.vertices["position"][b.indices[np.arange(int(stops[-1])) + np.repeat(first - (stops - count), count)]]
        low = np.minimum.reduceat(corners, stops - count, axis=0).astype(np.float64)
        high = np.maximum.reduceat(corners, stops - count, axis=0).astype(np.float64)
        self._reserve(self._rows + total)
        rows = slice(self._rows, self._rows + total)
        self._box[rows] = np.hstack([(low + high) / 2, (high - low) / 2])
        self._span[rows, 0], self._span[rows, 1] = count, first
        self._row[chunks] = self._rows + ends - number
        self._rows += total

    def _reserve(self, rows: int) -> None:
        if rows > len(self._box):
            size = max(rows, 2 * len(self._box))
            box, span = np.zeros((size, 6)), np.zeros((size, 2), dtype=np.uint32)
            box[: self._rows], span[: self._rows] = self._box[: self._rows], self._span[: self._rows]
            self._box, self._span = box, span
