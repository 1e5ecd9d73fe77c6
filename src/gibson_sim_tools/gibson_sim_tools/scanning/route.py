"""Plans the route of a scanner: a short open tour of the stations (travelling salesman), and the views on it. Pure and deterministic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.maps.grid_graph import GridGraph
from gibson_sim_tools.scanning.settings import TourSettings
from gibson_sim_tools.scanning.stations import Station, StoreyFloor

F64 = NDArray[np.float64]

_UNREACHABLE = 1e6
"""Length that stands for "no path" (another storey, a closed door), metres."""


@dataclass(frozen=True, slots=True)
class RigView:
    """Pose and velocity of the rig at the moment of a view."""

    stamp_s: float
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    """Radians; the rig has x forward, z up."""
    velocity_x: float = 0.0
    """m/s, world frame."""
    velocity_y: float = 0.0
    yaw_rate: float = 0.0
    """rad/s."""

    @property
    def T_world_rig(self) -> Mat4:
        """(4, 4)."""
        return matrix_from_pose(pose_from_xyz_rpy((self.x, self.y, self.z), (self.roll, self.pitch, self.yaw)))

    def earlier(self, seconds: float) -> Mat4:
        """Returns T_world_rig, (4, 4), ``seconds`` before, at constant velocity."""
        position = (self.x - seconds * self.velocity_x, self.y - seconds * self.velocity_y, self.z)
        return matrix_from_pose(pose_from_xyz_rpy(position, (self.roll, self.pitch, self.yaw - seconds * self.yaw_rate)))


class StationPaths:
    """Shortest paths over the free floor of one storey, between all pairs of its S stations."""

    def __init__(self, storey: StoreyFloor, stations: Sequence[Station]) -> None:
        graph = GridGraph(storey.allowed, storey.floor_map.resolution)
        rows, columns = storey.floor_map.cells([(s.x, s.y) for s in stations]).T
        self._nodes = graph.numbers[rows, columns]
        self._points = storey.floor_map.centers(graph.cells)
        self._paths = graph.shortest_paths(self._nodes)
        self.lengths: F64 = self._paths.lengths[:, self._nodes]
        """(S, S): metres from each station to each; +inf = no path."""

    def points(self, start: int, end: int) -> F64:
        """Returns the points (N, 2), world metres, of the path between two stations, given by index."""
        return self._points[self._paths.nodes(start, int(self._nodes[end]))]


def short_tour(lengths: F64) -> list[int]:
    """Returns an order of all stations with a short open path that begins at the first one: nearest neighbour, then 2-opt.

    Args:
        lengths: (N, N), path lengths between stations, metres; +inf = no path.
    """
    distances = np.where(np.isfinite(lengths), lengths, _UNREACHABLE)
    order, unvisited = [0], set(range(1, len(distances)))
    while unvisited:
        order.append(min(unvisited, key=lambda k: (distances[order[-1], k], k)))
        unvisited.remove(order[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                after = order[j + 1] if j + 1 < len(order) else None
                old = distances[order[i - 1], order[i]] + (distances[order[j], after] if after is not None else 0.0)
                new = distances[order[i - 1], order[j]] + (distances[order[i], after] if after is not None else 0.0)
                if new < old - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    improved = True
    return order


def plan_views(
    stations: Sequence[Station], storeys: Sequence[StoreyFloor], tour: TourSettings, views_per_station: int, max_views: int
) -> list[RigView]:
    """Returns the views of a scan in their order.

    Args:
        stations: positions of full turns.
        storeys: storeys of the stations.
        tour: speeds and distances.
        views_per_station: number of views at each station.
        max_views: largest number of views; views between stations are thinned out first.
    """
    rng = np.random.default_rng([tour.seed, 2])
    walker = _ViewRecorder(tour, rng)
    for number, storey in enumerate(storeys):
        here = [s for s in stations if s.storey == number]
        if not here:
            continue
        paths = StationPaths(storey, here)
        order = short_tour(paths.lengths)
        for place, k in enumerate(order):
            if place and np.isfinite(paths.lengths[order[place - 1], k]) and tour.path_spacing > 0.0:
                last = order[place - 1]
                walker.walk(paths.points(last, k), here[last], here[k], storey.floor_z)
            walker.turn(here[k], storey.floor_z, views_per_station)
    return _thin_out(walker.views, walker.on_path, max_views)


class _ViewRecorder:
    """Moves the rig along the route and records its views."""

    def __init__(self, tour: TourSettings, rng: np.random.Generator) -> None:
        self._tour, self._rng = tour, rng
        self._time, self._yaw = 0.0, 0.0
        self.views: list[RigView] = []
        self.on_path: list[bool] = []

    def turn(self, station: Station, floor_z: float, views_per_station: int) -> None:
        """Records views all around a station."""
        rate = math.radians(self._tour.turn_speed_deg)
        for _ in range(views_per_station):
            self._record((station.x, station.y, floor_z + station.height), (0.0, 0.0), rate, on_path=False)
            self._yaw += 2.0 * math.pi / views_per_station
            self._time += 2.0 * math.pi / views_per_station / rate

    def walk(self, points: F64, start: Station, end: Station, floor_z: float) -> None:
        """Records views along a path, each in the direction of travel."""
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        length = float(arc[-1])
        arc_lengths = np.arange(1, int(length / self._tour.path_spacing) + 1) * self._tour.path_spacing
        for arc_length in arc_lengths[arc_lengths < length - 0.5 * self._tour.path_spacing]:
            here, ahead = (_point_at(points, arc, at) for at in (arc_length, min(arc_length + self._tour.path_spacing, length)))
            step = ahead - here
            self._yaw = math.atan2(step[1], step[0])
            velocity = step / max(float(np.linalg.norm(step)), 1e-9) * self._tour.speed
            height = start.height + (end.height - start.height) * arc_length / length
            self._record((here[0], here[1], floor_z + height), (velocity[0], velocity[1]), 0.0, on_path=True)
            self._time += self._tour.path_spacing / self._tour.speed
        self._time += self._tour.path_spacing / self._tour.speed

    def _record(self, position: tuple[float, float, float], velocity: tuple[float, float], rate: float, *, on_path: bool) -> None:
        roll, pitch = self._rng.standard_normal(2) * math.radians(self._tour.wobble_deg)
        x, y, z = map(float, position)
        yaw = math.remainder(self._yaw, 2.0 * math.pi)
        self.views.append(
            RigView(self._time, x, y, z, float(roll), float(pitch), yaw, float(velocity[0]), float(velocity[1]), rate)
        )
        self.on_path.append(on_path)


def _point_at(points: F64, arc: F64, at: float) -> F64:
    return np.array([np.interp(at, arc, points[:, k]) for k in range(2)])


def _thin_out(views: list[RigView], on_path: list[bool], max_views: int) -> list[RigView]:
    """Returns at most ``max_views`` views: thins out those between stations evenly, then truncates."""
    path_views = np.flatnonzero(on_path)
    path_count = max(max_views - (len(views) - len(path_views)), 0)
    if path_count < len(path_views):
        kept = (
            set(path_views[np.linspace(0, len(path_views) - 1, path_count).round().astype(int)].tolist()) if path_count else set()
        )
        views = [v for k, v in enumerate(views) if not on_path[k] or k in kept]
    return views[:max_views]
