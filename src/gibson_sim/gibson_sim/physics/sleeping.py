"""Who may fall asleep in the engine, and who must wake.

Bullet lets what rests sleep, and wakes it when something that moves by itself touches it. It wakes nobody when a body is put somewhere,
taken away, or pushed by a command: that is done here, for the body itself and for what lies beside it, and for nobody else.
"""

from __future__ import annotations

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
