"""Counts the collisions of a robot: what counts as one collision. Pure; ``PhysicsWorld.collisions`` returns the count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gibson_sim.types import NS_PER_S

PAUSE_NS = NS_PER_S // 10
"""Maximum interruption of a contact within one collision, simulation time, ns: bodies bounce and chatter."""
STANDING_HEIGHT = 0.05
"""Height above its base frame below which a robot stands on what it touches, instead of colliding with it, metres."""
STANDING_NORMAL = 0.7
"""Minimum vertical component of the normal of what a robot stands on: floors, ramps and thresholds up to 45 degrees."""


@dataclass(frozen=True, slots=True)
class CollisionCount:
    """Collisions of a robot since counting began, or since a reset."""

    count: int = 0
    """Collisions that began."""
    ongoing: int = 0
    """Pairs of a link and another body or shape that touch now."""
    duration: float = 0.0
    """Time during which at least one pair touched, s."""
    greatest_force: float = 0.0
    """Maximum normal force at one point, N."""
    last_link: str = ""
    """Link of the robot in the last collision; empty = there was none."""
    last_body: str = ""
    """Name of the robot, body or static shape in the last collision."""


class CollisionCounter:
    """Counts the collisions of one robot."""

    def __init__(self) -> None:
        self._count, self._steps, self._greatest, self._ongoing = 0, 0, 0.0, 0
        self._last = "", ""
        self._touched_ns: dict[tuple[str, str], int] = {}
        """(link, other) -> when they last touched, ns, of pairs that did so within ``PAUSE_NS``."""

    def add_step(self, now_ns: int, touches: Mapping[tuple[str, str], float]) -> None:
        """Adds the step that ended at ``now_ns``; ``touches`` maps (link, other) to the greatest force of their contacts, N."""
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
        """Returns the count now."""
        return CollisionCount(self._count, self._ongoing, self._steps / step_hz, self._greatest, *self._last)
