"""Which links are near a point: what a tool could take hold of."""

from __future__ import annotations

from collections.abc import Iterable

from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine import pybullet as p
from gibson_sim.robots.grasping import Candidate
from gibson_sim.types import Vec3

_RADIUS = 1e-3
"""Metres of the ball that stands for the point: the engine knows no points."""


class Reach:
    """Finds what is near a point, in one engine."""

    def __init__(self, bullet: Bullet) -> None:
        self._bullet = bullet
        self._ball: int | None = None

    def movable_links(self, point: Vec3, others: Iterable[BodyInWorld], radius: float) -> list[Candidate]:
        """Returns the links that can move and whose surfaces are within ``radius`` metres of a point, each once.

        Args:
            point: World frame, metres.
            others: Where to look. What a static body has fixed to its root cannot move.
            radius: Metres from the point to a surface; a point inside is at a distance below 0.
        """
        client = self._bullet.client
        if self._ball is None:
            self._ball = p.createCollisionShape(p.GEOM_SPHERE, radius=_RADIUS, physicsClientId=client)
        nearest: dict[tuple[str, str], float] = {}
        for other in others:
            # Not only those whose boxes the engine knows to be near: it finds these in a step, and there may have been none.
            found = p.getClosestPoints(
                other.body.uid, -1, radius, collisionShapeB=self._ball, collisionShapePositionB=point, physicsClientId=client
            )
            for gap in found or ():
                row, distance = gap[3], gap[8] + _RADIUS
                if distance <= radius and not (other.static and row == -1):
                    key = other.name, other.link_at(self._bullet, row, gap[5])
                    nearest[key] = min(distance, nearest.get(key, distance))
        return [Candidate(*key, distance) for key, distance in nearest.items()]
