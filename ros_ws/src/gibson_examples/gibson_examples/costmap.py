"""The costmap: the static map, and obstacles that the lidar sees in addition. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, I64, Bools
from gibson_examples.grid import Grid, distance_to


@dataclass(frozen=True, slots=True)
class CostmapSettings:
    """Clearance and cost around obstacles, and which hits of a scan count as obstacles."""

    robot_radius: float = 0.18
    """Metres."""
    margin: float = 0.05
    """Extra clearance around the robot for planning, metres."""
    inflation: float = 0.5
    """Distance from the robot's rim within which obstacles raise the cost, metres."""
    steepness: float = 6.0
    """Exponential decay of this cost with distance, 1/m."""
    weight: float = 4.0
    """Cost at the smallest clearance: metres of detour that a metre along an obstacle is worth."""
    range: float = 3.5
    """Obstacles come from the scan up to this distance, metres."""
    map_tolerance: float = 0.2
    """A hit within this distance of an obstacle of the map is that obstacle: localisation errors must not close doorways. Metres."""
    persistence_s: float = 8.0
    """Lifetime of an obstacle since it was last seen, seconds."""

    def __post_init__(self) -> None:
        for name in ("robot_radius", "inflation", "range", "steepness"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingError(f"costmap: {name} is {getattr(self, name):g}, must be a finite number above 0")


class Costmap:
    """A static layer from the map, an obstacle layer from scans, and the distance to the nearest obstacle of either."""

    def __init__(self, grid: Grid, settings: CostmapSettings | None = None) -> None:
        self.grid = grid
        self.settings = settings or CostmapSettings()
        self._static = distance_to(grid.occupied, grid.resolution)
        self._blocked_by_map = grid.occupied | grid.unknown
        self._static_clearance = distance_to(self._blocked_by_map, grid.resolution)
        self._seen_s = np.full(grid.shape, -np.inf)
        self._clearance = self._static_clearance

    @property
    def clearance(self) -> F64:
        """(H, W), metres from the centre of a cell to the nearest obstacle, 0 in obstacles and unknown cells. Do not modify."""
        return self._clearance

    def clearance_at(self, xy: ArrayLike) -> F64:
        """Returns the clearance, metres, at points (..., 2) in the map frame; 0 outside the map."""
        return self.grid.values(self._clearance, xy, 0.0)

    def obstacles(self, now_s: float) -> Bools:
        """Returns (H, W): cells with obstacles of scans that are not in the map."""
        return np.asarray(self._seen_s >= now_s - self.settings.persistence_s)

    def forget_obstacles(self) -> None:
        """Empties the obstacle layer."""
        self._seen_s.fill(-np.inf)
        self._clearance = self._static_clearance

    def add_scan(self, sensor_xy: ArrayLike, ends_xy: ArrayLike, hits: Bools, now_s: float) -> None:
        """Clears the cells along the beams and marks the cells at their hits.

        Args:
            sensor_xy: (2,), origin of the beams, map frame, metres.
            ends_xy: (N, 2), ends of the beams: at a hit, or at the maximum range.
            hits: (N,), whether a beam ends at a hit.
            now_s: time of the scan, seconds.
        """
        sensor, ends = np.asarray(sensor_xy, dtype=np.float64), np.asarray(ends_xy, dtype=np.float64)
        along = ends - sensor
        length = np.hypot(along[:, 0], along[:, 1])
        reach = self.settings.range
        scale = np.minimum(1.0, reach / np.maximum(length, 1e-9))
        self._clear(sensor, along * scale[:, None], np.minimum(length, reach))
        marks = self.grid.cells(ends[hits & (length <= reach)])
        marks = marks[self.grid.inside(marks)]
        marks = marks[self._static[marks[:, 0], marks[:, 1]] > self.settings.map_tolerance]
        self._seen_s[marks[:, 0], marks[:, 1]] = now_s
        self._refresh(now_s)

    def _clear(self, sensor: F64, along: F64, length: F64) -> None:
        """Removes obstacles from the cells along the beams, up to one cell before the end."""
        if not np.isfinite(self._seen_s).any():
            return
        step = self.grid.resolution
        distances = np.arange(0.0, self.settings.range, step)
        fractions = distances[None, :] / np.maximum(length, 1e-9)[:, None]
        points = (sensor + fractions[:, :, None] * along[:, None, :])[distances[None, :] < (length - 1.5 * step)[:, None]]
        cells = self.grid.cells(points)
        cells = cells[self.grid.inside(cells)]
        self._seen_s[cells[:, 0], cells[:, 1]] = -np.inf

    def _refresh(self, now_s: float) -> None:
        """Recomputes the clearance in the part of the map that obstacles of scans can change."""
        obstacles = self.obstacles(now_s)
        cells = np.argwhere(obstacles)
        if not len(cells):
            self._clearance = self._static_clearance
            return
        s = self.settings
        reach = math.ceil((s.robot_radius + s.margin + s.inflation) / self.grid.resolution) + 1
        (top, left), (bottom, right) = np.maximum(cells.min(axis=0) - reach, 0), cells.max(axis=0) + reach + 1
        part = np.s_[top:bottom, left:right]
        clearance = self._static_clearance.copy()
        clearance[part] = np.minimum(clearance[part], distance_to(obstacles[part], self.grid.resolution))
        self._clearance = clearance

    def cost(self) -> F64:
        """Returns (H, W): cost of a path through a cell per metre, in addition to its length; inf = impassable."""
        s = self.settings
        beyond = self._clearance - (s.robot_radius + s.margin)
        cost = np.where(beyond < s.inflation, s.weight * np.exp(-s.steepness * np.maximum(beyond, 0.0)), 0.0)
        return np.where(beyond < 0.0, np.inf, cost)

    def nearest_passable(self, xy: tuple[float, float], within: float) -> I64 | None:
        """Returns row and column, (2,), of the passable cell nearest to a point; None if there is none ``within`` metres."""
        s, grid = self.settings, self.grid
        own = grid.cells(xy)
        if self.clearance_at(xy) >= s.robot_radius + s.margin:
            return own
        row, column = (int(v) for v in own)
        reach = math.ceil(within / grid.resolution) + 1
        top, left = max(row - reach, 0), max(column - reach, 0)
        part = self._clearance[top : max(row + reach + 1, 0), left : max(column + reach + 1, 0)]
        cells = np.argwhere(part >= s.robot_radius + s.margin) + np.array([top, left])
        if not len(cells):
            return None
        distances = np.linalg.norm(grid.centers(cells) - np.asarray(xy), axis=1)
        best = int(np.argmin(distances))
        return np.asarray(cells[best]) if distances[best] <= within + grid.resolution else None
