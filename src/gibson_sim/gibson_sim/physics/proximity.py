"""Which links of other bodies are near a link: what a hand could take hold of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine import pybullet as p
from gibson_sim.robots.joints.grasping import Candidate
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


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A link near another one."""

    body: str
    """Name of a robot or a body."""
    link: str
    distance: float
    """Metres between the two surfaces; negative = they overlap."""
    point: Vec3
    """On its surface, where it is nearest, world frame, metres."""
    own_point: Vec3
    """On the surface of the link that was asked about."""
    normal: Vec3
    """From its point to the own one, unit vector, world frame."""


def neighbours(
    bullet: Bullet, one: BodyInWorld, link: str, others: Iterable[BodyInWorld], radius: float
) -> tuple[Neighbour, ...]:
    """Returns the links of ``others`` within ``radius`` metres of a link's surface, the nearest first, each once.

    Links without a collision shape are nowhere; where ``link`` has none, the rigid part counts that fixed joints make of it and others.
    """
    row = one.row_of_link(link) - 1
    has_shape = bool(one.model.link(link).collisions)
    beside = bullet.beside(one.body, row, radius)
    nearest: dict[tuple[str, str], Neighbour] = {}
    for other in others:
        if other is one or other.body.uid not in beside:
            continue
        for gap in bullet.gaps(one.body, row, other.body, radius):
            if has_shape and one.link_at(bullet, row, gap.own_position) != link:
                continue
            key = other.name, other.link_at(bullet, gap.other_link, gap.position)
            if key not in nearest or gap.distance < nearest[key].distance:
                nearest[key] = Neighbour(*key, gap.distance, gap.position, gap.own_position, gap.normal)
    return tuple(sorted(nearest.values(), key=lambda found: (found.distance, found.body, found.link)))
