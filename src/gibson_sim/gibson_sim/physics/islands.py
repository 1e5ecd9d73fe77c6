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
