"""Layout of a building: rooms, their rectangles and their connections, without walls. Result of the layout functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.rectangles import Rect, bounding_rect

OUTSIDE_THICKNESS = 0.3
"""Thickness of outside walls, m."""


@dataclass(frozen=True, slots=True)
class Space:
    """A room as a union of adjacent rectangles."""

    name: str
    kind: str
    rects: tuple[Rect, ...]


@dataclass(frozen=True, slots=True)
class SpaceLink:
    """A door or a passage between two spaces."""

    from_room: str
    """Name of a room; empty = outside."""
    to_room: str
    """Name of the room into which a door opens."""
    kind: Literal["door", "passage"] = "door"
    width: float = 0.9
    near: Point | None = None
    """Preferred position, m; None = anywhere."""
    sliding: bool = False


@dataclass(frozen=True, slots=True)
class Flight:
    """A straight flight of stairs to the storey above."""

    foot: Point
    """Centre of the first edge, m."""
    top: Point
    """Centre of the last edge, m."""
    width: float
    steps: int
    hole: Rect
    """Opening in the floor above."""
    lower_room: str
    upper_room: str


@dataclass(frozen=True, slots=True)
class Level:
    """The layout of a storey."""

    height: float
    spaces: tuple[Space, ...]
    links: tuple[SpaceLink, ...]
    windowless: tuple[str, ...] = ()
    """Names of rooms without windows."""


@dataclass(frozen=True, slots=True)
class BuildingLayout:
    """The layout of a building."""

    levels: tuple[Level, ...]
    partition: float
    """Thickness of inside walls, m."""
    flights: tuple[Flight, ...] = ()
    slab: float = 0.3
    """Thickness of the floor between two storeys, m."""

    def bounds(self) -> Rect:
        """Returns the bounding rectangle of all storeys."""
        return bounding_rect(
            p for level in self.levels for s in level.spaces for r in s.rects for p in ((r.x0, r.y0), (r.x1, r.y1))
        )


def rect_space(name: str, kind: str, x0: float, y0: float, x1: float, y1: float) -> Space:
    """Returns a space of one rectangle, rounded to centimetres."""
    return Space(name, kind, (Rect(round(x0, 2), round(y0, 2), round(x1, 2), round(y1, 2)),))


def random_orientation(layout: BuildingLayout, rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout, randomly mirrored and transposed, with its lower left corner at the origin."""
    mirror, swap = bool(rng.integers(2)), bool(rng.integers(2))
    bounds = layout.bounds()

    def point(p: Point) -> Point:
        x = bounds.x1 - p[0] if mirror else p[0] - bounds.x0
        y = p[1] - bounds.y0
        mapped = (y, x) if swap else (x, y)
        return (round(mapped[0], 3), round(mapped[1], 3))

    def rect(r: Rect) -> Rect:
        return bounding_rect((point((r.x0, r.y0)), point((r.x1, r.y1))))

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
