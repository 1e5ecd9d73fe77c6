"""Walking people: pose at a time, and URDF model, a capsule."""

from __future__ import annotations

import math

from gibson_sim.trials.records import Person, PlanarPose

PERIOD_TICKS = 2
"""Number of ticks between two placements of a person."""


def person_pose(person: Person, time: float) -> PlanarPose:
    """Returns the pose of a person who walks back and forth along a path at constant speed, facing the direction of motion.

    Args:
        person: path and speed.
        time: time since the start, seconds.
    """
    legs = [(a, b, math.dist(a, b)) for a, b in zip(person.path, person.path[1:], strict=False) if a != b]
    length = sum(leg[2] for leg in legs)
    if not legs:
        return (*person.path[0], 0.0)
    walked = math.fmod(max(0.0, time) * person.speed, 2.0 * length)
    is_forward = walked < length
    remaining = walked if is_forward else 2.0 * length - walked
    for number, (a, b, distance) in enumerate(legs):
        if remaining <= distance or number == len(legs) - 1:
            fraction = min(1.0, remaining / distance)
            yaw = math.atan2(b[1] - a[1], b[0] - a[0])
            return (
                a[0] + fraction * (b[0] - a[0]),
                a[1] + fraction * (b[1] - a[1]),
                yaw if is_forward else math.remainder(yaw + math.pi, 2 * math.pi),
            )
        remaining -= distance
    raise AssertionError("the last leg always returns")


def person_urdf(person: Person) -> str:
    """Returns the URDF of a person: a static capsule that stands on its origin; the built-in model ``person`` is the one of default size."""
    radius = person.radius
    height = max(person.height, 2.0 * radius)
    cylinder = max(height - 2.0 * radius, 1e-3)
    shapes = [
        (f'<cylinder radius="{radius}" length="{cylinder}"/>', height / 2.0),
        (f'<sphere radius="{radius}"/>', radius),
        (f'<sphere radius="{radius}"/>', height - radius),
    ]
    parts = "".join(
        f'<{kind}><origin xyz="0 0 {z}"/><geometry>{shape}</geometry>{material}</{kind}>'
        for kind, material in (
            ("visual", '<material name="clothes"><color rgba="0.25 0.35 0.6 1"/></material>'),
            ("collision", ""),
        )
        for shape, z in shapes
    )
    return (
        f'<robot name="person"><link name="world"/><link name="body">{parts}</link>'
        '<joint name="stands" type="fixed"><parent link="world"/><child link="body"/></joint></robot>'
    )
