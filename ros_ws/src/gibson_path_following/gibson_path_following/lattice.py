"""A way along a path and around what stands on it: the cheapest one over a lattice of distances along the path and offsets from it.

Dynamic programming: each stage is a step along the path, each state an offset to its left. Offsets cost, changes of offset cost, nearness to
things costs, touching them costs most. Pure geometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges

F64 = NDArray[np.float64]
_TOLERANCE = 0.01
"""Clearance that a way may lose where it is too near to a thing already, metres."""


@dataclass(frozen=True, slots=True)
class LatticeSettings:
    """The lattice, and what a way costs per metre of the path."""

    length: float = 2.0
    """How far ahead a way leads, metres of the path."""
    step: float = 0.1
    """Between stages, metres of the path."""
    most_offset: float = 0.6
    """Largest distance from the path, metres."""
    offset_step: float = 0.05
    """Between offsets, metres."""
    steepest: int = 3
    """Largest change of offset from one stage to the next, in steps of offset."""
    room: float = 0.18
    """Clearance below which a place is blocked, metres: the robot's radius, and a little."""
    comfort: float = 0.15
    """Clearance beyond that within which nearness costs, metres."""
    offset_weight: float = 8.0
    """Cost of an offset, by its square in metres; from ``small_offset`` on it grows linearly."""
    small_offset: float = 0.1
    """Metres."""
    slope_weight: float = 0.3
    """Cost of a change of offset, by the square of its slope."""
    near_weight: float = 2.0
    """Cost of a place that is all but blocked."""
    blocked_weight: float = 20.0
    """Cost of a blocked place; twice that in the middle of a thing."""
    change_weight: float = 0.5
    """Cost of another offset than the way before had there, by the difference in metres."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("length", 0.2, 20.0),
            ("step", 0.02, 1.0),
            ("most_offset", 0.0, 5.0),
            ("offset_step", 0.01, 1.0),
            ("steepest", 1, 50),
            ("room", 0.0, 5.0),
            ("comfort", 0.01, 5.0),
            ("offset_weight", 0.0, 1000.0),
            ("small_offset", 0.0, 5.0),
            ("slope_weight", 0.0, 1000.0),
            ("near_weight", 0.0, 1000.0),
            ("blocked_weight", 0.0, 1e6),
            ("change_weight", 0.0, 1000.0),
        )


@dataclass(frozen=True, slots=True)
class Way:
    """A way along a path."""

    along: F64
    """(K,), places on the path, metres."""
    offsets: F64
    """(K,), to the left of the path there, metres."""
    points: F64
    """(K, 2), in the frame of the path, metres."""
    clearance: F64
    """(K,), distances to the nearest thing, metres."""
    free: float
    """Distance along the path up to which nothing blocks it, metres from its beginning."""

    @property
    def is_free(self) -> bool:
        """Whether nothing blocks it."""
        return self.free >= float(self.along[-1] - self.along[0])


class Lattice:
    """Finds ways, one after another; it remembers the one before, so that it does not change sides."""

    def __init__(self, settings: LatticeSettings | None = None) -> None:
        self.settings = settings or LatticeSettings()
        count = round(self.settings.most_offset / self.settings.offset_step)
        self.offsets: F64 = np.arange(-count, count + 1, dtype=np.float64) * self.settings.offset_step
        """Of the states, metres."""
        self._before: tuple[F64, F64] | None = None
        """Places and offsets of the way before."""

    def reset(self) -> None:
        """Forgets the way before."""
        self._before = None

    def way(self, along: F64, points: F64, normals: F64, offset: float, clearance: Callable[[F64], F64]) -> Way:
        """Returns the cheapest way. If all are blocked, it leads into what blocks it: see ``Way.free``.

        Args:
            along: (K,), places on the path, ``step`` apart, metres; the robot is level with the first one.
            points: (K, 2), where they are.
            normals: (K, 2), unit vectors to the left of the path there.
            offset: of the robot, to the left of the path, metres.
            clearance: returns distances (...,) from points (..., 2) to the nearest thing, metres.
        """
        settings = self.settings
        places = points[:, None] + self.offsets[:, None] * normals[:, None]  # (K, J, 2)
        room = clearance(places)
        cost = self._place_cost(along, room)
        move = self._move_cost()
        best, frm = np.full(len(self.offsets), np.inf), np.zeros(room.shape, dtype=np.int64)
        best[int(np.abs(self.offsets - offset).argmin())] = 0.0
        for k in range(1, len(along)):
            total = best[:, None] + move
            frm[k] = total.argmin(axis=0)
            best = total[frm[k], np.arange(len(best))] + settings.step * cost[k]
        states = [int(best.argmin())]
        for k in range(len(along) - 1, 0, -1):
            states.append(int(frm[k, states[-1]]))
        rows, states_of = np.arange(len(along)), np.array(states[::-1])
        offsets, kept = self.offsets[states_of], room[rows, states_of]
        self._before = along, offsets
        return Way(along, offsets, places[rows, states_of], kept, self._free(along, kept))

    def _place_cost(self, along: F64, room: F64) -> F64:
        """Returns (K, J): what a metre at each place costs."""
        settings = self.settings
        near = (1.0 - (room - settings.room) / settings.comfort).clip(0.0, 1.0)
        depth = (1.0 - room / max(settings.room, 1e-6)).clip(0.0, 1.0)
        blocked = np.where(room < settings.room, settings.blocked_weight * (1.0 + depth), 0.0)
        off = np.abs(self.offsets)
        small = np.minimum(off, settings.small_offset)
        cost = settings.offset_weight * small * (2.0 * off - small) + settings.near_weight * near**2 + blocked
        if self._before is not None:
            before = np.interp(along, *self._before)
            known = along <= self._before[0][-1]
            cost += settings.change_weight * known[:, None] * np.abs(self.offsets - before[:, None])
        return np.asarray(cost, dtype=np.float64)

    def _move_cost(self) -> F64:
        """Returns (J, J): what going from one offset to another costs, in one stage."""
        settings = self.settings
        change = np.abs(self.offsets[:, None] - self.offsets)
        slope = change / settings.step
        cost = settings.slope_weight * slope**2 * settings.step
        return np.where(change <= (settings.steepest + 0.5) * settings.offset_step, cost, np.inf)

    def _free(self, along: F64, room: F64) -> float:
        """Returns how far a way is free, metres. Where the robot stands too near to a thing already, only nearer places block it."""
        reached = np.minimum(np.maximum.accumulate(room), self.settings.room)
        blocked = np.flatnonzero(room < reached - _TOLERANCE)
        return float(along[blocked[0]] - along[0]) if len(blocked) else float(along[-1] - along[0])
