"""Free space: where on a floor a robot of some radius can stand and go. Pure and deterministic.

Tasks and trials plan in it: starts and goals, paths, and obstacles that must leave a path free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.paths import PathPlanner, path_length

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
XY = tuple[float, float]

MARGIN = 0.04
"""Clearance of paths in addition to the robot's radius, metres: a path without any cannot be driven."""
_SAMPLES_PER_CELL = 4
"""Number of points of a path looked up per cell of its length."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """The free space of a robot on one floor; positions are those of the centre of its circle, map frame, metres."""

    floor: FloorMap
    radius: float
    """Radius of the robot, metres."""
    _planners: dict[float, PathPlanner] = field(default_factory=dict, init=False, repr=False)
    _regions: dict[float, Bools] = field(default_factory=dict, init=False, repr=False)
    _labels: dict[float, NDArray[np.int32]] = field(default_factory=dict, init=False, repr=False)
    _paths: dict[tuple[XY, XY], tuple[float, F64]] = field(default_factory=dict, init=False, repr=False)

    @property
    def clearance(self) -> float:
        """Distance that paths keep from obstacles, metres."""
        return self.radius + MARGIN

    @property
    def planner(self) -> PathPlanner:
        """Planner of paths that keep ``clearance``."""
        return self.planner_of(self.clearance)

    def planner_of(self, clearance: float) -> PathPlanner:
        """Returns a planner whose paths keep a clearance, metres."""
        if clearance not in self._planners:
            self._planners[clearance] = PathPlanner(self.floor, clearance)
        return self._planners[clearance]

    def with_obstacles(self, polygons: Sequence[F64] | F64) -> FreeSpace:
        """Returns the free space with further obstacles: convex polygons (P, K, 2), map frame, metres; none = this one."""
        return FreeSpace(self.floor.with_obstacles(polygons), self.radius) if len(polygons) else self

    def largest_region(self, clearance: float) -> Bools:
        """Returns a mask (H, W) of the largest region whose cells have a clearance, metres; see ``FloorMap.largest_free_region``."""
        if clearance not in self._regions:
            self._regions[clearance] = self.floor.largest_free_region(clearance)
        return self._regions[clearance]

    def regions(self, clearance: float | None = None) -> NDArray[np.int32]:
        """Returns labels (H, W) of the connected regions whose cells have a clearance, metres (None = ``clearance``); 0 = not free."""
        least = self.clearance if clearance is None else clearance
        if least not in self._labels:
            places = self.floor.free & (self.floor.distance_to_obstacle >= least)
            labels, _ = ndimage.label(places, structure=np.ones((3, 3)))
            self._labels[least] = np.asarray(labels, dtype=np.int32)
        return self._labels[least]

    def connected(self, start: XY, goal: XY, clearance: float | None = None, *, snap: bool = False) -> bool:
        """Returns whether a path connects two positions; faster than planning the path.

        Args:
            start: one position.
            goal: the other one.
            clearance: clearance of the path, metres; None = ``clearance``.
            snap: whether a position without clearance counts as the nearest one that has it; otherwise no path leads there.
        """
        labels = self.regions(clearance)
        if not snap:
            a, b = (int(self.floor.look_up(labels, position, outside=0)) for position in (start, goal))
            return a == b != 0
        cells = np.argwhere(labels > 0)
        if not len(cells):
            return False
        ends = []
        for position in (start, goal):
            nearest = cells[int(np.sum((self.floor.centers(cells) - np.asarray(position)) ** 2, axis=1).argmin())]
            ends.append(int(labels[tuple(nearest)]))
        return ends[0] == ends[1]

    def shortest(self, start: XY, goal: XY) -> tuple[float, F64]:
        """Returns the length of the shortest path, metres, and its corners (K, 2): with ``clearance`` if one exists, else without margin.

        Raises:
            SceneError: no path exists.
        """
        if (start, goal) not in self._paths:
            try:
                path = self.planner.path(start, goal)
            except SceneError:
                path = self.planner_of(self.radius).path(start, goal)
            self._paths[start, goal] = path_length(path), path
        return self._paths[start, goal]

    def contains(self, path: F64) -> bool:
        """Returns whether a path (K, 2) keeps ``clearance``."""
        allowed = self.floor.free & (self.floor.distance_to_obstacle >= self.clearance)
        for a, b in pairwise(path):
            count = int(np.linalg.norm(b - a) * _SAMPLES_PER_CELL / self.floor.resolution) + 2
            if not self.floor.look_up(allowed, a + (b - a) * np.linspace(0.0, 1.0, count)[:, None], outside=False).all():
                return False
        return True
