"""Rooms of a scene, with class and outline. Pure values; ``maps.rooms`` segments rooms in a map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
MAX_CORNERS = 1000
"""Maximum number of corners of a room's outline."""
_MIN_AREA = 0.01
"""Minimum area of a room, square metres."""


@dataclass(frozen=True, slots=True)
class RoomSpec:
    """A room of a building.

    Raises:
        SceneError: the outline has too few or too many corners, too small an area, or intersects itself.
    """

    name: str
    room_class: str
    """Type of the room: ``kitchen``, ``bedroom``, ``corridor``, ..."""
    floor: int
    """Index of its floor in ``SceneSpec.floors``, 0 = the lowest."""
    polygon: tuple[tuple[float, float], ...]
    """Corners in clockwise or counter-clockwise order, world metres."""

    def __post_init__(self) -> None:
        count = len(self.polygon)
        if not 3 <= count <= MAX_CORNERS:
            raise SceneError(f"room {quoted(self.name)}: polygon has {count} corners, must have 3 to {MAX_CORNERS}")
        if self.area < _MIN_AREA:
            raise SceneError(
                f"room {quoted(self.name)}: polygon has an area of {self.area:g} m^2, must be at least {_MIN_AREA} m^2; give its corners in order"
            )
        crossing = _crossing_edges(_corners(self))
        if crossing is not None:
            first, second = ((edge, (edge + 1) % count) for edge in crossing)
            raise SceneError(
                f"room {quoted(self.name)}: the edge between corners {first[0]} and {first[1]} of its polygon intersects the one between "
                f"{second[0]} and {second[1]}; give its corners in order"
            )

    @property
    def area(self) -> float:
        """Area of the outline, square metres (shoelace formula)."""
        x, y = _corners(self).T
        return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2

    def contains(self, xy: ArrayLike) -> Bools:
        """Returns (...,), whether points (..., 2), world metres, lie in the room.

        A point on the common edge of two rooms lies in exactly one of them.
        """
        x, y = np.moveaxis(np.asarray(xy, dtype=np.float64), -1, 0)
        inside = np.zeros(np.shape(x), dtype=bool)
        corners = _corners(self)
        for (x0, y0), (x1, y1) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True):
            if y0 != y1:
                inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
        return np.asarray(inside)


def room_at(rooms: Iterable[RoomSpec], x: float, y: float, floor: int) -> RoomSpec | None:
    """Returns the first room of a floor that contains a point, world metres; None = no room contains it."""
    return next((room for room in rooms if room.floor == floor and bool(room.contains((x, y)))), None)


def _corners(room: RoomSpec) -> F64:
    """Returns the corners of a room (K, 2), world metres."""
    return np.asarray(room.polygon, dtype=np.float64)


def _crossing_edges(corners: F64) -> tuple[int, int] | None:
    """Returns two edges of an outline (K, 2), as indices of their first corners, that intersect but are not adjacent; None = no such edges."""
    a, b = corners, np.roll(corners, -1, axis=0)
    count = len(corners)
    for first in range(count - 2):
        others = np.arange(first + 2, count - (first == 0))
        c, d = a[others], b[others]
        start, end = a[first], b[first]
        separated = (_side(start, end, c) * _side(start, end, d) > 0) | (_side(c, d, start) * _side(c, d, end) > 0)
        disjoint = (np.maximum(c, d) < np.minimum(start, end)).any(axis=1) | (np.minimum(c, d) > np.maximum(start, end)).any(
            axis=1
        )
        crossing = np.flatnonzero(~separated & ~disjoint)
        if len(crossing):
            return first, int(others[crossing[0]])
    return None


def _side(a: F64, b: F64, point: F64) -> F64:
    """Returns (...,): positive where a point (..., 2) is left of the line from a to b, (..., 2); broadcasts."""
    along, to = b - a, point - a
    return np.asarray(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0])
