"""Shortest paths over the cells of a grid, by Dijkstra's algorithm: for robots, tours and scanners. Pure and deterministic."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_LINE_SAMPLES = 8
"""Number of sample points on a step, per cell of ``max_step``."""


@dataclass(frozen=True, slots=True, eq=False)
class ShortestPaths:
    """The shortest paths from S source nodes to all N nodes of a graph."""

    sources: I64
    """Source nodes, (S,)."""
    lengths: F64
    """Path lengths, (S, N), metres times price; +inf = not connected."""
    predecessors: NDArray[np.int32]
    """Predecessor of each node on the path from the source, (S, N); negative at the source, and if there is no path."""

    def nodes(self, source: int, end: int) -> I64:
        """Returns the nodes (K,) of a path, including both ends.

        Args:
            source: index into ``sources``.
            end: a node that is connected to it.
        """
        start, predecessors = int(self.sources[source]), self.predecessors[source]
        out = [end]
        while out[-1] != start:
            out.append(int(predecessors[out[-1]]))
        return np.array(out[::-1], dtype=np.int64)


class GridGraph:
    """A graph whose N nodes are the passable cells of a grid, row by row.

    Args:
        passable: mask of passable cells, (H, W).
        resolution: size of a cell, metres.
        max_step: maximum number of rows or columns that a step crosses: 1 = 8-connected, 3 = 32-connected.
        clear_lines: whether all cells on the straight line of a step must be passable, else only the cell at its end.
        price: (N,), cost per metre in each cell; None = 1; the cost of a step is its length times the mean price of its ends.
    """

    def __init__(
        self, passable: Bools, resolution: float, *, max_step: int = 1, clear_lines: bool = False, price: F64 | None = None
    ) -> None:
        self.cells: I64 = np.argwhere(passable)
        """Row and column of each node, (N, 2)."""
        self.numbers: I64 = np.full(passable.shape, -1, dtype=np.int64)
        """Node of each cell, (H, W), -1 = not passable."""
        self.numbers[passable] = np.arange(len(self.cells))
        padded = np.pad(passable, max_step)
        rows, columns, costs = [], [], []
        for step in _half_of_the_steps(max_step):
            needed = _touched(step, max_step) if clear_lines else np.array([step])
            clear = np.ones(len(self.cells), dtype=bool)
            for offset in needed:
                clear &= padded[tuple((self.cells + offset + max_step).T)]
            from_rows = np.flatnonzero(clear)
            to_nodes = self.numbers[tuple((self.cells[from_rows] + step).T)]
            length = math.hypot(*step) * resolution
            rows.append(from_rows)
            columns.append(to_nodes)
            costs.append(np.full(len(from_rows), length) if price is None else length * (price[from_rows] + price[to_nodes]) / 2)
        entries = np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))
        self._costs = sparse.csr_matrix(entries, shape=(len(self.cells), len(self.cells)))

    def distances(self, sources: ArrayLike) -> F64:
        """Returns (N,): length of the shortest path from the nearest of the source nodes (S,), metres times price; +inf = not connected."""
        return np.asarray(csgraph.dijkstra(self._costs, directed=False, indices=np.atleast_1d(sources), min_only=True))

    def shortest_paths(self, sources: ArrayLike) -> ShortestPaths:
        """Returns the shortest paths from each of the source nodes (S,)."""
        nodes = np.atleast_1d(np.asarray(sources, dtype=np.int64))
        lengths, predecessors = csgraph.dijkstra(self._costs, directed=False, indices=nodes, return_predecessors=True)
        return ShortestPaths(nodes, np.asarray(lengths), np.asarray(predecessors))


def _half_of_the_steps(max_step: int) -> list[tuple[int, int]]:
    """Returns the steps (rows, columns) up to ``max_step``, without multiples of shorter steps, and one of each pair of opposite steps."""
    steps = [(dr, dc) for dr in range(max_step + 1) for dc in range(-max_step, max_step + 1)]
    return [(dr, dc) for dr, dc in steps if math.gcd(dr, dc) == 1 and (dr > 0 or dc > 0)]


def _touched(step: tuple[int, int], max_step: int) -> I64:
    """Returns offsets (K, 2) of the cells on the line from the centre of a cell to that of another."""
    along = np.linspace(0.0, 1.0, _LINE_SAMPLES * max_step + 1)[:, None] * np.array(step)
    low, high = np.floor(along + 0.499), np.ceil(along - 0.499)
    # If the line passes through a corner, all adjacent cells count.
    mixed = [low, high, np.stack([low[:, 0], high[:, 1]], 1), np.stack([high[:, 0], low[:, 1]], 1)]
    return np.asarray(np.unique(np.concatenate(mixed).astype(np.int64), axis=0))
