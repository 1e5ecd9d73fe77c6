"""Counts the collisions of a robot, and defines a single collision. Pure; ``PhysicsWorld.collisions`` returns the count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gibson_sim.types import NS_PER_S

PAUSE_NS = NS_PER_S // 10
"""Maximum interruption of a contact within one collision, ns of simulation time: bodies bounce and chatter."""
STANDING_HEIGHT = 0.05
"""Maximum height above the base frame of contacts that support the robot, instead of being collisions, metres."""
STANDING_NORMAL = 0.7
"""Minimum vertical component of the normal of contacts that support the robot: floors, ramps and thresholds up to 45 degrees."""


@dataclass(frozen=True, slots=True)
class CollisionCount:
    """Collision statistics of a robot since counting began, or since a reset."""

    count: int = 0
    """Number of collisions that began."""
    ongoing: int = 0
    """Number of pairs of a link and another body or shape that are in contact now."""
    duration: float = 0.0
    """Time during which at least one pair was in contact, s."""
    greatest_force: float = 0.0
    """Maximum normal force at one contact point, N."""
    last_link: str = ""
    """Link of the robot in the last collision; empty = no collision yet."""
    last_body: str = ""
    """Name of the robot, body or static shape in the last collision."""


class CollisionCounter:
    """Counts the collisions of one robot."""

    def __init__(self) -> None:
        self._count, self._steps, self._greatest, self._ongoing = 0, 0, 0.0, 0
        self._last = "", ""
        self._touched_ns: dict[tuple[str, str], int] = {}
        """(link, other) -> time of the last contact, ns, for pairs in contact within ``PAUSE_NS``."""

    def add_step(self, now_ns: int, touches: Mapping[tuple[str, str], float]) -> None:
        """Adds the step that ended at ``now_ns``; ``touches``: (link, other) -> maximum force of their contacts, N."""
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
        """Returns the current statistics."""
        return CollisionCount(self._count, self._ongoing, self._steps / step_hz, self._greatest, *self._last)
