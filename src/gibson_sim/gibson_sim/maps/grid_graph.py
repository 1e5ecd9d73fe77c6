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
"""Number of sample points on a step, per cell of ``reach``."""


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
        """Returns the nodes (K,) of a path, both ends included.

        Args:
            source: index into ``sources``.
            end: a node that is connected with it.
        """
        start, before = int(self.sources[source]), self.predecessors[source]
        out = [end]
        while out[-1] != start:
            out.append(int(before[out[-1]]))
        return np.array(out[::-1], dtype=np.int64)


class GridGraph:
    """A graph whose N nodes are the passable cells of a grid, row by row.

    Args:
        passable: (H, W).
        resolution: size of a cell, metres.
        reach: rows or columns that a step crosses at most. 1 gives 8 neighbours, 3 gives 32.
        clear_lines: whether a step needs all cells that its straight line touches. Without it the cell at the end is enough.
        price: (N,), cost of a metre in each cell, 1 where not given; a step costs its length times the mean of its two ends.
    """

    def __init__(
        self, passable: Bools, resolution: float, *, reach: int = 1, clear_lines: bool = False, price: F64 | None = None
    ) -> None:
        self.cells: I64 = np.argwhere(passable)
        """Row and column of each node, (N, 2)."""
        self.numbers: I64 = np.full(passable.shape, -1, dtype=np.int64)
        """Node of each cell, (H, W), -1 = not passable."""
        self.numbers[passable] = np.arange(len(self.cells))
        padded = np.pad(passable, reach)
        rows, columns, costs = [], [], []
        for step in _half_of_the_steps(reach):
            needed = _touched(step, reach) if clear_lines else np.array([step])
            clear = np.ones(len(self.cells), dtype=bool)
            for offset in needed:
                clear &= padded[tuple((self.cells + offset + reach).T)]
            here = np.flatnonzero(clear)
            there = self.numbers[tuple((self.cells[here] + step).T)]
            length = math.hypot(*step) * resolution
            rows.append(here)
            columns.append(there)
            costs.append(np.full(len(here), length) if price is None else length * (price[here] + price[there]) / 2)
        entries = np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))
        self._costs = sparse.csr_matrix(entries, shape=(len(self.cells), len(self.cells)))

    def distances(self, sources: ArrayLike) -> F64:
        """Returns (N,): lengths of the shortest paths from the nearest of the source nodes (S,), metres times price; +inf = none."""
        return np.asarray(csgraph.dijkstra(self._costs, directed=False, indices=np.atleast_1d(sources), min_only=True))

    def shortest_paths(self, sources: ArrayLike) -> ShortestPaths:
        """Returns the shortest paths from each of the source nodes (S,)."""
        nodes = np.atleast_1d(np.asarray(sources, dtype=np.int64))
        lengths, before = csgraph.dijkstra(self._costs, directed=False, indices=nodes, return_predecessors=True)
        return ShortestPaths(nodes, np.asarray(lengths), np.asarray(before))


def _half_of_the_steps(reach: int) -> list[tuple[int, int]]:
    """Returns the steps (rows, columns) up to ``reach``, no multiples of shorter ones, and of two opposite ones the first."""
    steps = [(dr, dc) for dr in range(reach + 1) for dc in range(-reach, reach + 1)]
    return [(dr, dc) for dr, dc in steps if math.gcd(dr, dc) == 1 and (dr > 0 or dc > 0)]


def _touched(step: tuple[int, int], reach: int) -> I64:
    """Returns (K, 2): offsets of the cells that the line from a cell's centre to that of another touches."""
    along = np.linspace(0.0, 1.0, _LINE_SAMPLES * reach + 1)[:, None] * np.array(step)
    low, high = np.floor(along + 0.499), np.ceil(along - 0.499)
    # All cells that meet at a corner count where the line runs through it.
    mixed = [low, high, np.stack([low[:, 0], high[:, 1]], 1), np.stack([high[:, 0], low[:, 1]], 1)]
    return np.asarray(np.unique(np.concatenate(mixed).astype(np.int64), axis=0))
