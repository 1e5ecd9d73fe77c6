"""Plans a local path along the recorded one and around obstacles: the cheapest sequence of lateral offsets over a lattice (Frenet frame).

Dynamic programming: each stage is a station along the recorded path, each state a lateral offset to its left. The cost grows with the offset,
with the change of offset, with nearness to obstacles, and most with collision. Pure geometry in the path frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges

F64 = NDArray[np.float64]
_TOLERANCE = 0.01
"""Clearance that a plan may lose where it is below ``min_clearance`` already, metres."""


@dataclass(frozen=True, slots=True)
class LatticeSettings:
    """Size of the lattice, and weights of the cost per metre of the path."""

    length: float = 2.0
    """Length of a plan along the path, metres."""
    step: float = 0.1
    """Distance between stations along the path, metres."""
    max_offset: float = 0.6
    """Largest lateral offset, metres."""
    offset_step: float = 0.05
    """Distance between lateral offsets, metres."""
    max_offset_steps: int = 3
    """Largest change of offset from one station to the next, in multiples of ``offset_step``."""
    min_clearance: float = 0.18
    """Clearance below which a state is in collision, metres: the radius of the robot and a margin."""
    inflation_distance: float = 0.15
    """Clearance beyond ``min_clearance`` within which nearness to an obstacle costs, metres."""
    offset_weight: float = 8.0
    """Cost of the lateral offset, a Huber function of it, metres: quadratic up to ``huber_offset``, then linear."""
    huber_offset: float = 0.1
    """Lateral offset from which on its cost is linear, metres."""
    slope_weight: float = 0.3
    """Cost of the squared change of offset per metre of path."""
    inflation_weight: float = 2.0
    """Cost of a state at ``min_clearance``; it falls to 0 over ``inflation_distance``."""
    collision_weight: float = 20.0
    """Cost of a state in collision; twice that in the middle of an obstacle."""
    change_weight: float = 0.5
    """Cost of the difference from the previous plan's offset, 1/m."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("length", 0.2, 20.0),
            ("step", 0.02, 1.0),
            ("max_offset", 0.0, 5.0),
            ("offset_step", 0.01, 1.0),
            ("max_offset_steps", 1, 50),
            ("min_clearance", 0.0, 5.0),
            ("inflation_distance", 0.01, 5.0),
            ("offset_weight", 0.0, 1000.0),
            ("huber_offset", 0.0, 5.0),
            ("slope_weight", 0.0, 1000.0),
            ("inflation_weight", 0.0, 1000.0),
            ("collision_weight", 0.0, 1e6),
            ("change_weight", 0.0, 1000.0),
        )


@dataclass(frozen=True, slots=True)
class LocalPlan:
    """A local path that the robot is to drive."""

    stations: F64
    """(K,), distances along the recorded path, metres."""
    offsets: F64
    """(K,), lateral offsets there, metres, positive to the left."""
    points: F64
    """(K, 2), path frame, metres."""
    clearance: F64
    """(K,), distances to the nearest obstacle, metres."""
    free_distance: float
    """Distance along the recorded path from the first station to the first collision, metres."""

    @property
    def is_free(self) -> bool:
        """Whether the plan has no collision."""
        return self.free_distance >= float(self.stations[-1] - self.stations[0])


class LatticePlanner:
    """Plans local paths one after another. It keeps the previous plan, so that the robot stays on its side of an obstacle."""

    def __init__(self, settings: LatticeSettings | None = None) -> None:
        self.settings = settings or LatticeSettings()
        count = round(self.settings.max_offset / self.settings.offset_step)
        self.offsets: F64 = np.arange(-count, count + 1, dtype=np.float64) * self.settings.offset_step
        """(J,), lateral offsets of the states, metres."""
        self._previous: tuple[F64, F64] | None = None
        """Stations and offsets of the previous plan, metres."""

    def reset(self) -> None:
        """Drops the previous plan."""
        self._previous = None

    def plan(self, stations: F64, points: F64, normals: F64, offset: float, clearance: Callable[[F64], F64]) -> LocalPlan:
        """Returns the cheapest plan. Where all plans collide, it leads into the obstacle: see ``LocalPlan.free_distance``.

        Args:
            stations: (K,), distances along the recorded path, ``step`` apart, metres; the robot is abreast of the first one.
            points: (K, 2), points of the recorded path there, path frame, metres.
            normals: (K, 2), unit vectors to the left of the recorded path there, path frame.
            offset: lateral offset of the robot, metres, positive to the left.
            clearance: returns the distances (...,) from points (..., 2), path frame, to the nearest obstacle, metres.
        """
        settings = self.settings
        states = points[:, None] + self.offsets[:, None] * normals[:, None]  # (K, J, 2)
        state_clearance = clearance(states)
        cost = self._state_cost(stations, state_clearance)
        transition = self._transition_cost()
        best, parent = np.full(len(self.offsets), np.inf), np.zeros(state_clearance.shape, dtype=np.int64)
        best[int(np.abs(self.offsets - offset).argmin())] = 0.0
        for k in range(1, len(stations)):
            total = best[:, None] + transition
            parent[k] = total.argmin(axis=0)
            best = total[parent[k], np.arange(len(best))] + settings.step * cost[k]
        chosen = [int(best.argmin())]
        for k in range(len(stations) - 1, 0, -1):
            chosen.append(int(parent[k, chosen[-1]]))
        rows, columns = np.arange(len(stations)), np.array(chosen[::-1])
        offsets, plan_clearance = self.offsets[columns], state_clearance[rows, columns]
        self._previous = stations, offsets
        free_distance = self._free_distance(stations, plan_clearance)
        return LocalPlan(stations, offsets, states[rows, columns], plan_clearance, free_distance)

    def _state_cost(self, stations: F64, clearance: F64) -> F64:
        """Returns (K, J), float64: cost of each state per metre, from its clearance (K, J), metres."""
        settings = self.settings
        inflation = (1.0 - (clearance - settings.min_clearance) / settings.inflation_distance).clip(0.0, 1.0)
        depth = (1.0 - clearance / max(settings.min_clearance, 1e-6)).clip(0.0, 1.0)
        collision = np.where(clearance < settings.min_clearance, settings.collision_weight * (1.0 + depth), 0.0)
        offset = np.abs(self.offsets)
        small = np.minimum(offset, settings.huber_offset)
        cost = settings.offset_weight * small * (2.0 * offset - small) + settings.inflation_weight * inflation**2 + collision
        if self._previous is not None:
            previous = np.interp(stations, *self._previous)
            known = stations <= self._previous[0][-1]
            cost += settings.change_weight * known[:, None] * np.abs(self.offsets - previous[:, None])
        return np.asarray(cost, dtype=np.float64)

    def _transition_cost(self) -> F64:
        """Returns (J, J), float64: cost of the transition between two offsets from one station to the next; infinite if it is too steep."""
        settings = self.settings
        change = np.abs(self.offsets[:, None] - self.offsets)
        slope = change / settings.step
        cost = settings.slope_weight * slope**2 * settings.step
        return np.where(change <= (settings.max_offset_steps + 0.5) * settings.offset_step, cost, np.inf)

    def _free_distance(self, stations: F64, clearance: F64) -> float:
        """Returns the free distance of a plan, metres. If the robot is below ``min_clearance`` already, only a smaller clearance is a collision."""
        required = np.minimum(np.maximum.accumulate(clearance), self.settings.min_clearance)
        collisions = np.flatnonzero(clearance < required - _TOLERANCE)
        return float(stations[collisions[0]] - stations[0]) if len(collisions) else float(stations[-1] - stations[0])
