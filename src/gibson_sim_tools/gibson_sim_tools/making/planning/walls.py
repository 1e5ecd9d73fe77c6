"""Derives walls from rooms, places doors, passages and windows in them, and adds door leaves with their opening angles.

Each edge between two rooms, or between a room and the outside, becomes a wall with one room on each side. Most leaves are open, so that a robot
can reach every room.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gibson_sim_tools.making.building import Body, Opening, Point, Storey, Wall
from gibson_sim_tools.making.planning.layout import OUTSIDE_THICKNESS, Level, Space, SpaceLink
from gibson_sim_tools.making.planning.objects import DOOR_HEIGHT, door_body, door_model
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.rooms import WallFace, door_zones, face_of, window_zone

_OUTSIDE = -1
_MARGIN = 0.24
"""Distance from the end of a wall's centre line to an opening, m: half a wall thickness plus the clearance of a door."""
_OPEN_ANGLES = (1.15, 1.35, 1.5, 1.55)
"""Hinge angles of open doors, radians."""
_OPEN_POSITIONS = (0.75, 0.88)
"""Joint positions of open sliding doors, m."""


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


def with_doors(walls: tuple[Wall, ...], links: tuple[SpaceLink, ...], rng: np.random.Generator) -> tuple[Wall, ...] | None:
    """Adds a door or a passage for each link to the walls; returns None if one does not fit."""
    current = list(walls)
    for link in links:
        candidates = [(index, opening) for index, wall in enumerate(current) for opening in _candidate_openings(wall, link, rng)]
        if link.near is not None:
            near = link.near
            candidates.sort(key=lambda place: round(math.dist(_point_on_wall(current[place[0]], place[1].middle), near), 3))
        for index, opening in candidates:
            if _is_free(current, current[index], opening):
                current[index] = replace(current[index], openings=(*current[index].openings, opening))
                break
        else:
            return None
    return tuple(current)


def _point_on_wall(wall: Wall, along: float) -> Point:
    """Returns a point on a wall's centre line."""
    part = along / math.dist(wall.start, wall.end)
    return (wall.start[0] + (wall.end[0] - wall.start[0]) * part, wall.start[1] + (wall.end[1] - wall.start[1]) * part)


def _candidate_openings(wall: Wall, link: SpaceLink, rng: np.random.Generator) -> list[Opening]:
    """Returns candidate openings for a link in a wall, the best first: doors near a corner, with the hinge on that side."""
    if {wall.left, wall.right} != {link.from_room, link.to_room}:
        return []
    length = math.dist(wall.start, wall.end)
    low, high = _MARGIN + link.width / 2, length - _MARGIN - link.width / 2
    if low > high:
        return []
    middles = [float(m) for m in np.linspace(low, high, max(2, math.ceil((high - low) / 0.1)))]
    order = sorted(middles, key=lambda m: min(m - low, high - m) + 0.01 * rng.random())
    return [_opening(wall, link, round(m, 3), "start" if m - low < high - m else "end") for m in order]


def _opening(wall: Wall, link: SpaceLink, middle: float, hinge: str) -> Opening:
    """Returns the door or passage for a link."""
    if link.kind == "passage":
        return Opening("passage", middle, link.width, 0.0, 2.1)
    swing = 1 if wall.left == link.to_room else -1
    if link.sliding:
        return Opening("door", middle, 0.9, 0.0, DOOR_HEIGHT, swing, "end" if hinge == "start" else "start", "sliding_door_90")
    side = "start" if hinge == "start" else "end"
    return Opening("door", middle, link.width, 0.0, DOOR_HEIGHT, swing, side, door_model(link.width, swing, side))  # type: ignore[arg-type]


def _is_free(walls: list[Wall], wall: Wall, opening: Opening) -> bool:
    """Returns whether an opening is clear of the leaves of other doors, and its leaf clear of other openings."""
    for room in (wall.left, wall.right):
        if not room:
            continue
        zones = door_zones(face_of(wall, room), opening)
        for other_wall in walls:
            if room not in (other_wall.left, other_wall.right):
                continue
            face = face_of(other_wall, room)
            for other in other_wall.openings:
                is_too_close = (
                    0.3
                    if other_wall is wall and abs(other.middle - opening.middle) < (other.width + opening.width) / 2 + 0.3
                    else 0.0
                )
                has_swing = _swings_to(face, other) or _swings_to(face_of(wall, room), opening)
                if is_too_close or (has_swing and any(a.overlaps(b) for a in zones for b in door_zones(face, other))):
                    return False
    if opening.body.startswith("sliding"):
        length = math.dist(wall.start, wall.end)
        reach = opening.middle + (1.5 if opening.hinge == "end" else -1.5)
        return 0.1 < reach < length - 0.1
    return True


def _swings_to(face: WallFace, opening: Opening) -> bool:
    """Returns whether the leaf of an opening swings to this side of its wall."""
    return opening.kind == "door" and opening.swing == face.side


