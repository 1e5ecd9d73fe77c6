"""Layouts: which rooms there are, where they lie and which are joined, before there are walls. What the makers of each kind of building return."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.rectangles import Rect, spanning

OUTSIDE_THICKNESS = 0.3


@dataclass(frozen=True, slots=True)
class Space:
    """A room to be: rectangles that touch."""

    name: str
    kind: str
    rects: tuple[Rect, ...]


@dataclass(frozen=True, slots=True)
class Link:
    """A door or a passage between two spaces."""

    from_room: str
    """Empty = outside."""
    to_room: str
    """A door opens into this one."""
    kind: Literal["door", "passage"] = "door"
    width: float = 0.9
    near: Point | None = None
    """It comes as near to this point as may be."""
    sliding: bool = False


@dataclass(frozen=True, slots=True)
class Flight:
    """A straight stair to the storey above."""

    foot: Point
    top: Point
    """Middles of the edges at which it begins and ends."""
    width: float
    steps: int
    hole: Rect
    """In the floor above."""
    lower_room: str
    upper_room: str


@dataclass(frozen=True, slots=True)
class Level:
    """A storey to be."""

    height: float
    spaces: tuple[Space, ...]
    links: tuple[Link, ...]
    windowless: tuple[str, ...] = ()
    """Rooms that get no window."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A building to be."""

    levels: tuple[Level, ...]
    partition: float
    """Thickness of the walls inside."""
    flights: tuple[Flight, ...] = ()
    slab: float = 0.3
    """Thickness of the floor between two storeys."""

    def bounds(self) -> Rect:
        """Returns the rectangle around all storeys."""
        return spanning(p for level in self.levels for s in level.spaces for r in s.rects for p in ((r.x0, r.y0), (r.x1, r.y1)))


def one(name: str, kind: str, x0: float, y0: float, x1: float, y1: float) -> Space:
    """Returns a space of one rectangle, rounded to whole centimetres."""
    return Space(name, kind, (Rect(round(x0, 2), round(y0, 2), round(x1, 2), round(y1, 2)),))


def turned(layout: Layout, rng: np.random.Generator) -> Layout:
    """Returns the layout mirrored and turned by chance, its lower left corner at the origin."""
    mirror, swap = bool(rng.integers(2)), bool(rng.integers(2))
    bounds = layout.bounds()

    def point(p: Point) -> Point:
        x = bounds.x1 - p[0] if mirror else p[0] - bounds.x0
        y = p[1] - bounds.y0
        moved = (y, x) if swap else (x, y)
        return (round(moved[0], 3), round(moved[1], 3))

    def rect(r: Rect) -> Rect:
        return spanning((point((r.x0, r.y0)), point((r.x1, r.y1))))

    levels = tuple(
        replace(
            level,
            spaces=tuple(replace(s, rects=tuple(rect(r) for r in s.rects)) for s in level.spaces),
            links=tuple(replace(link, near=point(link.near) if link.near else None) for link in level.links),
        )
        for level in layout.levels
    )
    flights = tuple(replace(f, foot=point(f.foot), top=point(f.top), hole=rect(f.hole)) for f in layout.flights)
    return replace(layout, levels=levels, flights=flights)
