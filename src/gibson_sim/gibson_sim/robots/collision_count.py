"""How often a robot ran into something: what counts as one collision. Pure; ``PhysicsWorld.collisions`` has the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gibson_sim.types import NS_PER_S

PAUSE_NS = NS_PER_S // 10
"""A touch that ended less than this before it began again, simulation time, is the same collision: bodies bounce and chatter."""
STANDING_HEIGHT = 0.05
"""Metres above its base frame below which a robot stands on what it touches, instead of running into it."""
STANDING_NORMAL = 0.7
"""Least vertical part of the normal of what a robot stands on: floors, ramps and thresholds up to 45 degrees."""


@dataclass(frozen=True, slots=True)
class CollisionCount:
    """What a robot ran into since it was loaded or reset."""

    count: int = 0
    """Collisions that began."""
    ongoing: int = 0
    """Pairs of a link and a thing that touch now."""
    duration: float = 0.0
    """Seconds during which at least one pair touched."""
    greatest_force: float = 0.0
    """N, along the normal of one point."""
    last_link: str = ""
    """Of the robot, in the last collision; empty = there was none."""
    last_body: str = ""
    """What it ran into: a robot, a body, or a static shape."""


class CollisionCounter:
    """Counts the collisions of one robot."""

    def __init__(self) -> None:
        self._count, self._steps, self._greatest, self._ongoing = 0, 0, 0.0, 0
        self._last = "", ""
        self._touched_ns: dict[tuple[str, str], int] = {}
        """(link, thing) -> when they last touched, of those that did so just now."""

    def add_step(self, now_ns: int, touches: Mapping[tuple[str, str], float]) -> None:
        """Takes what touched in the step that ended at ``now_ns``: (link, thing) -> N, the greatest of all points."""
        for pair, force in touches.items():
            if now_ns - self._touched_ns.get(pair, -PAUSE_NS - 1) > PAUSE_NS:
                self._count += 1
                self._last = pair
            self._greatest = max(self._greatest, force)
            self._touched_ns[pair] = now_ns
        for pair in [pair for pair, then in self._touched_ns.items() if now_ns - then > PAUSE_NS]:
            del self._touched_ns[pair]
        self._ongoing = len(touches)
        self._steps += bool(touches)

    def total(self, step_hz: int) -> CollisionCount:
        """Returns the numbers now."""
        return CollisionCount(self._count, self._ongoing, self._steps / step_hz, self._greatest, *self._last)
