"""Random objects, people and furniture for training alone: none of them is a model that table 2 puts on a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.tasks.episode import Item

OBJECT_KINDS = ("box", "cylinder", "container", "table", "chair", "person")
"""Kinds of objects, each equally likely."""
OBSTACLE_KINDS = (*OBJECT_KINDS, "seat", "barred_chair", "capsule", "tapered", "ball", "stack")
"""Kinds of obstacles, each equally likely: also ones with rungs, bars, or a base narrower than the body."""
FURNITURE_KINDS = ("block", "sofa", "shelf", "table", "chair", "container")
"""Kinds of furniture, each equally likely."""
_LOW_SHARE = 0.4
"""Share of the boxes and cylinders that are lower than the camera."""


def random_object(rng: np.random.Generator, name: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Item:
    """Returns an object that stands on the floor; equal generators give equal objects.

    Args:
        rng: of its kind, sizes, colours and heading.
        name: name of the item.
        x: position, world frame, metres.
        y: position, world frame, metres.
        z: height of the floor, world frame, metres.
    """
    return _random_item(OBJECT_KINDS[int(rng.integers(len(OBJECT_KINDS)))], rng, name, x, y, z)


def random_obstacle(rng: np.random.Generator, name: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Item:
    """Returns an obstacle that stands on the floor; arguments as of ``random_object``."""
    return _random_item(OBSTACLE_KINDS[int(rng.integers(len(OBSTACLE_KINDS)))], rng, name, x, y, z)


def random_furniture(rng: np.random.Generator, name: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Item:
    """Returns a piece of furniture, up to 1.6 m wide, that stands on the floor; arguments as of ``random_object``."""
    return _random_item(FURNITURE_KINDS[int(rng.integers(len(FURNITURE_KINDS)))], rng, name, x, y, z)


def _random_item(kind: str, rng: np.random.Generator, name: str, x: float, y: float, z: float) -> Item:
    """Returns an item of a kind, at a random heading. Arguments as of ``random_object``."""
    parts = _MAKERS[kind](rng)
    shapes = "".join(
        f'<{role}><origin xyz="{px:.4f} {py:.4f} {pz:.4f}"/><geometry>{shape}</geometry>{material if role == "visual" else ""}</{role}>'
        for shape, (px, py, pz), material in parts
        for role in ("visual", "collision")
    )
    urdf = (
        f'<robot name="{kind}"><link name="world"/><link name="body">{shapes}</link>'
        '<joint name="stands" type="fixed"><parent link="world"/><child link="body"/></joint></robot>'
    )
    return Item(name, kind, pose_from_xyz_rpy((x, y, z), (0.0, 0.0, float(rng.uniform(-math.pi, math.pi)))), urdf)


_Part = tuple[str, tuple[float, float, float], str]
"""Geometry (URDF), position (3,), link frame, metres, and material (URDF)."""


def _size(x: float, y: float, z: float) -> str:
    return f'<box size="{x:.4f} {y:.4f} {z:.4f}"/>'


def _round(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:.4f}" length="{length:.4f}"/>'


def _colour(rng: np.random.Generator) -> str:
    """Returns a material of random colour; half of them are nearly grey, as most furniture is."""
    value, away = rng.uniform(0.05, 0.95), rng.uniform(-0.35, 0.35, 3) * (rng.random() < 0.5) + rng.uniform(-0.06, 0.06, 3)
    red, green, blue = np.clip(value + away, 0.02, 1.0)
    return _material(rng, red, green, blue)


def _material(rng: np.random.Generator, red: float, green: float, blue: float) -> str:
    """Returns a material of a colour, 0 to 1, under a unique name."""
    return f'<material name="m{rng.integers(10**9)}"><color rgba="{red:.3f} {green:.3f} {blue:.3f} 1"/></material>'


def _box(rng: np.random.Generator) -> list[_Part]:
    x, y = rng.uniform(0.12, 0.7, 2)
    z = _height(rng, 1.3)
    return [(_size(x, y, z), (0.0, 0.0, z / 2.0), _colour(rng))]


def _cylinder(rng: np.random.Generator) -> list[_Part]:
    radius, length = rng.uniform(0.07, 0.3), _height(rng, 1.4)
    return [(_round(radius, length), (0.0, 0.0, length / 2.0), _colour(rng))]


def _height(rng: np.random.Generator, most: float) -> float:
    return float(rng.uniform(0.12, 0.42) if rng.random() < _LOW_SHARE else rng.uniform(0.2, most))


def _container(rng: np.random.Generator) -> list[_Part]:
    """Returns an open container, round or rectangular, with or without a rim or lines around it."""
    x, y, z = (float(value) for value in rng.uniform((0.18, 0.18, 0.15), (0.55, 0.55, 0.65)))
    outside, inside = _colour(rng), _colour(rng)
    is_round = rng.random() < 0.5
    across, along = (x, x) if is_round else (x, y)

    def layer(scale: float, height: float) -> str:
        return _round(scale * across / 2.0, height) if is_round else _size(scale * across, scale * along, height)

    parts: list[_Part] = [(layer(1.0, z), (0.0, 0.0, z / 2.0), outside), (layer(0.88, 0.004), (0.0, 0.0, z + 0.002), inside)]
    lines = int(rng.integers(0, 4))
    return parts + [(layer(1.04, 0.025), (0.0, 0.0, z * (k + 1) / (lines + 1)), inside) for k in range(lines)]


def _table(
    rng: np.random.Generator, height: tuple[float, float] = (0.3, 0.6), size: tuple[float, float] = (0.35, 0.9)
) -> list[_Part]:
    x, y = rng.uniform(*size, 2)
    top, leg, wood = rng.uniform(*height), rng.uniform(0.02, 0.06), _colour(rng)
    legs = wood if rng.random() < 0.6 else _colour(rng)
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


def _wood(rng: np.random.Generator) -> str:
    """Returns a material in a colour of wood, which floors and doors have, too; or in any other colour."""
    if rng.random() < 0.4:
        return _colour(rng)
    bright, warm = rng.uniform(0.15, 0.9), rng.uniform(0.55, 0.9)
    red, green, blue = bright, bright * warm, bright * warm**2 * rng.uniform(0.6, 1.0)
    return _material(rng, red, green, blue)


def _legs(x: float, y: float, top: float, thick: float, wood: str, rungs: Sequence[float]) -> list[_Part]:
    """Returns four legs under a seat of size ``x``, ``y`` at height ``top``, and rungs between them at some heights, metres."""
    ends = [(i * (x - thick) / 2.0, j * (y - thick) / 2.0) for i in (-1.0, 1.0) for j in (-1.0, 1.0)]
    parts: list[_Part] = [(_size(thick, thick, top), (px, py, top / 2.0), wood) for px, py in ends]
    bar = 0.7 * thick
    for height in rungs:
        parts += [(_size(x - thick, bar, bar), (0.0, j * (y - thick) / 2.0, height), wood) for j in (-1.0, 1.0)]
        parts += [(_size(bar, y - thick, bar), (i * (x - thick) / 2.0, 0.0, height + bar), wood) for i in (-1.0, 1.0)]
    return parts


def _seat(rng: np.random.Generator) -> list[_Part]:
    """Returns a seat on four legs with rungs."""
    width, top, thick = rng.uniform(0.26, 0.44), rng.uniform(0.28, 0.72), rng.uniform(0.018, 0.045)
    wood = _wood(rng)
    seat = _round(width / 2.0, 0.03) if rng.random() < 0.5 else _size(width, width, 0.03)
    inside = width * rng.uniform(0.65, 1.0)
    rungs = sorted(rng.uniform(0.1, 0.8, int(rng.integers(0, 3))) * top)
    return [
        (seat, (0.0, 0.0, top + 0.015), _wood(rng) if rng.random() < 0.3 else wood),
        *_legs(inside, inside, top, thick, wood, rungs),
    ]


def _barred_chair(rng: np.random.Generator) -> list[_Part]:
    """Returns a chair whose back has bars, with or without rungs between its legs."""
    depth, width = rng.uniform(0.34, 0.48, 2)
    top, back, thick, wood = rng.uniform(0.38, 0.52), rng.uniform(0.3, 0.6), rng.uniform(0.02, 0.045), _wood(rng)
    rungs = [top * rng.uniform(0.2, 0.7)] if rng.random() < 0.6 else []
    parts = [(_size(depth, width, 0.03), (0.0, 0.0, top + 0.015), wood), *_legs(depth, width, top, thick, wood, rungs)]
    behind, bars = -(depth - thick) / 2.0, int(rng.integers(2, 6))
    if rng.random() < 0.5:  # upright bars under a rail
        across = np.linspace(-(width - thick) / 2.0, (width - thick) / 2.0, bars)
        parts += [(_size(0.6 * thick, 0.6 * thick, back), (behind, float(py), top + back / 2.0), wood) for py in across]
        return [*parts, (_size(thick, width, 0.05), (behind, 0.0, top + back), wood)]
    posts = [(_size(thick, thick, back), (behind, side * (width - thick) / 2.0, top + back / 2.0), wood) for side in (-1.0, 1.0)]
    across = np.linspace(0.3 * back, back - 0.03, bars)
    return [*parts, *posts, *((_size(0.5 * thick, width, 0.05), (behind, 0.0, top + float(pz)), wood) for pz in across)]


def _capsule(rng: np.random.Generator) -> list[_Part]:
    """Returns a post that is round at both ends."""
    radius = rng.uniform(0.1, 0.32)
    tall, colour = rng.uniform(2.2 * radius, 2.0), _colour(rng)
    ball = f'<sphere radius="{radius:.4f}"/>'
    middle = max(tall - 2.0 * radius, 0.01)
    return [
        (_round(radius, middle), (0.0, 0.0, tall / 2.0), colour),
        (ball, (0.0, 0.0, radius), colour),
        (ball, (0.0, 0.0, tall - radius), colour),
    ]


def _tapered(rng: np.random.Generator) -> list[_Part]:
    """Returns a tapered container, wider or narrower at its top than at its base: a bin, a bucket, a pot."""
    radius, tall, colour = rng.uniform(0.09, 0.24), rng.uniform(0.2, 0.75), _colour(rng)
    ratio, layers = rng.uniform(0.55, 1.3), 8
    parts: list[_Part] = []
    for k in range(layers):
        share = (k + 0.5) / layers
        parts.append((_round(radius * (ratio + (1.0 - ratio) * share), tall / layers), (0.0, 0.0, tall * share), colour))
    return [*parts, (_round(0.9 * radius, 0.004), (0.0, 0.0, tall + 0.002), _colour(rng))]


def _ball(rng: np.random.Generator) -> list[_Part]:
    radius = rng.uniform(0.1, 0.33)
    return [(f'<sphere radius="{radius:.4f}"/>', (0.0, 0.0, radius), _colour(rng))]


def _stack(rng: np.random.Generator) -> list[_Part]:
    """Returns a stack of up to three boxes in colours of cardboard and wood."""
    parts: list[_Part] = []
    bottom, (x, y) = 0.0, rng.uniform(0.2, 0.65, 2)
    for _ in range(int(rng.integers(1, 4))):
        tall = rng.uniform(0.1, 0.45)
        parts.append((_size(x, y, tall), (0.0, 0.0, bottom + tall / 2.0), _wood(rng)))
        bottom, x, y = bottom + tall, x * rng.uniform(0.6, 1.0), y * rng.uniform(0.6, 1.0)
    return parts


def _block(rng: np.random.Generator) -> list[_Part]:
    """Returns a cabinet: a body, often with a plinth or a plate of another colour."""
    x, y, z = (float(value) for value in rng.uniform((0.3, 0.25, 0.35), (1.6, 0.7, 2.0)))
    parts: list[_Part] = [(_size(x, y, z), (0.0, 0.0, z / 2.0), _colour(rng))]
    if rng.random() < 0.5:
        parts.append((_size(x + 0.02, y + 0.02, 0.04), (0.0, 0.0, z), _colour(rng)))
    if rng.random() < 0.5:
        parts.append((_size(x + 0.01, y + 0.01, 0.1), (0.0, 0.0, 0.05), _colour(rng)))
    return parts


def _sofa(rng: np.random.Generator) -> list[_Part]:
    x, y, seat = rng.uniform(0.6, 1.6), rng.uniform(0.6, 0.9), rng.uniform(0.3, 0.48)
    back, arm, cloth = rng.uniform(0.25, 0.5), rng.uniform(0.08, 0.2), _colour(rng)
    foot = rng.uniform(0.0, 0.15) * (rng.random() < 0.5)
    parts: list[_Part] = [
        (_size(x, y, seat - foot), (0.0, 0.0, (seat + foot) / 2.0), cloth),
        (_size(x, 0.18, back), (0.0, y / 2.0 - 0.09, seat + back / 2.0), cloth),
    ]
    if foot > 0.0:
        wood = _colour(rng)
        ends = [(side * (x / 2.0 - 0.05), end * (y / 2.0 - 0.05)) for side in (-1.0, 1.0) for end in (-1.0, 1.0)]
        parts += [(_round(0.025, foot), (px, py, foot / 2.0), wood) for px, py in ends]
    if rng.random() < 0.6:
        parts += [(_size(arm, y, 0.2), (side * (x - arm) / 2.0, 0.0, seat + 0.1), cloth) for side in (-1.0, 1.0)]
    return parts


def _shelf(rng: np.random.Generator) -> list[_Part]:
    """Returns boards between two sides, with a few boxes on them."""
    x, y, z = (float(value) for value in rng.uniform((0.4, 0.2, 0.5), (1.4, 0.45, 1.9)))
    wood, levels = _colour(rng), int(rng.integers(2, 6))
    parts: list[_Part] = [(_size(0.025, y, z), (side * x / 2.0, 0.0, z / 2.0), wood) for side in (-1.0, 1.0)]
    heights = np.linspace(0.02, z - 0.02, levels)
    parts += [(_size(x, y, 0.02), (0.0, 0.0, float(height)), wood) for height in heights]
    if rng.random() < 0.5:
        parts.append((_size(x, 0.01, z), (0.0, y / 2.0, z / 2.0), _colour(rng)))
    for height in heights[:-1]:
        wide, tall = rng.uniform(0.1, 0.5) * x, rng.uniform(0.3, 0.8) * (heights[1] - heights[0])
        at = float(rng.uniform(-0.5, 0.5) * (x - wide - 0.05))
        parts.append((_size(wide, 0.8 * y, tall), (at, 0.0, float(height) + 0.01 + tall / 2.0), _colour(rng)))
    return parts


def _person(rng: np.random.Generator) -> list[_Part]:
    """Returns legs, a trunk and a head."""
    tall, wide = rng.uniform(1.45, 1.95), rng.uniform(0.14, 0.26)
    hips, head, trousers = 0.48 * tall, 0.065 * tall, _colour(rng)
    trunk = tall - 2.0 * head - hips
    parts: list[_Part] = [
        (_round(wide, trunk), (0.0, 0.0, hips + trunk / 2.0), _colour(rng)),
        (f'<sphere radius="{head:.4f}"/>', (0.0, 0.0, tall - head), _colour(rng)),
    ]
    if rng.random() < 0.3:  # a skirt or a long coat
        return [*parts, (_round(0.9 * wide, hips), (0.0, 0.0, hips / 2.0), trousers)]
    leg, apart, step = 0.45 * wide, 0.5 * wide, rng.uniform(-0.1, 0.1)
    return parts + [(_round(leg, hips), (side * step, side * apart, hips / 2.0), trousers) for side in (-1.0, 1.0)]


_MAKERS: dict[str, Callable[[np.random.Generator], list[_Part]]] = {
    "box": _box,
    "cylinder": _cylinder,
    "container": _container,
    "table": _table,
    "chair": _chair,
    "person": _person,
    "block": _block,
    "sofa": _sofa,
    "shelf": _shelf,
    "seat": _seat,
    "barred_chair": _barred_chair,
    "capsule": _capsule,
    "tapered": _tapered,
    "ball": _ball,
    "stack": _stack,
}
