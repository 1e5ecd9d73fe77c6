"""Shortest paths on a costmap, simplified to few straight lines. Independent of ROS."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from gibson_examples.costmap import Costmap
from gibson_examples.errors import PlanError
from gibson_examples.geometry import F64, I64

SNAP = 0.4
"""Largest distance by which a start too near to an obstacle is moved, metres."""
GOAL_SNAP = 0.15
"""Largest distance by which a goal too near to an obstacle is moved, metres."""
SPACING = 0.05
"""Distance between the points of a path, metres."""
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows, columns to four of the eight neighbours: the graph is undirected."""


class RoutePlanner:
    """Dijkstra's tree of the shortest paths to one goal: a path from another start needs no new search."""

    def __init__(self, costmap: Costmap, goal_xy: tuple[float, float]) -> None:
        """Plans on the present costmap.

        Raises:
            PlanError: the robot does not fit at the goal.
        """
        self._costmap = costmap
        cell = costmap.nearest_passable(goal_xy, GOAL_SNAP)
        if cell is None:
            raise PlanError(
                f"goal {goal_xy[0]:.2f},{goal_xy[1]:.2f} is too near to an obstacle, or outside the map: the robot needs "
                f"{costmap.settings.robot_radius + costmap.settings.margin:.2f} m around it; choose a place with more room"
            )
        self._columns = costmap.grid.shape[1]
        self._cost = costmap.cost()
        row, column = (int(v) for v in cell)
        x, y = (float(v) for v in costmap.grid.centers(cell))
        self.end = goal_xy if (row, column) == tuple(costmap.grid.cells(goal_xy).tolist()) else (x, y)
        """End of the paths, map frame, metres: the goal, or the passable place nearest to it."""
        graph = _graph(self._cost, costmap.grid.resolution)
        self._to_goal, self._next = dijkstra(
            graph, directed=False, indices=row * self._columns + column, return_predecessors=True
        )

    def path(self, start_xy: tuple[float, float]) -> F64:
        """Returns the path from a start to the goal: (N, 2), map frame, metres, points about ``SPACING`` apart.

        Raises:
            PlanError: there is no path.
        """
        cell = self._costmap.nearest_passable(start_xy, SNAP)
        if cell is None:
            raise PlanError(f"no free place within {SNAP} m of the robot at {start_xy[0]:.2f},{start_xy[1]:.2f}")
        node = int(cell[0] * self._columns + cell[1])
        if not math.isfinite(self._to_goal[node]):
            raise PlanError(
                f"no way from {start_xy[0]:.2f},{start_xy[1]:.2f} to {self.end[0]:.2f},{self.end[1]:.2f}: "
                "obstacles block all of them"
            )
        nodes = [node]
        while (node := int(self._next[node])) >= 0:
            nodes.append(node)
        cells = np.column_stack(np.divmod(np.array(nodes), self._columns))
        between = self._costmap.grid.centers(cells[self._shortcut(cells)])[1:-1]
        return resample(np.vstack([start_xy, between, self.end]), SPACING)

    def _shortcut(self, cells: I64) -> list[int]:
        """Returns the cells of a path to keep: straight lines between them cost no more than the path."""
        steps = np.hypot(*np.diff(cells, axis=0).T)
        at = self._cost[cells[:, 0], cells[:, 1]]
        spent = np.concatenate([[0.0], np.cumsum(steps * (1.0 + (at[1:] + at[:-1]) / 2))])
        kept, last = [0], len(cells) - 1
        while kept[-1] < last:
            here = kept[-1]
            reach = last - here
            while reach > 1 and self._line_cost(cells[here], cells[here + reach]) > spent[here + reach] - spent[here] + 1e-6:
                reach = reach * 2 // 3
            kept.append(here + max(reach, 1))
        return kept

    def _line_cost(self, a: I64, b: I64) -> float:
        """Returns the cost of the straight line between two cells, in cells."""
        length = float(np.hypot(*(b - a)))
        fractions = np.linspace(0.0, 1.0, max(2, math.ceil(2 * length) + 1))
        points = np.rint(a + fractions[:, None] * (b - a)).astype(np.int64)
        along = self._cost[points[:, 0], points[:, 1]]
        return length * (1.0 + float((along[1:] + along[:-1]).mean()) / 2)


def _graph(cost: F64, resolution: float) -> coo_array:
    """Returns the undirected graph of the passable cells and their eight neighbours: weights in metres times 1 + cost."""
    rows, columns = cost.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    starts: list[NDArray[np.int64]] = []
    ends: list[NDArray[np.int64]] = []
    weights: list[F64] = []
    for down, right in _DIRECTIONS:
        a = np.s_[: rows - down, max(-right, 0) : columns - max(right, 0)]
        b = np.s_[down:, max(right, 0) : columns - max(-right, 0)]
        passable = np.isfinite(cost[a]) & np.isfinite(cost[b])
        starts.append(index[a][passable])
        ends.append(index[b][passable])
        weights.append(resolution * math.hypot(down, right) * (1.0 + (cost[a][passable] + cost[b][passable]) / 2))
    entries = (np.concatenate(weights), (np.concatenate(starts), np.concatenate(ends)))
    return coo_array(entries, shape=(cost.size, cost.size)).tocsr()


def resample(corners: F64, spacing: float) -> F64:
    """Returns points (N, 2) about ``spacing`` apart on the straight lines between corners (M, 2)."""
    steps = np.hypot(*np.diff(corners, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    count = max(2, round(float(arc[-1]) / spacing) + 1)
    at = np.linspace(0.0, float(arc[-1]), count)
    return np.column_stack([np.interp(at, arc, corners[:, k]) for k in range(2)])
