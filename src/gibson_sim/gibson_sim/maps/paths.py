"""Shortest ways on a floor, and how far every place is from a goal.

Dijkstra's algorithm on a graph of cells with 32 neighbours each finds a way at most 1.3 % longer than the shortest; pulling it taut
takes the corners of the grid out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse import csgraph

from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_FARTHEST = 3
_SNAP = 0.5
"""A start or a goal that is not free is moved to a free cell at most this far away, metres."""
_SAMPLES = 4
"""Points on a line that are looked up, for each cell of its length."""
_MOST_CORNERS = 120
_CORNER = 1e-4


class PathPlanner:
    """Ways on one floor for one robot; the graph is made once.

    A way keeps ``radius`` from all obstacles, to within half the diagonal of a cell.

    Args:
        floor: the map.
        radius: of the robot, metres.
    """

    def __init__(self, floor: FloorMap, radius: float) -> None:
        self._floor, self._radius = floor, radius
        self.places: Bools = np.asarray(floor.free & (floor.distance_to_obstacle >= radius))
        """(H, W): cells about whose centre a disc of ``radius`` touches nothing."""
        self._numbers = np.full(floor.shape, -1, dtype=np.int64)
        self._cells: I64 = np.argwhere(self.places)
        self._numbers[self.places] = np.arange(len(self._cells))
        self._graph = self._make_graph()

    def distances(self, goal: ArrayLike) -> F64:
        """Returns (H, W): metres from each cell to a goal (2,), world metres, along the shortest way; +inf = no way.

        Raises:
            SceneError: the goal is not free.
        """
        out = np.full(self._floor.shape, np.inf)
        out[self.places] = csgraph.dijkstra(self._graph, directed=False, indices=self._number(goal, "goal"))
        return out

    def path(self, start: ArrayLike, goal: ArrayLike) -> F64:
        """Returns the corners (K, 2) of the shortest way between two points (2,), world metres.

        Raises:
            SceneError: one of the points is not free, or no way leads from one to the other.
        """
        first, last = self._number(start, "start"), self._number(goal, "goal")
        distances, before = csgraph.dijkstra(self._graph, directed=False, indices=first, return_predecessors=True)
        if not math.isfinite(distances[last]):
            raise SceneError(
                f"no way leads from {_text(start)} to {_text(goal)} for a robot of radius {self._radius:g} m; "
                "give points of one region, or a smaller radius"
            )
        numbers = [last]
        while numbers[-1] != first:
            numbers.append(int(before[numbers[-1]]))
        points = self._floor.centers(self._cells[numbers[::-1]])
        for end, given in ((0, start), (-1, goal)):
            exact = np.asarray(given, dtype=np.float64)
            if self._sees(exact, exact[None])[0]:
                points[end] = exact
        return self._taut(points)

    def _make_graph(self) -> sparse.csr_matrix:
        rows, columns, lengths = [], [], []
        for dr in range(_FARTHEST + 1):
            for dc in range(-_FARTHEST, _FARTHEST + 1):
                if math.gcd(dr, dc) != 1 or (dr == 0 and dc < 0):
                    continue
                starts = self._cells[self._passes(dr, dc)]
                rows.append(self._numbers[tuple(starts.T)])
                columns.append(self._numbers[tuple((starts + np.array([dr, dc])).T)])
                lengths.append(np.full(len(starts), math.hypot(dr, dc) * self._floor.resolution))
        count = len(self._cells)
        entries = (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns)))
        return sparse.csr_matrix(entries, shape=(count, count))

    def _passes(self, dr: int, dc: int) -> Bools:
        """Returns (N,): cells from which all cells on the line to the one ``dr`` rows and ``dc`` columns on are places."""
        padded = np.pad(self.places, _FARTHEST)
        steps = np.linspace(0.0, 1.0, 8 * _FARTHEST + 1)[:, None] * np.array([dr, dc])
        before, behind = np.floor(steps + 0.499), np.ceil(steps - 0.499)
        # Where the line runs through a corner all cells that meet there count.
        mixed = [before, behind, np.stack([before[:, 0], behind[:, 1]], 1), np.stack([behind[:, 0], before[:, 1]], 1)]
        out = np.ones(len(self._cells), dtype=bool)
        for offset in np.unique(np.concatenate(mixed).astype(np.int64), axis=0):
            out &= padded[tuple((self._cells + offset + _FARTHEST).T)]
        return out

    def _taut(self, points: F64) -> F64:
        """Returns the shortest way (K, 2) along those of ``points`` (N, 2) that see each other."""
        if len(points) > _MOST_CORNERS:
            turns = np.flatnonzero(np.abs(np.diff(points, 2, axis=0)).max(axis=1) > 1e-9) + 1
            spread = np.linspace(0, len(points) - 1, _MOST_CORNERS).astype(np.int64)
            points = points[np.union1d(turns, spread)]
        count = len(points)
        left, following = np.zeros(count), np.arange(1, count + 1)
        for i in range(count - 2, -1, -1):
            # Of equal ways the one with fewer corners.
            lengths = np.linalg.norm(points[i + 1 :] - points[i], axis=1) + left[i + 1 :] + _CORNER
            seen = self._sees(points[i], points[i + 1 :])
            seen[0] = True
            lengths[~seen] = np.inf
            best = int(lengths.argmin())
            left[i], following[i] = lengths[best], i + 1 + best
        chosen = [0]
        while chosen[-1] != count - 1:
            chosen.append(int(following[chosen[-1]]))
        return np.asarray(points[chosen])

    def _sees(self, point: F64, others: F64) -> Bools:
        """Returns (N,): whether the straight ways from a point (2,) to others (N, 2) lead over places alone."""
        if not len(others):
            return np.zeros(0, dtype=bool)
        longest = float(np.abs(others - point).max()) / self._floor.resolution
        along = np.linspace(0.0, 1.0, int(longest * _SAMPLES) + 2)
        cells = self._floor.cells(point + (others - point)[:, None, :] * along[:, None])
        inside = np.asarray(((cells >= 0) & (cells < np.array(self._floor.shape))).all(axis=-1))
        safe = np.where(inside[..., None], cells, 0)
        return np.asarray((inside & self.places[safe[..., 0], safe[..., 1]]).all(axis=1))

    def _number(self, point: ArrayLike, what: str) -> int:
        """Returns the number of the place nearest to a point (2,)."""
        if len(self._cells):
            away = np.linalg.norm(self._floor.centers(self._cells) - np.asarray(point, dtype=np.float64), axis=1)
            nearest = int(away.argmin())
            if away[nearest] <= _SNAP:
                return nearest
        raise SceneError(
            f"{what} {_text(point)} is no place for a robot of radius {self._radius:g} m, and none is within {_SNAP:g} m; "
            "give a free point, or a smaller radius"
        )


def shortest_path(floor: FloorMap, start: ArrayLike, goal: ArrayLike, *, radius: float = 0.3) -> F64:
    """Returns the corners (K, 2) of the shortest way, world metres; for several ways use one ``PathPlanner``.

    Args:
        floor: the map.
        start: (2,), world metres; moved to the nearest free cell within half a metre.
        goal: the same.
        radius: what the way keeps from obstacles, metres.

    Raises:
        SceneError: one of the points is not free, or no way leads from one to the other.
    """
    return PathPlanner(floor, radius).path(start, goal)


def distance_field(floor: FloorMap, goal: ArrayLike, *, radius: float = 0.3) -> F64:
    """Returns (H, W): metres from each cell to a goal (2,) along the shortest way, at most 1.3 % too long; +inf = no way.

    ``FloorMap.distance_to_obstacle`` is the other field: how far the nearest obstacle is.

    Raises:
        SceneError: the goal is not free.
    """
    return PathPlanner(floor, radius).distances(goal)


def path_length(points: ArrayLike) -> float:
    """Returns the length of a way (K, 2), metres."""
    return float(np.linalg.norm(np.diff(np.asarray(points, dtype=np.float64), axis=0), axis=1).sum())


def _text(point: ArrayLike) -> str:
    x, y = np.asarray(point, dtype=np.float64).tolist()
    return f"({x:.2f}, {y:.2f})"
