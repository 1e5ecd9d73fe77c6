"""Plans where a robot can drive to see a scene: a good place to start and a tour. Pure and deterministic."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.quoting import quoted

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

PREFERRED_CLEARANCE = 0.35
"""Beyond the robot's radius: the planner pays for coming nearer to obstacles than this, metres."""
CLEARANCE_WEIGHT = 4.0
"""A metre beside an obstacle costs as much as 1 + this many metres in the open."""
SEEN_WITHIN = 0.8
"""Places nearer to the tour than this count as visited, metres."""
SPACING = 0.1
"""Between the points of a tour, metres."""
START_TOLERANCE = 0.15
"""A start may be this far from a place that the planner calls free, metres."""
_ROUNDINGS = 3
_CORNER_CUT = 0.3


def choose_start(floor_map: FloorMap, radius: float) -> tuple[float, float, float]:
    """Returns x, y, yaw (metres, radians) of the most open place of the largest free region, looking along its longest free way.

    Args:
        floor_map: where the floor is free.
        radius: of the robot, metres.

    Raises:
        SceneError: the robot fits nowhere.
    """
    region = floor_map.largest_free_region(radius)
    if not region.any():
        raise SceneError(
            f"no place on the floor is free for a robot of radius {radius:g} m; "
            "check floor_z of the scene, or give a start pose in scene.yaml or as x,y,yaw_deg"
        )
    openness = np.where(region, floor_map.distance_to_obstacle, -1.0)
    cell = np.array(np.unravel_index(int(openness.argmax()), openness.shape))
    x, y = floor_map.centers(cell)
    headings = np.arange(16) * (math.pi / 8)
    reach = [_free_run(floor_map, np.array([x, y]), float(heading)) for heading in headings]
    yaw = float(headings[int(np.argmax(reach))])
    return float(x), float(y), yaw if yaw <= math.pi else yaw - 2 * math.pi


def plan_tour(floor_map: FloorMap, start_xy: tuple[float, float], radius: float, length_m: float) -> F64:
    """Returns a path that starts at ``start_xy`` and visits places far apart, shape (N, 2), metres, world frame.

    The next goal is always the open place farthest from where the tour has been; once all is seen the round begins anew. A disc of
    ``radius`` about any point of the path lies in free space (but for the first ``START_TOLERANCE``, if it starts beside something).

    Args:
        floor_map: where the floor is free.
        start_xy: metres.
        radius: of the robot, metres.
        length_m: wanted length; the path is that long to within 1 m.

    Raises:
        ConfigError: a length or radius is not above 0, or the start is not free; the text names the nearest free place.
        SceneError: the start is walled in.
    """
    if not (math.isfinite(length_m) and length_m > 0 and math.isfinite(radius) and radius > 0):
        raise ConfigError(f"tour: length is {quoted(length_m)} m and radius {quoted(radius)} m, both must be finite and above 0")
    graph = _Graph(floor_map, radius, start_xy)
    pieces: list[F64] = [np.array([start_xy], dtype=np.float64)]
    visited: list[I64] = []
    here, length, smoothed = graph.start, 0.0, pieces[0]
    # Smoothing shortens; plan a little more and cut.
    while length < length_m + 0.5:
        nodes = graph.next_leg(here, visited)
        if len(nodes) < 2:
            raise SceneError(
                f"tour: from {_at(start_xy)} the robot (radius {radius:g} m) can drive nowhere; choose another start"
            )
        visited.append(nodes)
        here = int(nodes[-1])
        leg = _round_corners(graph, _pull_string(graph, graph.points[nodes]))
        pieces.append(leg)
        smoothed = np.concatenate(pieces)
        length = float(np.linalg.norm(np.diff(smoothed, axis=0), axis=1).sum())
    return _resample(smoothed, length_m)


class _Graph:
    """The places that the robot can reach from its start, as an 8-connected grid weighted by clearance."""

    def __init__(self, floor_map: FloorMap, radius: float, start_xy: tuple[float, float]) -> None:
        self.floor_map, self.radius = floor_map, radius
        self.allowed = floor_map.inflate(radius)
        start_cell = _start_cell(floor_map, self.allowed, start_xy, radius)
        labels = _regions(self.allowed)
        self.cells: I64 = np.argwhere(labels == labels[tuple(start_cell)])
        number = np.full(floor_map.shape, -1, dtype=np.int64)
        number[tuple(self.cells.T)] = np.arange(len(self.cells))
        self.start = int(number[tuple(start_cell)])
        self.points = floor_map.centers(self.cells)
        self.clearance = floor_map.distance_to_obstacle[tuple(self.cells.T)]
        self.costs = self._edges(number)

    def _edges(self, number: I64) -> sparse.csr_matrix:
        near = np.clip((self.radius + PREFERRED_CLEARANCE - self.clearance) / PREFERRED_CLEARANCE, 0.0, 1.0)
        price = 1.0 + CLEARANCE_WEIGHT * near**2
        padded = np.pad(number, 1, constant_values=-1)
        rows, columns, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            other = padded[self.cells[:, 0] + 1 + dr, self.cells[:, 1] + 1 + dc]
            a = np.flatnonzero(other >= 0)
            b = other[a]
            step = math.hypot(dr, dc) * self.floor_map.resolution
            rows.append(a)
            columns.append(b)
            costs.append(step * (price[a] + price[b]) / 2)
        n = len(self.cells)
        return sparse.csr_matrix((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n))

    def next_leg(self, here: int, visited: list[I64]) -> I64:
        """Returns the nodes from ``here`` to the open place farthest from what is visited; forgets all once everything is seen."""
        for _ in range(2):
            sources = np.unique(np.concatenate([*visited, [here]]))
            seen = csgraph.dijkstra(self.costs, directed=False, indices=sources, min_only=True)
            openness = np.clip((self.clearance - self.radius) / PREFERRED_CLEARANCE, 0.2, 1.0)
            worth = seen * openness
            goal = int(worth.argmax())
            if seen[goal] > SEEN_WITHIN or not visited:
                break
            visited.clear()
        _, before = csgraph.dijkstra(self.costs, directed=False, indices=here, return_predecessors=True)
        nodes = [goal]
        while nodes[-1] != here:
            nodes.append(int(before[nodes[-1]]))
        return np.array(nodes[::-1], dtype=np.int64)

    def is_free(self, points: F64) -> Bools:
        """Returns (N,): the robot may be at these points (N, 2)."""
        cells = self.floor_map.cells(points)
        inside = np.asarray(((cells >= 0) & (cells < np.array(self.floor_map.shape))).all(axis=1))
        safe = np.where(inside[:, None], cells, 0)
        return np.asarray(inside & self.allowed[safe[:, 0], safe[:, 1]])

    def samples(self, points: F64) -> F64:
        """Returns points (M, 2) along a polyline, a quarter of a cell apart."""
        return _resample(points, math.inf, self.floor_map.resolution / 4)


