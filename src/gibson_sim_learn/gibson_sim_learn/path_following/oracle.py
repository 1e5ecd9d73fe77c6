"""Drives along a line by true poses: pure pursuit, and a way round what stands on the line. Pure."""

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
"""Distance of the points of a dense line, metres."""
ASIDE = 0.48
"""Largest distance of a way round from the line, metres: less than that within which a place of the path counts as visited."""
_BACK, _FORTH = 0.3, 1.0
"""Part of the line, behind and ahead of the last place on it, where the robot is searched for, metres."""
_EARLY = 0.4
"""Distance before and after an obstacle from which on a way round replaces the line, metres."""
_NEAR = 0.08
"""A point of a line counts as a place if one is so near, metres."""
_END = 0.04
"""Distance from the end at which a drive is over, metres."""


@dataclass(frozen=True, slots=True)
class OracleSettings:
    """How an oracle drives."""

    speed: float = 0.4
    """On straight parts, m/s."""
    max_angular: float = 0.9
    """Largest yaw rate, rad/s; it drives slower where the line would need more."""
    lookahead: float = 0.35
    """Distance along the line of the point that it steers for, metres."""
    in_place: float = 1.1
    """Angle to that point beyond which it turns in place, radians."""


class PurePursuit:
    """Follows a line from its beginning to its end by true poses.

    Args:
        line: corners (K, 2), world frame, metres.
        settings: how it drives; None = the defaults.
    """

    def __init__(self, line: ArrayLike, settings: OracleSettings | None = None) -> None:
        self.settings = settings or OracleSettings()
        self.line, self.arc = dense(line)
        self.at = 0.0
        """Place on the line, metres from its beginning."""
        self.finished = False

    def velocity(self, x: float, y: float, yaw: float) -> Velocity:
        """Returns the velocity at a pose, world frame; a stop once the end is reached."""
        settings = self.settings
        near = (self.arc >= self.at - _BACK) & (self.arc <= self.at + _FORTH)
        away = np.where(near, np.hypot(self.line[:, 0] - x, self.line[:, 1] - y), np.inf)
        self.at = float(self.arc[int(away.argmin())])
        left = float(self.arc[-1]) - self.at
        if left <= SPACING:
            # Beyond the last points: what is left along the end of the line.
            ahead = self.line[-1] - self.line[-2]
            left = float((self.line[-1] - (x, y)) @ ahead / max(float(np.linalg.norm(ahead)), 1e-9))
        self.finished = self.finished or left <= _END
        if self.finished:
            return STOP
        target = self._point(self.at + settings.lookahead)
        dx, dy = float(target[0]) - x, float(target[1]) - y
        angle = math.remainder(math.atan2(dy, dx) - yaw, 2.0 * math.pi)
        if abs(angle) > settings.in_place:
            return Velocity(0.0, math.copysign(min(settings.max_angular, abs(angle)), angle))
        curvature = 2.0 * math.sin(angle) / max(math.hypot(dx, dy), 0.1)
        linear = min(settings.speed, settings.max_angular / max(abs(curvature), 1e-6), max(0.08, left))
        return Velocity(linear, linear * curvature)

    def _point(self, at: float) -> F64:
        """Returns the point (2,) of the line at a distance from its beginning; beyond its end straight on."""
        if at > self.arc[-1]:
            ahead = self.line[-1] - self.line[-2]
            return np.asarray(self.line[-1] + ahead * ((at - self.arc[-1]) / max(float(np.linalg.norm(ahead)), 1e-9)))
        return np.array([np.interp(at, self.arc, self.line[:, k]) for k in range(2)])


def dense(line: ArrayLike) -> tuple[F64, F64]:
    """Returns points (N, 2) every ``SPACING`` metres along a line of corners (K, 2), its end included, and their distances (N,)."""
    corners = np.asarray(line, dtype=np.float64).reshape(-1, 2)
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    kept = np.concatenate([[True], lengths > 1e-9])
    corners, lengths = corners[kept], lengths[lengths > 1e-9]
    if not len(lengths):
        raise SceneError("a line needs two different points")
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, arc[-1], max(2, math.ceil(arc[-1] / SPACING) + 1))
    return np.stack([np.interp(at, arc, corners[:, k]) for k in range(2)], axis=1), at


def beside_line(floor: FloorMap, line: ArrayLike, distance: float) -> Bools:
    """Returns (H, W): the cells whose centres are within a distance of a line (K, 2), metres."""
    points, _ = dense(line)
    cells = floor.cells(points)
    inside = ((cells >= 0) & (cells < np.array(floor.shape))).all(axis=1)
    off = np.ones(floor.shape, dtype=bool)
    off[tuple(cells[inside].T)] = False
    return np.asarray(ndimage.distance_transform_edt(off) * floor.resolution <= distance)


def is_passable(floor: FloorMap, line: ArrayLike, clearance: float) -> bool:
    """Returns whether a way near a line leads from its beginning to its end that keeps a clearance from obstacles, metres."""
    points, _ = dense(line)
    on_way = _on_way(floor, points, clearance)
    return bool(on_way[-1])


def around(floor: FloorMap, line: ArrayLike, clearance: float) -> F64:
    """Returns a line (K, 2) that keeps a clearance, metres: the same, but for ways round where something stands too near.

    Raises:
        SceneError: there is no way round near the line.
    """
    points, _ = dense(line)
    on_way = _on_way(floor, points, clearance)
    if not on_way[-1]:
        raise SceneError(f"no way near the line leads to its end for a robot that keeps {clearance:g} m from obstacles")
    if on_way.all():
        return points
    near = ~beside_line(floor, line, ASIDE + clearance + 2.0 * floor.resolution)
    planner = PathPlanner(
        FloorMap(floor.resolution, floor.origin, floor.occupied | near, floor.floor, None, floor.floor_z), clearance
    )
    # A way round begins early, at a point that itself keeps the clearance.
    replaced = np.asarray(ndimage.binary_dilation(~on_way, iterations=round(_EARLY / SPACING))) | ~on_way
    replaced[[0, -1]] = False
    parts: list[F64] = []
    labels, count = ndimage.label(replaced)
    done = 0
    for k in range(1, count + 1):
        run = np.flatnonzero(labels == k)
        before = int(np.flatnonzero(on_way[: run[0]])[-1])
        after = int(run[-1]) + 1 + int(np.flatnonzero(on_way[run[-1] + 1 :])[0])
        parts += [points[done:before], planner.path(points[before], points[after])]
        done = after + 1
    parts.append(points[done:])
    return np.concatenate([part for part in parts if len(part)])


def _on_way(floor: FloorMap, points: F64, clearance: float) -> Bools:
    """Returns (N,): which points (N, 2) of a line are places, or next to one, that the robot can reach from the first one near the line."""
    places = floor.free & (floor.distance_to_obstacle >= clearance) & beside_line(floor, points, ASIDE)
    labels, count = ndimage.label(places)  # by edges alone: no way squeezes through a corner
    if not count:
        return np.zeros(len(points), dtype=bool)
    # Lines cut corners, and their ends may be a little nearer to an obstacle than ways round are.
    away, (rows, columns) = ndimage.distance_transform_edt(~places, return_indices=True)
    nearest = np.where(away * floor.resolution <= _NEAR, labels[rows, columns], 0)
    found = floor.look_up(nearest, points, outside=0)
    return np.asarray((found == found[0]) & (found != 0))
