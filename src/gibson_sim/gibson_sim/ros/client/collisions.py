"""What a robot collided with since the simulation began or was reset. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Collision:
    """The begin of a collision: a link of a robot touched something, not the ground, that it did not touch in the last 0.1 s."""

    time: float
    """Simulation time of the tick at which it was reported, s."""
    robot: str
    link: str
    """Of the robot."""
    body: str
    """The other robot, the body, or the static shape of the scene."""

    def __str__(self) -> str:
        return f"{self.body} ({self.link}, at {self.time:.2f} s)"


class CollisionLog:
    """Collects the collisions of one robot from its counts, and from contact points where several began in one tick."""

    def __init__(self, robot: str) -> None:
        self._robot, self._count = robot, 0
        self.collisions: list[Collision] = []

    def add(self, time: float, count: int, last: tuple[str, str], touching: Iterable[tuple[str, str]] = ()) -> None:
        """Adds what a tick reports.

        Args:
            time: of the tick, s.
            count: collisions since the beginning.
            last: link and body of the last one.
            touching: link and body of all contact points of the robot now, those with the ground included.
        """
        more = count - self._count - 1
        self._count = count
        if more < 0:
            return
        known = {(one.link, one.body) for one in self.collisions} | {last}
        others = [pair for pair in dict.fromkeys(touching) if pair not in known][:more]
        self.collisions += [Collision(time, self._robot, *pair) for pair in (*others, last)]

    def clear(self) -> None:
        """Forgets everything: the simulation was reset."""
        self._count, self.collisions = 0, []
