"""Things and people of random shapes and colours, for training alone: none of them is what table 2 puts on a path."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.tasks.episode import Item

KINDS = ("box", "cylinder", "table", "chair", "person")
"""What a thing is, each equally likely."""


def random_thing(rng: np.random.Generator, name: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Item:
    """Returns a thing that stands on the floor; equal generators give equal things.

    Args:
        rng: of its kind, sizes, colours and heading.
        name: of the item.
        x: world frame, metres.
        y: the same.
        z: of the floor, metres.
    """
    kind = KINDS[int(rng.integers(len(KINDS)))]
    parts = {"box": _box, "cylinder": _cylinder, "table": _table, "chair": _chair, "person": _person}[kind](rng)
    shapes = "".join(
        f'<{role}><origin xyz="{px:.4f} {py:.4f} {pz:.4f}"/><geometry>{shape}</geometry>{look if role == "visual" else ""}</{role}>'
        for shape, (px, py, pz), look in parts
        for role in ("visual", "collision")
    )
    urdf = (
        f'<robot name="{kind}"><link name="world"/><link name="body">{shapes}</link>'
        '<joint name="stands" type="fixed"><parent link="world"/><child link="body"/></joint></robot>'
    )
    return Item(name, kind, pose_from_xyz_rpy((x, y, z), (0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))), urdf)


_Part = tuple[str, tuple[float, float, float], str]
"""Shape, place and look, as URDF."""


def _size(x: float, y: float, z: float) -> str:
    return f'<box size="{x:.4f} {y:.4f} {z:.4f}"/>'


def _round(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:.4f}" length="{length:.4f}"/>'


def _look(rng: np.random.Generator) -> str:
    """Returns a colour; half of them are nearly grey, as most furniture is."""
    value, away = rng.uniform(0.05, 0.95), rng.uniform(-0.35, 0.35, 3) * (rng.random() < 0.5) + rng.uniform(-0.06, 0.06, 3)
    red, green, blue = np.clip(value + away, 0.02, 1.0)
    return f'<material name="m{rng.integers(10**9)}"><color rgba="{red:.3f} {green:.3f} {blue:.3f} 1"/></material>'


def _box(rng: np.random.Generator) -> list[_Part]:
    x, y = rng.uniform(0.12, 0.7, 2)
    z = rng.uniform(0.2, 1.3)
    return [(_size(x, y, z), (0.0, 0.0, z / 2.0), _look(rng))]


def _cylinder(rng: np.random.Generator) -> list[_Part]:
    radius, length = rng.uniform(0.07, 0.3), rng.uniform(0.2, 1.4)
    return [(_round(radius, length), (0.0, 0.0, length / 2.0), _look(rng))]


def _table(
    rng: np.random.Generator, height: tuple[float, float] = (0.3, 0.6), size: tuple[float, float] = (0.35, 0.9)
) -> list[_Part]:
    x, y = rng.uniform(*size, 2)
    top, leg, wood = rng.uniform(*height), rng.uniform(0.02, 0.06), _look(rng)
    legs = wood if rng.random() < 0.6 else _look(rng)
    parts: list[_Part] = [(_size(x, y, 0.03), (0.0, 0.0, top - 0.015), wood)]
    if rng.random() < 0.3:  # a foot in the middle
        return [*parts, (_round(leg, top - 0.03), (0.0, 0.0, (top - 0.03) / 2.0), legs)]
    across, along = (x - leg) / 2.0, (y - leg) / 2.0
    corners = [(across, along), (across, -along), (-across, along), (-across, -along)]
    return parts + [(_size(leg, leg, top - 0.03), (px, py, (top - 0.03) / 2.0), legs) for px, py in corners]


def _chair(rng: np.random.Generator) -> list[_Part]:
    parts = _table(rng, (0.38, 0.52), (0.34, 0.5))
    depth, width = (float(value) for value in parts[0][0].split('"')[1].split()[:2])
    top, back = parts[0][1][2], rng.uniform(0.3, 0.55)
    if rng.random() < 0.75:
        parts.append((_size(0.03, width, back), (-depth / 2.0 + 0.015, 0.0, top + back / 2.0), parts[0][2]))
    return parts


def _person(rng: np.random.Generator) -> list[_Part]:
    """Returns legs, a trunk and a head."""
    tall, wide = rng.uniform(1.45, 1.95), rng.uniform(0.14, 0.26)
    hips, head, trousers = 0.48 * tall, 0.065 * tall, _look(rng)
    trunk = tall - 2.0 * head - hips
    parts: list[_Part] = [
        (_round(wide, trunk), (0.0, 0.0, hips + trunk / 2.0), _look(rng)),
        (f'<sphere radius="{head:.4f}"/>', (0.0, 0.0, tall - head), _look(rng)),
    ]
    if rng.random() < 0.3:  # a skirt or a long coat
        return [*parts, (_round(0.9 * wide, hips), (0.0, 0.0, hips / 2.0), trousers)]
    leg, apart, step = 0.45 * wide, 0.5 * wide, rng.uniform(-0.1, 0.1)
    return parts + [(_round(leg, hips), (side * step, side * apart, hips / 2.0), trousers) for side in (-1.0, 1.0)]
