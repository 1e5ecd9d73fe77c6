"""Geometry of a recorded path in the path frame: stations, poses and normals along it, projection onto it, turns in place.

A station is a distance along the path. A turn in place counts, too: otherwise all its nodes would have one station.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
METRES_PER_RADIAN = 0.3
"""Weight of rotation against translation, m/rad: in stations, and in the projection onto a path that comes near itself."""
_IN_PLACE = 0.05
"""Distance between two nodes below which the robot that recorded them turned in place, metres."""
_PIVOT = 1.0
"""Least turn in place that a robot must make where it was recorded, radians; smaller ones may become arcs."""
_FREE_CHANGE = 1.0
"""Change of station since the previous projection that costs nothing, metres."""
_CHANGE_WEIGHT = 0.2
"""Cost of a change of station beyond that, in metres of distance per metre."""
_HALF_CHORD = 0.15
"""Half the length of the chord along which the direction of the path is measured, metres: recorded turns are sharp."""


class PathGeometry:
    """Polyline through the nodes of a path."""

    def __init__(self, poses: F64, distances: F64) -> None:
        """Computes the stations.

        Args:
            poses: (N, 3), float64, x, y, yaw of the nodes, path frame, metres and radians; yaw is continuous.
            distances: (N,), float64, driven distance up to each node, metres.
        """
        self.poses = poses
        """(N, 3), as given."""
        turns, steps = np.diff(poses[:, 2]), np.diff(distances)
        self._turns: F64 = np.where(steps < _IN_PLACE, turns, 0.0)
        """(N - 1,): turns in place from node to node, radians to the left; 0 elsewhere."""
        self.stations: F64 = np.concatenate([[0.0], np.cumsum(steps + METRES_PER_RADIAN * np.abs(self._turns))])
        """(N,), float64: stations of the nodes, metres."""
        self.pivots = _pivots(self._turns, self.stations)
        """First and last station of each turn in place that must be made where it was recorded, metres."""

    def station_of(self, index: float) -> float:
        """Returns the station of a node index with a fraction, metres."""
        return float(np.interp(index, np.arange(len(self.stations)), self.stations))

    def pose_at(self, station: float) -> F64:
        """Returns the pose (3,) of the path at a station, path frame, metres and radians."""
        return np.array([np.interp(station, self.stations, self.poses[:, k]) for k in range(3)])

    def points_and_normals(self, stations: F64) -> tuple[F64, F64]:
        """Returns points (K, 2), metres, and unit vectors (K, 2) to the left of the path, path frame; beyond its end it goes straight on.

        Args:
            stations: (K,), metres.
        """

        def points_at(at: F64) -> F64:
            points = np.stack([np.interp(at, self.stations, self.poses[:, k]) for k in range(2)], axis=1)
            end = self.poses[-1, 2]
            beyond = np.maximum(0.0, at - self.stations[-1])
            return np.asarray(points + beyond[:, None] * np.array([math.cos(end), math.sin(end)]))

        chord = points_at(stations + _HALF_CHORD) - points_at(np.maximum(stations - _HALF_CHORD, 0.0))
        chord /= np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-6)
        return points_at(stations), np.stack([-chord[:, 1], chord[:, 0]], axis=1)

    def project(self, pose: F64, previous: float) -> float:
        """Returns the station of the point of the path that is nearest to a robot, metres.

        Args:
            pose: (3,), x, y, yaw of the robot, path frame, metres and radians.
            previous: station of its previous projection, metres; a large change costs.
        """
        points, (x, y) = self.poses[:, :2], pose[:2]
        parts = np.diff(points, axis=0)
        squared = np.maximum((parts**2).sum(axis=1), 1e-9)
        share = np.clip((([x, y] - points[:-1]) * parts).sum(axis=1) / squared, 0.0, 1.0)
        distance = np.linalg.norm(points[:-1] + share[:, None] * parts - [x, y], axis=1)
        # Where two parts of the path are equally near, the robot is on the one with its heading.
        turned = (pose[2] - self.poses[:-1, 2] + math.pi) % (2.0 * math.pi) - math.pi
        in_place = self._turns != 0.0
        share = np.where(in_place, np.clip(turned / np.where(in_place, self._turns, 1.0), 0.0, 1.0), share)
        turned = np.abs(turned - share * self._turns)
        stations = self.stations[:-1] + share * np.diff(self.stations)
        change = np.maximum(0.0, np.abs(stations - previous) - _FREE_CHANGE)
        best = int((distance + METRES_PER_RADIAN * turned + _CHANGE_WEIGHT * change).argmin())
        return float(stations[best])


def _pivots(turns: F64, stations: F64) -> tuple[tuple[float, float], ...]:
    """Returns first and last station, metres, of each turn in place of ``_PIVOT`` or more.

    Args:
        turns: (N - 1,), turns in place from node to node, radians.
        stations: (N,), of the nodes, metres.
    """
    found, k = [], 0
    while k < len(turns):
        end = k
        while end < len(turns) and turns[end] != 0.0:
            end += 1
        if abs(turns[k:end].sum()) >= _PIVOT:
            found.append((float(stations[k]), float(stations[end])))
        k = end + 1
    return tuple(found)
