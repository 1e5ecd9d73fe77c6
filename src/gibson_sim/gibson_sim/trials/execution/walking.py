"""People who walk: where they are at a time, and the text of their model, a capsule."""

from __future__ import annotations

import math

from gibson_sim.trials.records import Person, PlanarPose

PERIOD_TICKS = 2
"""Ticks from one placement of a person to the next."""


def person_pose(person: Person, time: float) -> PlanarPose:
    """Returns where a person is, facing where it walks: along its path at its speed, to its end, back, and so on.

    Args:
        person: whose path.
        time: seconds since it set out.
    """
    legs = [(a, b, math.dist(a, b)) for a, b in zip(person.path, person.path[1:], strict=False) if a != b]
    length = sum(leg[2] for leg in legs)
    if not legs:
        return (*person.path[0], 0.0)
    walked = math.fmod(max(0.0, time) * person.speed, 2.0 * length)
    forth = walked < length
    left = walked if forth else 2.0 * length - walked
    for number, (a, b, distance) in enumerate(legs):
        if left <= distance or number == len(legs) - 1:
            part = min(1.0, left / distance)
            yaw = math.atan2(b[1] - a[1], b[0] - a[0])
            return (
                a[0] + part * (b[0] - a[0]),
                a[1] + part * (b[1] - a[1]),
                yaw if forth else math.remainder(yaw + math.pi, 2 * math.pi),
            )
        left -= distance
    raise AssertionError("the last leg always returns")


def person_urdf(person: Person) -> str:
    """Returns the model of a person as URDF: a static capsule that stands on its origin."""
    radius = person.radius
    height = max(person.height, 2.0 * radius)
    cylinder = max(height - 2.0 * radius, 1e-3)
    shapes = [
        (f'<cylinder radius="{radius}" length="{cylinder}"/>', height / 2.0),
        (f'<sphere radius="{radius}"/>', radius),
        (f'<sphere radius="{radius}"/>', height - radius),
    ]
    parts = "".join(
        f'<{kind}><origin xyz="0 0 {z}"/><geometry>{shape}</geometry>{look}</{kind}>'
        for kind, look in (("visual", '<material name="clothes"><color rgba="0.25 0.35 0.6 1"/></material>'), ("collision", ""))
        for shape, z in shapes
    )
    return (
        f'<robot name="person"><link name="world"/><link name="body">{parts}</link>'
        '<joint name="stands" type="fixed"><parent link="world"/><child link="body"/></joint></robot>'
    )
