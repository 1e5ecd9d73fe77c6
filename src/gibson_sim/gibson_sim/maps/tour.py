"""Plans tours of a scene for a robot: a start pose, and a path through places far apart. Pure and deterministic."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.grid_graph import GridGraph
from gibson_sim.maps.paths import path_length
from gibson_sim.quoting import quoted

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Bools = NDArray[np.bool_]

PREFERRED_CLEARANCE = 0.35
"""Clearance beyond the robot's radius below which a path costs more, metres."""
CLEARANCE_WEIGHT = 4.0
"""Additional cost of a metre of path next to an obstacle, metres of path in the open."""
SEEN_WITHIN = 0.8
"""Distance from the tour within which places count as visited, metres."""
SPACING = 0.1
"""Maximum distance between neighbouring points of a tour, metres."""
START_TOLERANCE = 0.15
"""Maximum distance of a start from a cell that is free for the planner, metres."""
_SMOOTHING_PASSES = 3
_CORNER_CUT = 0.3
"""Distance from a corner at which smoothing cuts it, metres; at most a quarter of the segment."""
_HEADINGS = 16
"""Number of headings that are compared for a start."""


def choose_start(floor_map: FloorMap, radius: float) -> tuple[float, float, float]:
    """Returns x, y, yaw (world frame, metres, radians) of the most open place of the largest free region, facing its longest free line.

    Args:
        floor_map: the map.
        radius: radius of the robot, metres.

    Raises:
        SceneError: the floor has no room for the robot.
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
    headings = np.arange(_HEADINGS) * (2.0 * math.pi / _HEADINGS)
    lengths = [_free_length(floor_map, np.array([x, y]), float(heading)) for heading in headings]
    yaw = float(headings[int(np.argmax(lengths))])
    return float(x), float(y), yaw if yaw <= math.pi else yaw - 2 * math.pi


def plan_tour(floor_map: FloorMap, start_xy: tuple[float, float], radius: float, length_m: float) -> F64:
    """Returns a path (N, 2) that starts at ``start_xy`` and visits places far apart, world metres.

    The next goal is always the open place farthest from the previous tour; the tour restarts once it has visited every place. A disc
    of ``radius`` about any point of the path lies in free space, except within ``START_TOLERANCE`` of a start beside an obstacle.

    Args:
        floor_map: the map.
        start_xy: start, world metres.
        radius: radius of the robot, metres.
        length_m: length of the path, metres, accurate to 1 m.

    Raises:
        ConfigError: a length or radius is not above 0, or the start is not free; the message names the nearest free place.
        SceneError: the start is enclosed by obstacles.
    """
    if not (math.isfinite(length_m) and length_m > 0 and math.isfinite(radius) and radius > 0):
        raise ConfigError(f"tour: length is {quoted(length_m)} m and radius {quoted(radius)} m, both must be finite and above 0")
    graph = _TourGraph(floor_map, radius, start_xy)
    legs: list[F64] = [np.array([start_xy], dtype=np.float64)]
    visited: list[I64] = []
    node, length, path = graph.start, 0.0, legs[0]
    # Smoothing shortens the path, so plan half a metre more and truncate it.
    while length < length_m + 0.5:
        nodes = graph.next_leg(node, visited)
        if len(nodes) < 2:
            raise SceneError(
                f"tour: from {_at(start_xy)} the robot (radius {radius:g} m) can drive nowhere; choose another start"
            )
        visited.append(nodes)
        node = int(nodes[-1])
        legs.append(_smoothed(graph, _taut(graph, graph.points[nodes])))
        path = np.concatenate(legs)
        length = path_length(path)
    return _resample(path, length_m)


class _TourGraph:
    """The cells that the robot can reach from its start, 8-connected, with a cost per metre that increases near obstacles."""

    def __init__(self, floor_map: FloorMap, radius: float, start_xy: tuple[float, float]) -> None:
        self.floor_map, self.radius = floor_map, radius
        self.allowed = floor_map.inflate(radius)
        start_cell = tuple(_start_cell(floor_map, self.allowed, start_xy, radius))
        regions, _ = ndimage.label(self.allowed, np.ones((3, 3)))
        reachable = np.asarray(regions == regions[start_cell])
        self.clearance = floor_map.distance_to_obstacle[reachable]
        near = np.clip((radius + PREFERRED_CLEARANCE - self.clearance) / PREFERRED_CLEARANCE, 0.0, 1.0)
        self._grid = GridGraph(reachable, floor_map.resolution, price=1.0 + CLEARANCE_WEIGHT * near**2)
        self.start = int(self._grid.numbers[start_cell])
        self.points = floor_map.centers(self._grid.cells)

    def next_leg(self, start: int, visited: list[I64]) -> I64:
        """Returns the nodes from ``start`` to the open place farthest from ``visited``; clears that list if all places are near it."""
        for _ in range(2):
            distances = self._grid.distances(np.unique(np.concatenate([*visited, [start]])))
            openness = np.clip((self.clearance - self.radius) / PREFERRED_CLEARANCE, 0.2, 1.0)
            goal = int((distances * openness).argmax())
            if distances[goal] > SEEN_WITHIN or not visited:
                break
            visited.clear()
        return self._grid.shortest_paths(start).nodes(0, goal)

    def is_free(self, points: F64) -> Bools:
        """Returns (N,): whether the robot fits at points (N, 2), world metres."""
        return self.floor_map.look_up(self.allowed, points, outside=False)

    def samples(self, points: F64) -> F64:
        """Returns sample points (M, 2) along a polyline (N, 2), a quarter of a cell apart, world metres."""
        return _resample(points, math.inf, self.floor_map.resolution / 4)


def _start_cell(floor_map: FloorMap, allowed: Bools, start_xy: tuple[float, float], radius: float) -> I64:
    """Returns row and column (2,) of the start, or of the nearest allowed cell if the start is not free."""
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


def _taut(graph: _TourGraph, points: F64) -> F64:
    """Returns the corners (M, 2) of a path (N, 2) after string pulling, except where that loses much clearance, world metres."""
    corners = [0]
    while corners[-1] < len(points) - 1:
        first = corners[-1]
        # Double the step after each valid shortcut and halve it otherwise, to keep the number of trials low.
        last_valid, step = first + 1, 1
        while step:
            last = min(last_valid + step, len(points) - 1)
            if last > last_valid and _is_valid_shortcut(graph, points[first : last + 1]):
                last_valid, step = last, step * 2
            else:
                step //= 2
        corners.append(last_valid)
    return points[corners]


def _is_valid_shortcut(graph: _TourGraph, points: F64) -> bool:
    """Returns whether the line between the ends of a path (N, 2), world metres, is free and loses little clearance."""
    line = graph.samples(points[[0, -1]])
    if not graph.is_free(line).all():
        return False
    enough = graph.radius + PREFERRED_CLEARANCE
    before, after = (np.minimum(graph.floor_map.clearance(xy), enough) for xy in (points, line))
    return bool(after.min() >= before.min() - 1e-9) and bool(after.mean() >= before.mean() - 0.05)


def _smoothed(graph: _TourGraph, corners: F64) -> F64:
    """Returns the path (M, 2) with its corners (N, 2) repeatedly cut where the cut is free, world metres."""
    for _ in range(_SMOOTHING_PASSES):
        if len(corners) < 3:
            break
        points = [corners[:1]]
        for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
            cut = np.array([_towards(corner, before), _towards(corner, after)])
            points.append(cut if graph.is_free(graph.samples(cut)).all() else corner[None])
        corners = np.concatenate([*points, corners[-1:]])
    return corners


def _towards(corner: F64, neighbour: F64) -> F64:
    """Returns the point (2,) at which a corner (2,) is cut on the side of its neighbour (2,)."""
    away = neighbour - corner
    return np.asarray(corner + away * min(0.25, _CORNER_CUT / max(float(np.linalg.norm(away)), 1e-9)))


def _resample(points: F64, length_m: float, spacing: float = SPACING) -> F64:
    """Returns a polyline (M, 2) truncated at ``length_m``: the corners ``points`` (N, 2), and points between at most ``spacing`` metres apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    total = min(float(arc[-1]), length_m)
    even = np.linspace(0.0, total, max(math.ceil(total / spacing), 1) + 1)
    where = np.union1d(even, arc[arc <= total])
    where = where[np.concatenate([[True], np.diff(where) > 1e-6])]
    return np.stack([np.interp(where, arc, points[:, k]) for k in range(2)], axis=1)


def _free_length(floor_map: FloorMap, start: F64, heading: float) -> float:
    """Returns the length of the free line from ``start`` (2,), world metres, along a heading (radians); metres, at most 10."""
    distances = np.arange(0.0, 10.0, floor_map.resolution)
    line = start + distances[:, None] * np.array([math.cos(heading), math.sin(heading)])
    blocked = np.flatnonzero(floor_map.clearance(line) <= 0.0)
    return float(distances[blocked[0]]) if len(blocked) else 10.0


def _at(xy: tuple[float, float]) -> str:
    return f"({xy[0]:.2f}, {xy[1]:.2f})"
