"""Active and sleeping bodies of an engine: counts active bodies, and wakes sleeping ones.

In every step Bullet groups bodies that may touch, or are connected, into islands. It solves only islands with an active body; bodies in other
islands do not move. With solver analytics on, a step reports the number of *solver bodies* of each solved island: every link of a body is one, and
so is a root that is not fixed. If the bodies known to be active have exactly that many solver bodies, no other body was active.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from gibson_sim.physics.engine import pybullet as p
from gibson_sim.physics.engine_types import BulletBody

_MAX_ISLANDS = 64
"""Capacity of PyBullet's report, islands; with more islands it reads beyond the end of the report."""
_SLEEP_THRESHOLD = 5e-5
"""Sum of the squares of all speeds (m/s, rad/s) of a body below which it falls asleep after 2 s: a few millimetres per second."""
_BESIDE = 0.02
"""Distance between the bounding boxes of two bodies that may rest on each other, metres."""


class ActiveBodies:
    """Counts active solver bodies per step."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._reports = False
        self._peak, self._steps = 0.0, 0

    def change_bodies(self, count: int) -> None:
        """Turns the reports on or off for ``count`` bodies without static shapes; there are at most as many islands."""
        reports = count <= _MAX_ISLANDS
        if reports != self._reports:
            p.setPhysicsEngineParameter(reportSolverAnalytics=int(reports), physicsClientId=self._client)
        self._reports = reports

    def add_step(self, islands: Sequence[dict[str, Any]]) -> None:
        """Adds the report of a step."""
        active = sum([island["numBodies"] for island in islands]) if self._reports else math.inf
        self._steps += 1
        if active > self._peak:
            self._peak = active

    def pop_peak(self) -> tuple[float, int]:
        """Returns the peak number of active solver bodies per step since the last call, inf = unknown, and the number of these steps."""
        peak = self._peak, self._steps
        self._peak, self._steps = 0.0, 0
        return peak


def count_solver_bodies(uid: int, links: int, client: int) -> float:
    """Returns the number of solver bodies of a body; NaN = unknown.

    Args:
        uid: Engine id of the body.
        links: Number of links below its root.
        client: PyBullet's client id.
    """
    if p.getDynamicsInfo(uid, -1, client)[0] > 0.0:
        return links + 1
    # The root is fixed, and so may be links attached to it by fixed joints.
    fixed = any(p.getJointInfo(uid, i, client)[2] == p.JOINT_FIXED for i in range(links))
    return math.nan if fixed else links


class SleepingBodies:
    """The bodies of one engine that may fall asleep, by engine id."""

    def __init__(self, client: int) -> None:
        self._client = client
        self._may_sleep: set[int] = set()
        self._waking: set[int] = set()
        """Bodies to wake before the next step."""
        self._velocities: dict[int, tuple[list[float], list[float]]] = {}
        """Velocities set since the last step: linear, of the centre of mass (m/s), and angular (rad/s)."""

    def add(self, body: BulletBody) -> None:
        """Lets a body fall asleep when it is at rest."""
        self._may_sleep.add(body.uid)
        p.changeDynamics(
            body.uid,
            -1,
            activationState=p.ACTIVATION_STATE_ENABLE_SLEEPING,
            sleepThreshold=_SLEEP_THRESHOLD,
            physicsClientId=self._client,
        )

    def remove(self, body: BulletBody) -> None:
        """Forgets a body that is about to be removed, and wakes adjacent bodies."""
        self.wake_beside(body)
        self._may_sleep.discard(body.uid)
        self._waking.discard(body.uid)
        self._velocities.pop(body.uid, None)

    def wake(self, body: BulletBody) -> None:
        """Wakes a body before the next step."""
        if body.uid in self._may_sleep:
            self._waking.add(body.uid)

    def wake_beside(self, body: BulletBody) -> None:
        """Wakes a body and the bodies adjacent to its current position before the next step."""
        if not self._may_sleep:
            return
        self.wake(body)
        for link in (-1, *body.link_indices):
            low, high = p.getAABB(body.uid, link, physicsClientId=self._client)
            low, high = [c - _BESIDE for c in low], [c + _BESIDE for c in high]
            overlapping = p.getOverlappingObjects(low, high, physicsClientId=self._client) or ()
            self._waking.update(uid for uid, _ in overlapping if uid in self._may_sleep)

    def wake_moving(self, body: BulletBody, linear: list[float], angular: list[float]) -> None:
        """Wakes a body whose velocities were just set: linear, of its centre of mass (m/s), and angular (rad/s), world frame."""
        if body.uid in self._may_sleep:
            self._waking.add(body.uid)
            self._velocities[body.uid] = (linear, angular)

    def before_step(self) -> None:
        """Wakes the bodies marked for waking; call it before every step."""
        for uid in sorted(self._waking):
            p.changeDynamics(uid, -1, activationState=p.ACTIVATION_STATE_WAKE_UP, physicsClientId=self._client)
        self._waking.clear()

    def after_step(self) -> None:
        """Restores velocities that the step discarded: a sleeping body does not move in the step that wakes it. Call it after every step."""
        for uid, (linear, angular) in self._velocities.items():
            if not any(map(any, p.getBaseVelocity(uid, physicsClientId=self._client))):
                p.resetBaseVelocity(uid, linear, angular, physicsClientId=self._client)
        self._velocities.clear()
