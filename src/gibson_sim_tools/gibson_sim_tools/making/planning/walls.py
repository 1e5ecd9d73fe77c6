"""Derives walls from rooms: each edge between two rooms, or between a room and the outside, becomes a wall with one room on each side."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from gibson_sim_tools.making.building import Point, Wall
from gibson_sim_tools.making.planning.layout import OUTSIDE_THICKNESS, Space

_OUTSIDE = -1


def walls_of(spaces: Sequence[Space], partition: float, height: float) -> tuple[Wall, ...]:
    """Returns the walls of a storey, split where other walls meet them, so that each has one room on each side.

    Args:
        spaces: the rooms.
        partition: thickness of inside walls, metres.
        height: height of all walls, metres.
    """
    xs = sorted({x for s in spaces for r in s.rects for x in (r.x0, r.x1)})
    ys = sorted({y for s in spaces for r in s.rects for y in (r.y0, r.y1)})
    labels = [[_room_at(spaces, ((x0 + x1) / 2, (y0 + y1) / 2)) for y0, y1 in _pairs(ys)] for x0, x1 in _pairs(xs)]

    def label(i: int, j: int) -> int:
        return labels[i][j] if 0 <= i < len(labels) and 0 <= j < len(labels[0]) else _OUTSIDE

    runs_along_y = [_runs([(label(i - 1, j), label(i, j)) for j in range(len(ys) - 1)]) for i in range(len(xs))]
    runs_along_x = [_runs([(label(i, j), label(i, j - 1)) for i in range(len(xs) - 1)]) for j in range(len(ys))]
    names = [s.name for s in spaces]
    walls = [
        _wall((xs[i], ys[a]), (xs[i], ys[b]), pair, names, partition, height)
        for i, runs in enumerate(runs_along_y)
        for a, b, pair in runs
    ]
    walls += [
        _wall((xs[a], ys[j]), (xs[b], ys[j]), pair, names, partition, height)
        for j, runs in enumerate(runs_along_x)
        for a, b, pair in runs
    ]
    return _split(walls)


def outline(space: Space) -> tuple[Point, ...]:
    """Returns the corners of a space, counter-clockwise, without collinear points."""
    walls = walls_of([space], OUTSIDE_THICKNESS, 1.0)
    next_corner = {(wall.start if wall.left else wall.end): (wall.end if wall.left else wall.start) for wall in walls}
    first = min(next_corner)
    corners = [first]
    while next_corner[corners[-1]] != first:
        corners.append(next_corner[corners[-1]])
    return tuple(
        c
        for previous, c, following in zip([corners[-1], *corners[:-1]], corners, [*corners[1:], first], strict=True)
        if _bends(previous, c, following)
    )


def _bends(previous: Point, corner: Point, following: Point) -> bool:
    """Returns whether an axis-aligned path bends at a corner."""
    return not (previous[0] == corner[0] == following[0] or previous[1] == corner[1] == following[1])


def _pairs(values: Sequence[float]) -> list[tuple[float, float]]:
    """Returns the pairs of consecutive values."""
    return list(itertools.pairwise(values))


def _room_at(spaces: Sequence[Space], point: Point) -> int:
    """Returns the index of the room at a point, or ``_OUTSIDE``."""
    return next((n for n, space in enumerate(spaces) if any(r.holds(point) for r in space.rects)), _OUTSIDE)


def _runs(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int, tuple[int, int]]]:
    """Returns the runs of equal (left, right) pairs whose sides differ: first edge, last edge, pair."""
    runs: list[tuple[int, int, tuple[int, int]]] = []
    for index, pair in enumerate(pairs):
        if pair[0] == pair[1]:
            continue
        if runs and runs[-1][1] == index and runs[-1][2] == pair:
            runs[-1] = (runs[-1][0], index + 1, pair)
        else:
            runs.append((index, index + 1, pair))
    return runs


def _wall(start: Point, end: Point, pair: tuple[int, int], names: Sequence[str], partition: float, height: float) -> Wall:
    """Returns the wall between two rooms, left and right of its direction."""
    left, right = (names[n] if n != _OUTSIDE else "" for n in pair)
    return Wall(start, end, partition if left and right else OUTSIDE_THICKNESS, height, left, right)


def _split(walls: list[Wall]) -> tuple[Wall, ...]:
    """Splits walls at the ends of other walls; where four rooms meet in pairs, a run continues through the joint."""
    ends = sorted({p for w in walls for p in (w.start, w.end)})
    split = []
    for wall in walls:
        joints = [p for p in ends if wall.start[0] <= p[0] <= wall.end[0] and wall.start[1] <= p[1] <= wall.end[1]]
        split += [Wall(a, b, wall.thickness, wall.height, wall.left, wall.right) for a, b in itertools.pairwise(joints)]
    return tuple(split)
