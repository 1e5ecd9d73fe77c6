"""The way of a scanner: from station to station by a short round, and the views on it. Pure and deterministic."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim_tools.scanning.settings import TourSettings
from gibson_sim_tools.scanning.stations import Station, Storey

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_NO_WAY = 1e6
"""Metres that stand for "there is no way": another storey, or a closed door."""


@dataclass(frozen=True, slots=True)
class View:
    """The rig at the moment of a picture, and how it moves."""

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
        """Returns T_world_rig some time before, (4, 4), if it has moved evenly."""
        position = (self.x - seconds * self.velocity_x, self.y - seconds * self.velocity_y, self.z)
        return matrix_from_pose(pose_from_xyz_rpy(position, (self.roll, self.pitch, self.yaw - seconds * self.yaw_rate)))


class Ways:
    """Shortest ways over the free floor of one storey."""

    def __init__(self, storey: Storey) -> None:
        self._map = storey.floor_map
        self._cells: I64 = np.argwhere(storey.allowed)
        number = np.full((storey.allowed.shape[0] + 2, storey.allowed.shape[1] + 2), -1, dtype=np.int64)
        number[self._cells[:, 0] + 1, self._cells[:, 1] + 1] = np.arange(len(self._cells))
        self._number = number
        rows, columns, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            other = number[self._cells[:, 0] + 1 + dr, self._cells[:, 1] + 1 + dc]
            here = np.flatnonzero(other >= 0)
            rows.append(here)
            columns.append(other[here])
            costs.append(np.full(len(here), math.hypot(dr, dc) * self._map.resolution))
        n = len(self._cells)
        self._graph = sparse.csr_matrix((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n))

    def lengths(self, stations: Sequence[Station]) -> tuple[F64, I64]:
        """Returns lengths of the ways between stations (S, S), metres, and the predecessors (S, C) that ``way`` takes."""
        nodes = [self._node(s) for s in stations]
        lengths, before = csgraph.dijkstra(self._graph, directed=False, indices=nodes, return_predecessors=True)
        return np.asarray(lengths[:, nodes]), np.asarray(before, dtype=np.int64)

    def way(self, before: I64, start: Station, end: Station) -> F64:
        """Returns the points of a way, (N, 2), metres; ``before`` is the row of predecessors that belongs to ``start``."""
        first, node = self._node(start), self._node(end)
        nodes = [node]
        while node != first:
            node = int(before[node])
            nodes.append(node)
        return self._map.centers(self._cells[nodes[::-1]])

    def _node(self, station: Station) -> int:
        row, column = self._map.cells((station.x, station.y))
        return int(self._number[row + 1, column + 1])


def short_round(lengths: F64) -> list[int]:
    """Returns an order of all places in which the way through them is short, from the first one; both ends are open.

    The nearest one next, then two-opt until nothing gets shorter.
    """
    d = np.where(np.isfinite(lengths), lengths, _NO_WAY)
    order, left = [0], set(range(1, len(d)))
    while left:
        order.append(min(left, key=lambda k: (d[order[-1], k], k)))
        left.remove(order[-1])
    better = True
    while better:
        better = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                after = order[j + 1] if j + 1 < len(order) else None
                old = d[order[i - 1], order[i]] + (d[order[j], after] if after is not None else 0.0)
                new = d[order[i - 1], order[j]] + (d[order[i], after] if after is not None else 0.0)
                if new < old - 1e-9:
                    order[i : j + 1] = order[i : j + 1][::-1]
                    better = True
    return order


def plan_views(stations: Sequence[Station], storeys: Sequence[Storey], tour: TourSettings, turns: int, most: int) -> list[View]:
    """Returns the views of a scan in their order.

    Args:
        stations: where the rig turns around.
        storeys: that they are on.
        tour: speeds and distances.
        turns: views at each station.
        most: views in all; those on the way are thinned out to that.
    """
    rng = np.random.default_rng([tour.seed, 2])
    walker = _Walker(tour, rng)
    for number, storey in enumerate(storeys):
        here = [s for s in stations if s.storey == number]
        if not here:
            continue
        ways = Ways(storey)
        lengths, before = ways.lengths(here)
        order = short_round(lengths)
        for place, k in enumerate(order):
            if place and np.isfinite(lengths[order[place - 1], k]) and tour.path_spacing > 0.0:
                last = order[place - 1]
                walker.walk(ways.way(before[last], here[last], here[k]), here[last], here[k], storey.floor_z)
            walker.turn(here[k], storey.floor_z, turns)
    return _thinned(walker.views, walker.on_way, most)


class _Walker:
    """Keeps where the rig is, and the time."""

    def __init__(self, tour: TourSettings, rng: np.random.Generator) -> None:
        self._tour, self._rng = tour, rng
        self._time, self._yaw = 0.0, 0.0
        self.views: list[View] = []
        self.on_way: list[bool] = []

    def turn(self, station: Station, floor_z: float, turns: int) -> None:
        """Takes views all around a station."""
        rate = math.radians(self._tour.turn_speed_deg)
        for _ in range(turns):
            self._take((station.x, station.y, floor_z + station.height), (0.0, 0.0), rate, on_way=False)
            self._yaw += 2.0 * math.pi / turns
            self._time += 2.0 * math.pi / turns / rate

    def walk(self, points: F64, start: Station, end: Station, floor_z: float) -> None:
        """Takes views on a way, each looking along it."""
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        length = float(arc[-1])
        stops = np.arange(1, int(length / self._tour.path_spacing) + 1) * self._tour.path_spacing
        for stop in stops[stops < length - 0.5 * self._tour.path_spacing]:
            here, ahead = (_along(points, arc, at) for at in (stop, min(stop + self._tour.path_spacing, length)))
            way = ahead - here
            self._yaw = math.atan2(way[1], way[0])
            velocity = way / max(float(np.linalg.norm(way)), 1e-9) * self._tour.speed
            height = start.height + (end.height - start.height) * stop / length
            self._take((here[0], here[1], floor_z + height), (velocity[0], velocity[1]), 0.0, on_way=True)
            self._time += self._tour.path_spacing / self._tour.speed
        self._time += self._tour.path_spacing / self._tour.speed

    def _take(self, position: tuple[float, float, float], velocity: tuple[float, float], rate: float, *, on_way: bool) -> None:
        roll, pitch = self._rng.standard_normal(2) * math.radians(self._tour.wobble_deg)
        x, y, z = map(float, position)
        yaw = math.remainder(self._yaw, 2.0 * math.pi)
        self.views.append(View(self._time, x, y, z, float(roll), float(pitch), yaw, float(velocity[0]), float(velocity[1]), rate))
        self.on_way.append(on_way)


def _along(points: F64, arc: F64, at: float) -> F64:
    return np.array([np.interp(at, arc, points[:, k]) for k in range(2)])


def _thinned(views: list[View], on_way: list[bool], most: int) -> list[View]:
    """Returns at most so many views: evenly spread ones on the way are left out first, then those at the end."""
    ways = np.flatnonzero(on_way)
    room = max(most - (len(views) - len(ways)), 0)
    if room < len(ways):
        kept = set(ways[np.linspace(0, len(ways) - 1, room).round().astype(int)].tolist()) if room else set()
        views = [v for k, v in enumerate(views) if not on_way[k] or k in kept]
    return views[:most]