def _regions(allowed: Bools) -> I64:
    """Returns (H, W): numbers of the 8-connected regions, 0 = not allowed."""
    labels, _ = ndimage.label(allowed, np.ones((3, 3)))
    return np.asarray(labels, dtype=np.int64)


def _start_cell(floor_map: FloorMap, allowed: Bools, start_xy: tuple[float, float], radius: float) -> I64:
    """Returns row and column of the start, or of the allowed cell beside it."""
    nearest = floor_map.nearest_free(start_xy, radius)
    if nearest is None:
        raise SceneError(f"tour: no place on the floor is free for a robot of radius {radius:g} m; check floor_z of the scene")
    cell = floor_map.cells(start_xy)
    if (cell >= 0).all() and (cell < np.array(floor_map.shape)).all() and allowed[tuple(cell)]:
        return cell
    if math.dist(nearest, start_xy) > START_TOLERANCE:
        raise ConfigError(
            f"tour: a robot of radius {radius:g} m is not free at the start {_at(start_xy)}; "
            f"the nearest free place is {_at(nearest)}"
        )
    return floor_map.cells(nearest)


def _pull_string(graph: _Graph, points: F64) -> F64:
    """Returns the corners (M, 2) of a path (N, 2) once it is pulled tight where that loses little clearance."""
    corners = [0]
    while corners[-1] < len(points) - 1:
        first = corners[-1]
        # Halve the reach until the shortcut is good; then grow it again, so that few shortcuts are tried.
        good, step = first + 1, 1
        while step:
            last = min(good + step, len(points) - 1)
            if last > good and _shortcut_is_good(graph, points[first : last + 1]):
                good, step = last, step * 2
            else:
                step //= 2
        corners.append(good)
    return points[corners]


def _shortcut_is_good(graph: _Graph, points: F64) -> bool:
    line = graph.samples(points[[0, -1]])
    if not graph.is_free(line).all():
        return False
    enough = graph.radius + PREFERRED_CLEARANCE
    way = np.minimum(graph.floor_map.clearance(points), enough)
    return bool(np.minimum(graph.floor_map.clearance(line), enough).min() >= way.min() - 1e-9) and bool(
        np.minimum(graph.floor_map.clearance(line), enough).mean() >= way.mean() - 0.05
    )


def _round_corners(graph: _Graph, corners: F64) -> F64:
    """Returns the path with its corners cut off, again and again, wherever the cut is free."""
    for _ in range(_ROUNDINGS):
        if len(corners) < 3:
            break
        points = [corners[:1]]
        for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
            cut = np.array([_towards(corner, before), _towards(corner, after)])
            points.append(cut if graph.is_free(graph.samples(cut)).all() else corner[None])
        corners = np.concatenate([*points, corners[-1:]])
    return corners


def _towards(corner: F64, neighbour: F64) -> F64:
    away = neighbour - corner
    return np.asarray(corner + away * min(0.25, _CORNER_CUT / max(float(np.linalg.norm(away)), 1e-9)))


def _resample(points: F64, length_m: float, spacing: float = SPACING) -> F64:
    """Returns a polyline (M, 2) cut at ``length_m``: its corners, and points between them at most ``spacing`` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    total = min(float(arc[-1]), length_m)
    even = np.linspace(0.0, total, max(math.ceil(total / spacing), 1) + 1)
    where = np.union1d(even, arc[arc <= total])
    where = where[np.concatenate([[True], np.diff(where) > 1e-6])]
    return np.stack([np.interp(where, arc, points[:, k]) for k in range(2)], axis=1)


def _free_run(floor_map: FloorMap, start: F64, heading: float) -> float:
    """Returns how far one can look from ``start`` before something stands in the way, metres, at most 10."""
    distances = np.arange(0.0, 10.0, floor_map.resolution)
    line = start + distances[:, None] * np.array([math.cos(heading), math.sin(heading)])
    blocked = np.flatnonzero(floor_map.clearance(line) <= 0.0)
    return float(distances[blocked[0]]) if len(blocked) else 10.0


def _at(xy: tuple[float, float]) -> str:
    return f"({xy[0]:.2f}, {xy[1]:.2f})"
