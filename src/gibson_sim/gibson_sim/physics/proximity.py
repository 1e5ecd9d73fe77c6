"""Which links of other bodies are near a link: what a hand could take hold of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.types import Vec3


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
