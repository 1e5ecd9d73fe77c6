"""Where the links of all bodies are: read from the engine once for each state that anybody asks for.

A body that sleeps is not read again until it may have woken: while the engine counts just the parts of those bodies of which it is known
that they were awake, nobody else was. Where it counts others, all are read. In a world of so many bodies that nobody counts, sleepers are
asked whether they still stand perfectly still.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import turned
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.frames import F64, FrameTable
from gibson_sim.types import Pose, SceneState, Vec3

_LOOK_AGAIN = 16
"""After so many reads, all bodies are read, and with them who has fallen asleep."""
_NAP_S = 1.0
"""Nobody wakes, moves and falls asleep again in less simulation time: Bullet waits for 2 s."""


class LinkPoses:
    """Reads states, and keeps the last one until something moves."""

    def __init__(self, bullet: Bullet) -> None:
        self._bullet = bullet
        self._bodies: tuple[BodyInWorld, ...] = ()
        self._state: SceneState | None = None
        self.links: tuple[str, ...] = ()
        """Names ``<body>/<link>`` of all links, body by body, the roots first."""
        self._last: SceneState | None = None
        """What was read last; None = anything may be elsewhere since."""
        self._reads, self._unread_s = 0, 0.0
        self._all: _Selection | None = None
        """All bodies; None = they changed."""
        self._asleep: list[int] = []
        """Numbers of bodies that sleep, and were read when they did."""
        self._awake: _Selection | None = None
        """All others; None = nobody sleeps."""

    def change_bodies(self, bodies: tuple[BodyInWorld, ...], new_links: tuple[str, ...] = ()) -> None:
        """Takes up other bodies; ``new_links`` are those of a body that came last, so that thousands come quickly."""
        self._bodies = bodies
        self.links = self.links + new_links if new_links else tuple(link for one in bodies for link in one.full_links)
        self._all = None
        self.forget()

    def pass_time(self, seconds: float) -> None:
        """Call it when steps were made."""
        self._state = None
        self._unread_s += seconds

    def forget(self) -> None:
        """Call it when something was put elsewhere."""
        self._state = self._last = None

    def state(self, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the poses of all links now; its arrays are read-only and stay as they are."""
        if self._state is None:
            self._state = self._last = SceneState(stamp_ns, step, revision, self.links, *_read_only(self._read()))
        return self._state

    def state_of(self, one: BodyInWorld, stamp_ns: int, step: int, revision: int) -> SceneState:
        """Returns the poses of at least the links of one body now."""
        if self._state is not None:
            return self._state
        arrays = one.table.links(self._bullet.raw_states(one.body))
        return SceneState(stamp_ns, step, revision, one.full_links, *_read_only(arrays))

    def _read(self) -> tuple[F64, F64, F64]:
        """Returns positions, quaternions and twists of all links."""
        before, self._reads = self._last, self._reads + 1
        passed, self._unread_s = self._unread_s, 0.0
        parts, steps = self._bullet.awake.take()
        if self._all is None:
            self._all = _Selection(self._bodies, range(len(self._bodies)))
        if before is None or passed > _NAP_S or self._reads % _LOOK_AGAIN == 0:
            return self._read_all(before if passed else None)
        if self._awake is None:
            return self._all.links(self._bullet)
        found = self._awake.links(self._bullet)
        if parts != self._awake.awake_parts(found[2], steps):
            if parts < math.inf:
                return self._read_all(before)
            still = self._bullet.still([self._bodies[i].body for i in self._asleep])
            if not all(still):
                self._sleep([i for i, is_still in zip(self._asleep, still, strict=True) if is_still])
                return self._all.links(self._bullet)
        positions, quats, twists = before.positions.copy(), before.quats_xyzw.copy(), before.twists.copy()
        rows = self._awake.rows
        positions[rows], quats[rows], twists[rows] = found
        return positions, quats, twists

    def _read_all(self, before: SceneState | None) -> tuple[F64, F64, F64]:
        """Reads everybody, and finds out who sleeps since the state before; None = nobody knows."""
        assert self._all is not None, "there is a choice of all bodies"
        found = self._all.links(self._bullet)
        self._sleep([] if before is None else self._still(before, found))
        return found

    def _sleep(self, asleep: list[int]) -> None:
        """Takes note of who sleeps."""
        if asleep != self._asleep or not asleep:
            self._asleep = asleep
            others = [i for i in range(len(self._bodies)) if i not in asleep]
            self._awake = _Selection(self._bodies, others) if asleep else None

    def _still(self, before: SceneState, found: tuple[F64, F64, F64]) -> list[int]:
        """Returns the numbers of bodies that stood perfectly still at both reads, and where they were."""
        positions, quats, twists = found
        moves = (before.positions != positions).any(axis=1) | (before.quats_xyzw != quats).any(axis=1) | twists.any(axis=1)
        assert self._all is not None, "it was read just now"
        return np.flatnonzero(~self._all.of_bodies(moves)).tolist() if self._bodies else []


