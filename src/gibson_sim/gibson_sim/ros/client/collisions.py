"""Collisions of a robot since the simulation started or was reset. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Collision:
    """The start of a collision: a link of a robot touched a body, not the ground, that it had not touched in the last 0.1 s."""

    time: float
    """Simulation time of the tick at which it was reported, s."""
    robot: str
    link: str
    """Link of the robot."""
    body: str
    """Name of the other robot, the body, or the static shape of the scene."""

    def __str__(self) -> str:
        return f"{self.body} ({self.link}, at {self.time:.2f} s)"


class CollisionLog:
    """Collects the collisions of one robot from its counts, and from contact points if several collisions started in one tick."""

    def __init__(self, robot: str) -> None:
        self._robot, self._count = robot, 0
        self.collisions: list[Collision] = []

    def add(self, time: float, count: int, last: tuple[str, str], touching: Iterable[tuple[str, str]] = ()) -> None:
        """Adds the collisions that a tick reports.

        Args:
            time: simulation time of the tick, s.
            count: number of collisions since the start.
            last: link and body of the last collision.
            touching: link and body of each present contact point of the robot, including contacts with the ground.
        """
        unnamed = count - self._count - 1
        self._count = count
        if unnamed < 0:
            return
        logged = {(collision.link, collision.body) for collision in self.collisions} | {last}
        new_pairs = [pair for pair in dict.fromkeys(touching) if pair not in logged][:unnamed]
        self.collisions += [Collision(time, self._robot, *pair) for pair in (*new_pairs, last)]

    def clear(self) -> None:
        """Clears the log: the simulation was reset."""
        self._count, self.collisions = 0, []
