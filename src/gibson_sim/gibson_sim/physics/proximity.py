"""Proximity queries: links of other bodies near a point or a link.

``neighbours`` finds links near a link; ``Proximity`` finds movable links near a point, which a gripper could grasp.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.physics.engine import pybullet as p
from gibson_sim.robots.joints.grasping import Candidate
from gibson_sim.types import Vec3

_RADIUS = 1e-3
"""Radius of the sphere that represents a point, metres: the engine has no point shapes."""


class Proximity:
    """Finds links near a point, in one engine."""

    def __init__(self, bullet: Bullet) -> None:
        self._bullet = bullet
        self._sphere: int | None = None
        """Index of the sphere shape that represents a point; created when first needed."""

    def movable_links(self, point: Vec3, others: Iterable[BodyInWorld], radius: float) -> list[Candidate]:
        """Returns the movable links whose surfaces are within ``radius`` metres of a point, each once.

        Args:
            point: Position, world frame, metres.
            others: Bodies to search; links fixed to the root of a static body are not movable.
            radius: Largest distance from the point to a surface, metres; distances are negative inside a shape.
        """
        client = self._bullet.client
        if self._sphere is None:
            (self._sphere,) = self._bullet.sphere_shape(_RADIUS)
        nearest: dict[tuple[str, str], float] = {}
        for other in others:
            # All bodies, not only those with overlapping bounding boxes: the engine updates overlaps in steps, and none may have run.
            gaps = p.getClosestPoints(
                other.engine_body.uid,
                -1,
                radius,
                collisionShapeB=self._bullet.engine_shape(self._sphere),
                collisionShapePositionB=point,
                physicsClientId=client,
            )
            for gap in gaps or ():
                row, distance = gap[3], gap[8] + _RADIUS
                if distance <= radius and not (other.static and row == -1):
                    key = other.name, other.link_at(self._bullet, row, gap[5])
                    nearest[key] = min(distance, nearest.get(key, distance))
        return [Candidate(*key, distance) for key, distance in nearest.items()]


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A link near the queried link."""

    body: str
    """Name of a robot or a body."""
    link: str
    distance: float
    """Distance between the two surfaces, metres; negative = they overlap."""
    point: Vec3
    """Closest point on the neighbour, world frame, metres."""
    own_point: Vec3
    """Closest point on the queried link, world frame, metres."""
    normal: Vec3
    """Unit vector from ``point`` to ``own_point``, world frame."""


def neighbours(
    bullet: Bullet, body: BodyInWorld, link: str, others: Iterable[BodyInWorld], radius: float
) -> tuple[Neighbour, ...]:
    """Returns the links of ``others`` within ``radius`` metres of a link's surface, nearest first, each once.

    Links without a collision shape have no surface. If ``link`` has none, its whole rigid group (links joined by fixed joints) counts.
    """
    row = body.row_of_link(link) - 1
    has_shape = bool(body.model.link(link).collisions)
    near = bullet.bodies_near(body.engine_body, row, radius)
    nearest: dict[tuple[str, str], Neighbour] = {}
    for other in others:
        if other is body or other.engine_body.uid not in near:
            continue
        for gap in bullet.closest_points(body.engine_body, row, other.engine_body, radius):
            if has_shape and body.link_at(bullet, row, gap.own_position) != link:
                continue
            key = other.name, other.link_at(bullet, gap.other_link, gap.position)
            if key not in nearest or gap.distance < nearest[key].distance:
                nearest[key] = Neighbour(*key, gap.distance, gap.position, gap.own_position, gap.normal)
    return tuple(sorted(nearest.values(), key=lambda neighbour: (neighbour.distance, neighbour.body, neighbour.link)))
