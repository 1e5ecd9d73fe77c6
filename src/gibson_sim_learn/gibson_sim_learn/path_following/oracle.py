"""Follows a line by true poses: pure pursuit, and detours around obstacles on the line. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gibson_path_following.types import STOP, Velocity
from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.paths import PathPlanner

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
SPACING = 0.05
"""Distance between the points of a resampled line, metres."""
MAX_DETOUR = 0.48
"""Largest distance of a detour from the line, metres: less than the arrival radius of a node."""
_SEARCH_BEHIND, _SEARCH_AHEAD = 0.3, 1.0
"""Distances along the line, behind and ahead of the previous station, within which the robot is projected onto it, metres."""
_DETOUR_MARGIN = 0.4
"""Distance along the line before and after an obstacle that a detour replaces, too, metres."""
_SNAP_DISTANCE = 0.08
"""Distance from a traversable cell within which a point of a line counts as traversable, metres."""
_END = 0.04
"""Distance from the end at which the drive is finished, metres."""


@dataclass(frozen=True, slots=True)
class OracleSettings:
    """Limits of an oracle, and its lookahead."""

    max_linear: float = 0.4
    """Speed on straight parts, m/s."""
    max_angular: float = 0.9
    """Largest yaw rate, rad/s; it limits the speed in turns."""
    lookahead_distance: float = 0.35
    """Distance along the line of the goal point, metres."""
    rotate_in_place_bearing: float = 1.1
    """Bearing of the goal point beyond which it rotates in place, radians."""


class PurePursuit:
    """Follows a line from its beginning to its end by true poses.

    Args:
        line: corners (K, 2), world frame, metres.
        settings: None = the defaults.
    """

    def __init__(self, line: ArrayLike, settings: OracleSettings | None = None) -> None:
        self.settings = settings or OracleSettings()
        self.line, self.stations = resampled(line)
        self.station = 0.0
        """Distance along the line of the robot, metres."""
        self.finished = False

    def velocity(self, x: float, y: float, yaw: float) -> Velocity:
        """Returns the velocity at a pose, world frame, metres and radians; a stop from the end on."""
        settings = self.settings
        near = (self.stations >= self.station - _SEARCH_BEHIND) & (self.stations <= self.station + _SEARCH_AHEAD)
        distance = np.where(near, np.hypot(self.line[:, 0] - x, self.line[:, 1] - y), np.inf)
        self.station = float(self.stations[int(distance.argmin())])
        remaining = float(self.stations[-1]) - self.station
        if remaining <= SPACING:
            # Near the end: the distance along the last segment.
            ahead = self.line[-1] - self.line[-2]
            remaining = float((self.line[-1] - (x, y)) @ ahead / max(float(np.linalg.norm(ahead)), 1e-9))
        self.finished = self.finished or remaining <= _END
        if self.finished:
            return STOP
        target = self._point(self.station + settings.lookahead_distance)
        dx, dy = float(target[0]) - x, float(target[1]) - y
        bearing = math.remainder(math.atan2(dy, dx) - yaw, 2.0 * math.pi)
        if abs(bearing) > settings.rotate_in_place_bearing:
            return Velocity(0.0, math.copysign(min(settings.max_angular, abs(bearing)), bearing))
        curvature = 2.0 * math.sin(bearing) / max(math.hypot(dx, dy), 0.1)
        linear = min(settings.max_linear, settings.max_angular / max(abs(curvature), 1e-6), max(0.08, remaining))
        return Velocity(linear, linear * curvature)

    def _point(self, station: float) -> F64:
        """Returns the point (2,) of the line at a station, world frame, metres; beyond its end the line goes straight on."""
        if station > self.stations[-1]:
            ahead = self.line[-1] - self.line[-2]
            return np.asarray(self.line[-1] + ahead * ((station - self.stations[-1]) / max(float(np.linalg.norm(ahead)), 1e-9)))
        return np.array([np.interp(station, self.stations, self.line[:, k]) for k in range(2)])


def resampled(line: ArrayLike) -> tuple[F64, F64]:
    """Returns points (N, 2) every ``SPACING`` metres along a line of corners (K, 2), end included, and their stations (N,), metres."""
    corners = np.asarray(line, dtype=np.float64).reshape(-1, 2)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    kept = np.concatenate([[True], lengths > 1e-9])
    corners, lengths = corners[kept], lengths[lengths > 1e-9]
    if not len(lengths):
        raise SceneError("a line needs two different points")
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, arc[-1], max(2, math.ceil(arc[-1] / SPACING) + 1))
    return np.stack([np.interp(at, arc, corners[:, k]) for k in range(2)], axis=1), at


def near_line(floor: FloorMap, line: ArrayLike, distance: float) -> Bools:
    """Returns (H, W), bool: the cells whose centres are within a distance of a line (K, 2), world frame, metres."""
    points, _ = resampled(line)
    cells = floor.cells(points)
    inside = ((cells >= 0) & (cells < np.array(floor.shape))).all(axis=1)
    off = np.ones(floor.shape, dtype=bool)
    off[tuple(cells[inside].T)] = False
    return np.asarray(ndimage.distance_transform_edt(off) * floor.resolution <= distance)


def is_passable(floor: FloorMap, line: ArrayLike, clearance: float) -> bool:
    """Returns whether a detour near a line (K, 2) leads from its beginning to its end with a clearance, metres."""
    points, _ = resampled(line)
    reachable = _reachable(floor, points, clearance)
    return bool(reachable[-1])


def avoid_obstacles(floor: FloorMap, line: ArrayLike, clearance: float) -> F64:
    """Returns a line (M, 2) with a clearance, metres: the given one (K, 2), with detours around obstacles that are too near.

    Raises:
        SceneError: there is no detour near the line.
    """
    points, _ = resampled(line)
    reachable = _reachable(floor, points, clearance)
    if not reachable[-1]:
        raise SceneError(f"no way near the line leads to its end for a robot that keeps {clearance:g} m from obstacles")
    if reachable.all():
        return points
    near = ~near_line(floor, line, MAX_DETOUR + clearance + 2.0 * floor.resolution)
    planner = PathPlanner(
        FloorMap(floor.resolution, floor.origin, floor.occupied | near, floor.floor, None, floor.floor_z), clearance
    )
    # A detour begins early, at a point that itself has the clearance.
    replaced = np.asarray(ndimage.binary_dilation(~reachable, iterations=round(_DETOUR_MARGIN / SPACING))) | ~reachable
    replaced[[0, -1]] = False
    parts: list[F64] = []
    labels, count = ndimage.label(replaced)
    done = 0
    for k in range(1, count + 1):
        run = np.flatnonzero(labels == k)
        before = int(np.flatnonzero(reachable[: run[0]])[-1])
        after = int(run[-1]) + 1 + int(np.flatnonzero(reachable[run[-1] + 1 :])[0])
        parts += [points[done:before], planner.path(points[before], points[after])]
        done = after + 1
    parts.append(points[done:])
    return np.concatenate([part for part in parts if len(part)])


def _reachable(floor: FloorMap, points: F64, clearance: float) -> Bools:
    """Returns (N,), bool: which points (N, 2) of a line the robot can reach from the first one, near the line and with a clearance, metres."""
    traversable = floor.free & (floor.distance_to_obstacle >= clearance) & near_line(floor, points, MAX_DETOUR)
    labels, count = ndimage.label(traversable)  # 4-connected: no detour squeezes through a corner
    if not count:
        return np.zeros(len(points), dtype=bool)
    # Lines cut corners, and their ends may be a little nearer to an obstacle than detours are.
    distance, (rows, columns) = ndimage.distance_transform_edt(~traversable, return_indices=True)
    nearest = np.where(distance * floor.resolution <= _SNAP_DISTANCE, labels[rows, columns], 0)
    found = floor.look_up(nearest, points, outside=0)
    return np.asarray((found == found[0]) & (found != 0))
