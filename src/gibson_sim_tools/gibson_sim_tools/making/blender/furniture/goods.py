"""Models goods on shelves: packages, bottles and cans, several of each in a row. NumPy only."""

from __future__ import annotations

from collections.abc import Callable

from gibson_sim_tools.making.blender.appearances import sample_vivid_color, surface_of
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, Tint

Point = tuple[float, float, float]
_GLASS: tuple[Tint, ...] = ((0.13, 0.20, 0.11), (0.20, 0.12, 0.06), (0.70, 0.74, 0.72), (0.82, 0.80, 0.70), (0.10, 0.09, 0.09))
"""Colours of filled bottles."""
_SIDES = 8
_BEHIND = "-x -y +y -z +z"
"""Hidden sides of a thin label."""


def goods(s: ObjectBuilder, low: Point, high: Point) -> None:
    """Fills a shelf with goods; their fronts are at the maximum x.

    Args:
        s: builder of the shelf.
        low: lower corner of the space, metres.
        high: upper corner of the space, metres.
    """
    y, room = low[1] + 0.01, high[2] - low[2]
    while y < high[1] - 0.12:
        kind = s.rng.random()
        add_item: Callable[[ObjectBuilder, Point, float, float, Tint, Tint], None] = (
            _package if kind < 0.5 else _bottle if kind < 0.8 else _can
        )
        color, label_color = (
            sample_vivid_color(s.rng, (0.2, 0.75), (0.3, 0.85)),
            sample_vivid_color(s.rng, (0.05, 0.7), (0.35, 0.95)),
        )
        width = s.rng.uniform(0.08, 0.16) if add_item is _package else s.rng.uniform(0.065, 0.085)
        height = min(room * s.rng.uniform(0.5, 0.9), 0.12 if add_item is _can else 0.34)
        for _ in range(int(s.rng.integers(2, 6))):
            if y + width > high[1]:
                break
            add_item(s, (high[0] - s.rng.uniform(0.0, 0.03), y + width / 2, low[2]), width, height, color, label_color)
            y += width + 0.003
        y += s.rng.uniform(0.0, 0.04)


def _package(s: ObjectBuilder, front: Point, width: float, height: float, color: Tint, second: Tint) -> None:
    """Adds a box with a band around it and a label; ``front``: middle of its lower front edge, m."""
    x, y, z = front
    half = width / 2 - 0.003
    s.box((x - 0.12, y - half, z), (x, y + half, z + height), surface_of("paper", color), 0, "-x -z")
    s.box((x, y - half, z + height * 0.12), (x + 0.0008, y + half, z + height * 0.34), surface_of("paper", second), 0, _BEHIND)
    s.box(
        (x, y - half * 0.7, z + height * 0.48), (x + 0.0008, y + half * 0.7, z + height * 0.84), surface_of("paper"), 0, _BEHIND
    )
    s.box(
        (x, y - half * 0.5, z + height * 0.6),
        (x + 0.0012, y + half * 0.5, z + height * 0.7),
        surface_of("paper", color),
        0,
        _BEHIND,
    )


def _bottle(s: ObjectBuilder, front: Point, width: float, height: float, color: Tint, second: Tint) -> None:
    """Adds a bottle with a label and a cap."""
    r = width / 2 - 0.003
    middle = (front[0] - r, front[1], front[2])
    glass = Surface("plain", _GLASS[int(sum(color) * 97) % len(_GLASS)])
    neck = [(r, 0.0), (r, height * 0.58), (r * 0.36, height * 0.74), (r * 0.33, height * 0.9)]
    s.lathe(middle, neck, glass, _SIDES)
    s.lathe(middle, [(r + 0.0006, height * 0.14), (r + 0.0006, height * 0.48)], surface_of("paper", second), _SIDES)
    s.lathe(middle, [(r * 0.4, height * 0.88), (r * 0.4, height), (0, height)], Surface("plain", color), _SIDES)


def _can(s: ObjectBuilder, front: Point, width: float, height: float, color: Tint, second: Tint) -> None:
    """Adds a can with a printed sleeve, metal above and below."""
    r = width / 2 - 0.003
    middle = (front[0] - r, front[1], front[2])
    s.lathe(middle, [(r, 0.0), (r, height), (r * 0.9, height), (0, height - 0.003)], surface_of("metal_steel"), _SIDES)
    s.lathe(middle, [(r + 0.0005, 0.008), (r + 0.0005, height * 0.4)], surface_of("paper", second), _SIDES)
    s.lathe(middle, [(r + 0.0005, height * 0.4), (r + 0.0005, height - 0.008)], surface_of("paper", color), _SIDES)
