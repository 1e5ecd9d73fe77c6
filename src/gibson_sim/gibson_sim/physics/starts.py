"""Refuses robots that start inside of something: the engine would push them out with forces of millions of newtons."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from gibson_sim.errors import StartError
from gibson_sim.physics.body import BodyInWorld
from gibson_sim.physics.bullet import Bullet
from gibson_sim.quoting import quoted
from gibson_sim.robots.collision_count import STANDING_HEIGHT, STANDING_NORMAL

_DEEPEST = 0.05
"""Metres that a robot may reach into something where it starts: it is pushed out gently."""


def check_starts(bullet: Bullet, robots: Iterable[BodyInWorld], others: Collection[BodyInWorld]) -> None:
    """Checks where robots were just put.

    Args:
        bullet: The engine.
        robots: Stand at their starts.
        others: All robots and bodies; static shapes count in any case.

    Raises:
        StartError: one reaches deeper into something than is allowed. What it stands on does not count.
    """
    for robot in robots:
        x, y, z = robot.root_state(bullet)[0].position
        deepest, where = _DEEPEST, ""
        for gap in bullet.overlaps(robot.body, [one.body for one in others if one is not robot]):
            stands = gap.normal[2] > STANDING_NORMAL and gap.position[2] < z + STANDING_HEIGHT
            if -gap.distance > deepest and not stands:
                deepest, where = -gap.distance, gap.other
        if where:
            raise StartError(
                f"robot {quoted(robot.name)} would start at ({x:.2f}, {y:.2f}, {z:.2f}), {deepest:.2f} m deep in {quoted(where)}; at most "
                f"{_DEEPEST:g} m are allowed: choose a free place as its start"
            )
