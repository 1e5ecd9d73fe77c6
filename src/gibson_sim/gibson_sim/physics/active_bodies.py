"""Which bodies were active in the last steps, from the sizes of the islands that the engine solved.

In every step Bullet gathers what may touch, or is held together, in islands; it solves those with an active body, and nothing in any
other one moves. With its reports on, a step tells how many parts of bodies each solved island has: every link of a body is a part, and so is
a root that is not fixed. If the bodies known to be active have exactly that many links, no other body was active.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from gibson_sim.physics.engine import pybullet as p
from gibson_sim.physics.engine_types import BulletBody

_SLEEP_THRESHOLD = 5e-5
"""Sum of the squares of all speeds (m/s, rad/s) of a body below which it falls asleep after 2 s: a few millimetres a second."""
_BESIDE = 0.02
"""Metres between the boxes about two bodies that may rest on each other."""


class Sleepers:
    """The bodies of one engine that may fall asleep, by the engine's numbers."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._may_sleep: set[int] = set()
        self._waking: set[int] = set()
        """Those that must not sleep on in the next step."""
        self._thrown: dict[int, tuple[list[float], list[float]]] = {}
        """Those that were given a velocity since the last step, with that of the centre of mass (m/s) and the angular one (rad/s)."""

    def add(self, body: BulletBody) -> None:
        """Lets a body fall asleep when it rests."""
        self._may_sleep.add(body.uid)
        p.changeDynamics(
            body.uid,
            -1,
            activationState=p.ACTIVATION_STATE_ENABLE_SLEEPING,
            sleepThreshold=_SLEEP_THRESHOLD,
            physicsClientId=self._client,
        )

    def remove(self, body: BulletBody) -> None:
        """Forgets a body that is about to be taken away, and wakes what lies beside it."""
        self.wake_beside(body)
        self._may_sleep.discard(body.uid)
        self._waking.discard(body.uid)
        self._thrown.pop(body.uid, None)

    def wake(self, body: BulletBody) -> None:
        """Lets the body not sleep on in the next step."""
        if body.uid in self._may_sleep:
            self._waking.add(body.uid)

    def wake_beside(self, body: BulletBody) -> None:
        """The same for the body and for what lies beside it where it is now."""
        if not self._may_sleep:
            return
        self.wake(body)
        for link in (-1, *body.link_indices):
            low, high = p.getAABB(body.uid, link, physicsClientId=self._client)
            low, high = [c - _BESIDE for c in low], [c + _BESIDE for c in high]
            found = p.getOverlappingObjects(low, high, physicsClientId=self._client) or ()
            self._waking.update(uid for uid, _ in found if uid in self._may_sleep)

    def throw(self, body: BulletBody, linear: list[float], angular: list[float]) -> None:
        """Wakes a body that was just given velocities: of its centre of mass (m/s), and angular (rad/s), world frame."""
        if body.uid in self._may_sleep:
            self._waking.add(body.uid)
            self._thrown[body.uid] = (linear, angular)

    def wake_what_must(self) -> None:
        """Call it before a step."""
        for uid in sorted(self._waking):
            p.changeDynamics(uid, -1, activationState=p.ACTIVATION_STATE_WAKE_UP, physicsClientId=self._client)
        self._waking.clear()

    def throw_again(self) -> None:
        """Call it after a step: who slept stands still in the step that wakes it, and forgets how it was thrown."""
        for uid, (linear, angular) in self._thrown.items():
            if not any(map(any, p.getBaseVelocity(uid, physicsClientId=self._client))):
                p.resetBaseVelocity(uid, linear, angular, physicsClientId=self._client)
        self._thrown.clear()


_MOST_ISLANDS = 64
"""PyBullet has room for the reports of so many, and reads beyond it where there are more."""


def parts_of(uid: int, links: int, client: int) -> float:
    """Returns how many parts of a body can be awake; NaN = nobody knows.

    Args:
        uid: its number.
        links: how many it has below its root.
        client: whose it is.
    """
    if p.getDynamicsInfo(uid, -1, client)[0] > 0.0:
        return links + 1
    # The root is fixed, and so may be what hangs on it by joints that do not move.
    fixed = any(p.getJointInfo(uid, i, client)[2] == p.JOINT_FIXED for i in range(links))
    return math.nan if fixed else links


class ActiveBodies:
    """Counts awake parts step by step."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._reports = False
        self._most, self._steps = 0.0, 0

    def change_bodies(self, count: int) -> None:
        """Call it when there are ``count`` bodies, not counting static shapes: each is in one island only."""
        reports = count <= _MOST_ISLANDS
        if reports != self._reports:
            p.setPhysicsEngineParameter(reportSolverAnalytics=int(reports), physicsClientId=self._client)
        self._reports = reports

    def add_step(self, islands: Sequence[dict[str, Any]]) -> None:
        """Takes in what a step reported."""
        parts = sum([island["numBodies"] for island in islands]) if self._reports else math.inf
        self._steps += 1
        if parts > self._most:
            self._most = parts

    def take(self) -> tuple[float, int]:
        """Returns how many parts were awake in that step since the last call in which most were, and the number of these steps."""
        taken = self._most, self._steps
        self._most, self._steps = 0.0, 0
        return taken