_WINDOWS: dict[str, tuple[float, float, float, float]] = {
    # Minimum and maximum width, sill, height, m.
    "living": (1.4, 2.1, 0.9, 1.35),
    "bedroom": (1.1, 1.6, 0.9, 1.3),
    "study": (1.1, 1.5, 0.9, 1.3),
    "kitchen": (0.9, 1.2, 1.08, 1.1),
    "kitchenette": (0.9, 1.2, 1.08, 1.1),
    "bathroom": (0.5, 0.7, 1.35, 0.75),
    "toilet": (0.4, 0.6, 1.35, 0.7),
    "hall": (0.7, 0.9, 0.9, 1.25),
    "corridor": (0.7, 1.0, 0.9, 1.25),
    "storage": (0.6, 0.8, 1.4, 0.7),
    "office": (1.3, 1.7, 0.9, 1.5),
    "open_office": (1.4, 1.8, 0.9, 1.5),
    "meeting": (1.3, 1.7, 0.9, 1.5),
    "shop": (1.8, 2.6, 0.45, 1.95),
}
_SEVERAL_WINDOWS = ("living", "open_office", "meeting", "office", "shop", "bedroom")
"""Kinds of rooms with several windows per wall, and in more than one wall."""


def with_windows(
    walls: tuple[Wall, ...], level: Level, keep_off: tuple[Rect, ...], front: Rect, rng: np.random.Generator
) -> tuple[Wall, ...]:
    """Adds windows to the outside walls.

    Args:
        walls: walls of the storey, with their doors.
        level: layout of the storey.
        keep_off: stairs; no windows are placed beside them.
        front: side of the entrance; a shop has windows only on that side.
        rng: samples number and width.
    """
    current = list(walls)
    for space in level.spaces:
        if space.name in level.windowless:
            continue
        outer = [n for n, w in enumerate(current) if {w.left, w.right} == {space.name, ""} and math.dist(w.start, w.end) > 1.2]
        outer.sort(key=lambda n: -round(math.dist(current[n].start, current[n].end), 2))
        if space.kind == "shop":
            outer = [n for n in outer if front.holds(_point_on_wall(current[n], math.dist(current[n].start, current[n].end) / 2))]
        for rank, index in enumerate(outer):
            if rank and (space.kind not in _SEVERAL_WINDOWS or rng.random() > 0.55):
                continue
            wall = current[index]
            new_windows = tuple(
                o
                for o in _windows(wall, space.kind, rng)
                if not any(window_zone(face_of(wall, space.name), o).overlaps(r) for r in keep_off)
            )
            current[index] = replace(wall, openings=wall.openings + new_windows)
    return tuple(current)


def _windows(wall: Wall, kind: str, rng: np.random.Generator) -> list[Opening]:
    """Returns evenly spaced windows for a wall, clear of its doors."""
    min_width, max_width, sill, height = _WINDOWS[kind]
    target_width = round(float(rng.uniform(min_width, max_width)), 2)
    windows: list[Opening] = []
    for start, end in _between_doors(wall):
        width = round(min(target_width, end - start - 0.3), 2)
        if width < 0.35 or (kind in _SEVERAL_WINDOWS and width < 0.7 * min_width) or (windows and kind not in _SEVERAL_WINDOWS):
            continue
        count = max(1, int((end - start + 0.3) / (width + (0.5 if kind == "shop" else 1.3)))) if kind in _SEVERAL_WINDOWS else 1
        shift = float(rng.uniform(-0.2, 0.2)) * max(0.0, end - start - width - 0.8) if count == 1 else 0.0
        positions = (round(start + (end - start) * (n + 0.5) / count + shift, 3) for n in range(count))
        windows += [Opening("window", position, width, sill, height) for position in positions]
    return windows


def _between_doors(wall: Wall) -> list[tuple[float, float]]:
    """Returns the intervals of a wall between its doors, the longest first."""
    low, high = 0.3, math.dist(wall.start, wall.end) - 0.3
    parts = []
    for door in sorted(wall.openings, key=lambda o: o.middle):
        parts.append((low, door.middle - door.width / 2 - 0.25))
        low = door.middle + door.width / 2 + 0.25
    return sorted([*parts, (low, high)], key=lambda part: part[0] - part[1])


def hang_doors(storeys: Sequence[Storey], rng: np.random.Generator) -> list[Body]:
    """Returns the leaves of all doors.

    Outside doors are closed, and at most one inside door per storey, if all rooms remain connected without it.
    """
    bodies: list[Body] = []
    for storey in storeys:
        doors = [(wall, opening) for wall in storey.walls for opening in wall.openings if opening.kind == "door"]
        closable = [
            wall for wall, _ in doors if wall.left and wall.right and _all_connected([w for w in storey.walls if w is not wall])
        ]
        closed = closable[int(rng.integers(len(closable)))] if closable and rng.random() < 0.5 else None
        for wall, opening in doors:
            outer = not (wall.left and wall.right)
            angle = float(rng.choice(_OPEN_POSITIONS if opening.body.startswith("sliding") else _OPEN_ANGLES))
            room = wall.left if opening.swing > 0 else wall.right
            stem = "front_door" if outer else f"{room}_door_closed" if wall is closed else f"{room}_door"
            same_names = sum(b.name == stem or b.name.startswith(f"{stem}_") for b in bodies)
            bodies.append(
                door_body(
                    f"{stem}_{same_names + 1}" if same_names else stem,
                    wall,
                    opening,
                    storey.floor_z,
                    0.0 if outer or wall is closed else angle,
                )
            )
    return bodies


def _all_connected(walls: Sequence[Wall]) -> bool:
    """Returns whether the doors and passages in these walls connect all rooms."""
    pairs = [(w.left, w.right) for w in walls if w.left and w.right and any(o.kind != "window" for o in w.openings)]
    rooms = {room for w in walls for room in (w.left, w.right) if room}
    reached = {min(rooms)}
    while new_rooms := {room for pair in pairs for room in pair if reached & set(pair)} - reached:
        reached |= new_rooms
    return reached == rooms