def _read_only(arrays: tuple[F64, F64, F64]) -> tuple[F64, F64, F64]:
    for array in arrays:
        array.setflags(write=False)
    return arrays


class _Selection:
    """Some of the bodies of a world, read together."""

    def __init__(self, bodies: Sequence[BodyInWorld], chosen: Sequence[int]) -> None:
        """Chooses bodies by their numbers."""
        ends = np.cumsum([0, *(len(one.links) for one in bodies)]).tolist()
        rows = [row for i in chosen for row in range(ends[i], ends[i + 1])]
        in_a_row = bool(rows) and rows[-1] - rows[0] == len(rows) - 1
        self.rows = slice(rows[0], rows[-1] + 1) if in_a_row else np.array(rows, dtype=np.intp)
        """Rows of the links of those that were chosen."""
        self._bodies = tuple(bodies[i] for i in chosen)
        self._table = FrameTable.joined([one.table for one in self._bodies])
        self._first_rows = np.cumsum([0, *(len(one.links) for one in self._bodies)])[:-1]
        self._parts = np.array([one.body.parts for one in self._bodies], dtype=np.float64)
        """Of each body, as the engine counts them."""
        self._restless = np.array([not one.sleeps for one in self._bodies], dtype=np.bool_)
        """Of each, whether it never sleeps."""
        self._least_parts, self._all_restless = float(self._parts[self._restless].sum()), bool(self._restless.all())

    def links(self, bullet: Bullet) -> tuple[F64, F64, F64]:
        """Returns positions, quaternions and twists of the links of those that were chosen."""
        return self._table.links(bullet.raw_states(*(one.body for one in self._bodies)))

    def of_bodies(self, of_links: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Returns for each of these bodies whether anything is true of any of its links."""
        return np.asarray(np.logical_or.reduceat(of_links, self._first_rows))

    def awake_parts(self, twists: F64, steps: int) -> float:
        """Returns how many parts of these bodies were certainly awake in each of the last steps, by the twists of their links after the last one.

        What moves was awake in that step; who never sleeps, in all.
        """
        if steps != 1 or self._all_restless:
            return self._least_parts
        moves = self.of_bodies(np.asarray(twists.any(axis=1)))
        return float(self._parts[moves | self._restless].sum())


def link_pose(state: SceneState, link: str) -> Pose:
    """Returns T_world_link; ``link``: its whole name, ``<body>/<link>``."""
    row = state.links.index(link)
    x, y, z = state.positions[row].tolist()
    qx, qy, qz, qw = state.quats_xyzw[row].tolist()
    return Pose((x, y, z), (qx, qy, qz, qw))


def link_twist(state: SceneState, link: str) -> tuple[Vec3, Vec3]:
    """Returns linear (m/s) and angular (rad/s) velocity of the link's origin against the world, in the LINK's frame."""
    row = state.links.index(link)
    x, y, z, w = state.quats_xyzw[row].tolist()
    *linear, p, q, r = state.twists[row].tolist()
    inverse = (-x, -y, -z, w)
    return turned(inverse, (linear[0], linear[1], linear[2])), turned(inverse, (p, q, r))
