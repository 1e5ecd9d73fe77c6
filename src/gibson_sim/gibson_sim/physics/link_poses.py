"""Poses of the links of all bodies, read from the engine once per requested state.

A sleeping body is not read again until it may have woken. If the engine reports exactly the solver bodies of the bodies known to be active, no
other body was active; otherwise all bodies are read. With too many bodies for the engine's report, the sleeping ones are checked for velocities of
exactly 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import rotated
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.frames import F64, FrameTable
from gibson_sim.types import Pose, SceneState, Vec3

_READ_ALL_EVERY = 16
"""Number of reads after which all bodies are read, to find bodies that have fallen asleep."""
_NAP_S = 1.0
"""Simulation time, s, in which no body can wake, move and fall asleep again: Bullet waits for 2 s."""


class LinkPoses:
    """Reads states, and caches the last one until time passes or a body is moved."""

    def __init__(self, bullet: Bullet) -> None:
        self._bullet = bullet
        self._bodies: tuple[BodyInWorld, ...] = ()
        self._state: SceneState | None = None
        self.links: tuple[str, ...] = ()
        """Names ``<body>/<link>`` of all links, body by body, the roots first."""
        self._last: SceneState | None = None
        """State read last; None = any body may have been moved since."""
        self._reads, self._unread_s = 0, 0.0
        """Number of reads, and simulation time since the last read, s."""
        self._all: _Selection | None = None
        """All bodies; None = outdated, since bodies were added or removed."""
        self._asleep: list[int] = []
        """Indices of the sleeping bodies that have been read since they fell asleep."""
        self._active: _Selection | None = None
        """All other bodies; None = no body is known to sleep."""

    def change_bodies(self, bodies: tuple[BodyInWorld, ...], new_links: tuple[str, ...] = ()) -> None:
        """Sets the bodies; ``new_links`` are the links of a body appended last, so that adding thousands of bodies is fast."""
        self._bodies = bodies
        self.links = self.links + new_links if new_links else tuple(link for body in bodies for link in body.full_links)
        self._all = None
        self.forget()

    def pass_time(self, seconds: float) -> None:
        """Invalidates the state after ``seconds`` of simulation time."""
        self._state = None
        self._unread_s += seconds

    def forget(self) -> None:
        """Invalidates all states read so far, since a body was moved."""
        self._state = self._last = None

    def state(self, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the current poses of all links; the arrays are read-only and do not change later."""
        if self._state is None:
            self._state = self._last = SceneState(stamp_ns, step, revision, self.links, *_read_only(self._read()))
        return self._state

    def state_of(self, body: BodyInWorld, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the current poses of at least the links of one body."""
        if self._state is not None:
            return self._state
        arrays = body.table.links(self._bullet.raw_states(body.engine_body))
        return SceneState(stamp_ns, step, revision, body.full_links, *_read_only(arrays))

    def _read(self) -> tuple[F64, F64, F64]:
        """Returns positions, quaternions and twists of all links."""
        last, self._reads = self._last, self._reads + 1
        passed, self._unread_s = self._unread_s, 0.0
        active, steps = self._bullet.active_bodies.pop_peak()
        if self._all is None:
            self._all = _Selection(self._bodies, range(len(self._bodies)))
        if last is None or passed > _NAP_S or self._reads % _READ_ALL_EVERY == 0:
            return self._read_all(last if passed else None)
        if self._active is None:
            return self._all.links(self._bullet)
        read = self._active.links(self._bullet)
        if active != self._active.solver_bodies(read[2], steps):
            if active < math.inf:
                return self._read_all(last)
            at_rest = self._bullet.at_rest([self._bodies[i].engine_body for i in self._asleep])
            if not all(at_rest):
                self._set_asleep([i for i, rests in zip(self._asleep, at_rest, strict=True) if rests])
                return self._all.links(self._bullet)
        positions, quats, twists = last.positions.copy(), last.quats_xyzw.copy(), last.twists.copy()
        rows = self._active.rows
        positions[rows], quats[rows], twists[rows] = read
        return positions, quats, twists

    def _read_all(self, last: SceneState | None) -> tuple[F64, F64, F64]:
        """Reads all bodies, and finds those that have slept since the state ``last``; None = no body is known to sleep."""
        assert self._all is not None, "_read creates it first"
        read = self._all.links(self._bullet)
        self._set_asleep([] if last is None else self._at_rest(last, read))
        return read

    def _set_asleep(self, asleep: list[int]) -> None:
        """Sets the sleeping bodies, by index."""
        if asleep != self._asleep or not asleep:
            self._asleep = asleep
            others = [i for i in range(len(self._bodies)) if i not in asleep]
            self._active = _Selection(self._bodies, others) if asleep else None

    def _at_rest(self, last: SceneState, read: tuple[F64, F64, F64]) -> list[int]:
        """Returns the indices of the bodies with equal poses in both reads and velocities of exactly 0."""
        positions, quats, twists = read
        moves = (last.positions != positions).any(axis=1) | (last.quats_xyzw != quats).any(axis=1) | twists.any(axis=1)
        assert self._all is not None, "_read creates it first"
        return np.flatnonzero(~self._all.of_bodies(moves)).tolist() if self._bodies else []


def _read_only(arrays: tuple[F64, F64, F64]) -> tuple[F64, F64, F64]:
    for array in arrays:
        array.setflags(write=False)
    return arrays


class _Selection:
    """A selection of the bodies of a world, read together."""

    def __init__(self, bodies: Sequence[BodyInWorld], selected: Sequence[int]) -> None:
        """Selects bodies by their indices."""
        ends = np.cumsum([0, *(len(body.links) for body in bodies)]).tolist()
        rows = [row for i in selected for row in range(ends[i], ends[i + 1])]
        contiguous = bool(rows) and rows[-1] - rows[0] == len(rows) - 1
        self.rows = slice(rows[0], rows[-1] + 1) if contiguous else np.array(rows, dtype=np.intp)
        """Rows of the selected bodies' links among all links."""
        self._bodies = tuple(bodies[i] for i in selected)
        self._table = FrameTable.joined([body.table for body in self._bodies])
        self._first_rows = np.cumsum([0, *(len(body.links) for body in self._bodies)])[:-1]
        self._solver_bodies = np.array([body.engine_body.solver_bodies for body in self._bodies], dtype=np.float64)
        """Number of solver bodies of each body; NaN = unknown."""
        self._sleepless = np.array([not body.sleeps for body in self._bodies], dtype=np.bool_)
        """Whether each body never sleeps."""
        self._sleepless_count, self._all_sleepless = (
            float(self._solver_bodies[self._sleepless].sum()),
            bool(self._sleepless.all()),
        )

    def links(self, bullet: Bullet) -> tuple[F64, F64, F64]:
        """Returns positions, quaternions and twists of the selected bodies' links."""
        return self._table.links(bullet.raw_states(*(body.engine_body for body in self._bodies)))

    def of_bodies(self, of_links: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Returns for each selected body whether ``of_links`` is true for any of its links."""
        return np.asarray(np.logical_or.reduceat(of_links, self._first_rows))

    def solver_bodies(self, twists: F64, steps: int) -> float:
        """Returns the number of solver bodies that were certainly active in each of the last steps, from the twists after the last step.

        A moving body was active in the last step; a body that never sleeps was active in all steps.
        """
        if steps != 1 or self._all_sleepless:
            return self._sleepless_count
        moves = self.of_bodies(np.asarray(twists.any(axis=1)))
        return float(self._solver_bodies[moves | self._sleepless].sum())


def link_pose(state: SceneState, link: str) -> Pose:
    """Returns T_world_link of a link by its full name, ``<body>/<link>``."""
    row = state.links.index(link)
    x, y, z = state.positions[row].tolist()
    qx, qy, qz, qw = state.quats_xyzw[row].tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def link_twist(state: SceneState, link: str) -> tuple[Vec3, Vec3]:
    """Returns linear (m/s) and angular (rad/s) velocity of the link's origin relative to the world, in the LINK's frame."""
    row = state.links.index(link)
    x, y, z, w = state.quats_xyzw[row].tolist()
    *linear, p, q, r = state.twists[row].tolist()
    inverse = (-x, -y, -z, w)
    return rotated(inverse, (linear[0], linear[1], linear[2])), rotated(inverse, (p, q, r))
