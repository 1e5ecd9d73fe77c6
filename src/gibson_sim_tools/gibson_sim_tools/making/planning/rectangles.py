"""Axis-aligned rectangles and boxes, metres: the elements of plans."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

from gibson_sim_tools.making.building import Point

EPSILON = 1e-6
"""Tolerance of comparisons, m."""


class Rect(NamedTuple):
    """An axis-aligned rectangle of the plan."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Extent along x, m."""
        return self.x1 - self.x0

    @property
    def depth(self) -> float:
        """Extent along y, m."""
        return self.y1 - self.y0

    @property
    def area(self) -> float:
        """Area, m^2."""
        return self.width * self.depth

    @property
    def middle(self) -> Point:
        """Centre."""
        return ((self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2)

    def grown(self, margin: float) -> Rect:
        """Returns the rectangle with every edge moved outwards by a margin."""
        return Rect(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def overlaps(self, other: Rect) -> bool:
        """Returns whether the intersection has an area; touching does not count."""
        return (
            self.x0 < other.x1 - EPSILON
            and other.x0 < self.x1 - EPSILON
            and self.y0 < other.y1 - EPSILON
            and other.y0 < self.y1 - EPSILON
        )

    def overlap_area(self, other: Rect) -> float:
        """Returns the area of the intersection, m^2."""
        width = min(self.x1, other.x1) - max(self.x0, other.x0)
        depth = min(self.y1, other.y1) - max(self.y0, other.y0)
        return max(width, 0.0) * max(depth, 0.0)

    def holds(self, point: Point) -> bool:
        """Returns whether a point lies inside or on the edge."""
        return self.x0 - EPSILON <= point[0] <= self.x1 + EPSILON and self.y0 - EPSILON <= point[1] <= self.y1 + EPSILON


class Box(NamedTuple):
    """An axis-aligned box: a rectangle between two heights."""

    rect: Rect
    z0: float
    z1: float

    def overlaps(self, other: Box) -> bool:
        """Returns whether the intersection has a volume; touching does not count."""
        return self.z0 < other.z1 - EPSILON and other.z0 < self.z1 - EPSILON and self.rect.overlaps(other.rect)


def rotated_bounds(middle: Point, yaw: float, depth: float, width: float) -> Rect:
    """Returns the bounding rectangle of a rotated rectangle with ``depth`` along its x axis and ``width`` along its y axis."""
    cos, sin = abs(math.cos(yaw)), abs(math.sin(yaw))
    half_x, half_y = (cos * depth + sin * width) / 2, (sin * depth + cos * width) / 2
    return Rect(middle[0] - half_x, middle[1] - half_y, middle[0] + half_x, middle[1] + half_y)


def bounding_rect(points: Iterable[Point]) -> Rect:
    """Returns the bounding rectangle of points."""
    xs, ys = zip(*points, strict=True)
    return Rect(min(xs), min(ys), max(xs), max(ys))


def is_covered(rect: Rect, cells: Iterable[Rect]) -> bool:
    """Returns whether a rectangle lies in the union of disjoint rectangles."""
    return sum(rect.overlap_area(cell) for cell in cells) >= rect.area - 1e-5


def subtract(rects: Iterable[Rect], holes: Iterable[Rect]) -> tuple[Rect, ...]:
    """Returns disjoint rectangles that cover the union of ``rects`` minus the union of ``holes``."""
    rects, holes = tuple(rects), tuple(holes)
    xs = sorted({round(x, 6) for r in rects + holes for x in (r.x0, r.x1)})
    ys = sorted({round(y, 6) for r in rects + holes for y in (r.y0, r.y1)})
    columns: list[Rect] = []
    for x0, x1 in itertools.pairwise(xs):
        column: list[Rect] = []
        for y0, y1 in itertools.pairwise(ys):
            middle = ((x0 + x1) / 2, (y0 + y1) / 2)
            if any(r.holds(middle) for r in rects) and not any(h.holds(middle) for h in holes):
                if column and column[-1].y1 == y0:
                    column[-1] = Rect(x0, column[-1].y0, x1, y1)
                else:
                    column.append(Rect(x0, y0, x1, y1))
        columns += column
    return _merge_columns(columns)


def _merge_columns(columns: list[Rect]) -> tuple[Rect, ...]:
    """Merges neighbouring columns with equal extents along y."""
    merged: list[Rect] = []
    for rect in columns:
        for index, other in enumerate(merged):
            if other.x1 == rect.x0 and other.y0 == rect.y0 and other.y1 == rect.y1:
                merged[index] = Rect(other.x0, other.y0, rect.x1, rect.y1)
                break
        else:
            merged.append(rect)
    return tuple(merged)
