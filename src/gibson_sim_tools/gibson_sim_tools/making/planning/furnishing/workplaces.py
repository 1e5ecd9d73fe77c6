"""Furnishes offices, meeting rooms, storage rooms, and the sales room of a shop."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gibson_sim.types import Vec3
from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.furnishing.dressing import fill_corners, hang_pictures
from gibson_sim_tools.making.planning.furnishing.groups import (
    Group,
    desk_group,
    floor_points,
    near_corner,
    place_at_wall,
    place_body_at_wall,
    put_desk,
    put_table,
)
from gibson_sim_tools.making.planning.rectangles import Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import GateView, WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_FRONT_DEPTH = 0.4
"""Free depth behind the front, in addition to shelf and aisle, m."""


def furnish_office(room: FurnishedRoom) -> bool:
    """Furnishes an office for one to three people."""
    if not put_desk(room):
        return False
    for _ in range(2 if room.view.area > 15.0 else 1):
        if room.rng.random() < 0.75:
            put_desk(room)
    place_at_wall(room, "filing_cabinet", near_corner(room, 0.42))
    place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    if room.rng.random() < 0.5:
        place_body_at_wall(room, "cabinet_drawers", 0.7, near_corner(room, 0.6))
    if room.rng.random() < 0.5:
        _hang_board(room)
    fill_corners(room, "plant", int(room.rng.integers(3)))
    hang_pictures(room, int(room.rng.integers(1, 3)))
    return True


def furnish_open_office(room: FurnishedRoom) -> bool:
    """Furnishes an open plan office: parallel islands of facing desks; cabinets and a printer along the walls."""
    turn, columns = float(room.rng.integers(2)) * math.pi / 2, 2 + int(room.rng.integers(2))
    sizes = (room.size("desk", width=1.4), room.size("office_chair"), room.size("partition"))
    islands = sum(_put_island(room, columns, turn, *sizes) for _ in range(5))
    if not islands:
        return False
    place_at_wall(room, "printer", near_corner(room, 0.6))
    for _ in range(int(room.rng.integers(2, 5))):
        place_at_wall(room, "filing_cabinet", near_corner(room, 0.42))
    place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    _hang_board(room)
    fill_corners(room, "plant", 3)
    hang_pictures(room, 3)
    return True


def _put_island(room: FurnishedRoom, columns: int, turn: float, size: Vec3, chair: Vec3, screen: Vec3) -> bool:
    """Places two rows of facing desks with partitions between, aligned with other islands, with fewer desks if needed; returns whether it fits."""
    others = [p.middle for p in room.items if p.kind == "partition"]

    def island_score(point: Point) -> float:
        is_aligned = any(abs(point[axis] - o[axis]) < 0.02 for o in others for axis in (0, 1))
        return (
            (1.5 if is_aligned else 0.0)
            - 0.2 * min((math.dist(point, o) for o in others), default=0.0)
            + 0.1 * room.distance_to_doors(point)
        )

    def groups(count: int) -> Iterator[Group]:
        for point in floor_points(room, island_score, 0.35):
            yield _island(room, FurnishingItem("partition", point, round(turn, 6), screen), size, chair, count)

    return any(room.place_first(groups(count)) for count in (columns, columns - 1))


def _island(room: FurnishedRoom, middle: FurnishingItem, size: Vec3, chair: Vec3, columns: int) -> Group:
    """Returns an island of desks around a central item; the partitions are along its y axis."""
    items: list[FurnishingItem] = []
    fronts: list[Rect] = []
    for column in range(columns):
        aside = (column + 0.5 - columns / 2) * (size[1] + 0.02)
        items.append(
            FurnishingItem("partition", middle.point_ahead(0.0, aside), middle.yaw, (middle.size[0], size[1], middle.size[2]))
        )
        for sign in (1, -1):
            yaw = round(math.remainder(middle.yaw + (0.0 if sign > 0 else math.pi), 2 * math.pi), 6)
            desk = FurnishingItem("desk", middle.point_ahead(sign * (middle.size[0] / 2 + 0.01 + size[0] / 2), aside), yaw, size)
            desk_items, front = desk_group(room, desk, chair, lamp=False)
            items += desk_items
            fronts += front
    return items, fronts


def _hang_board(room: FurnishedRoom) -> None:
    """Hangs a whiteboard with free floor in front of it."""
    size, lift = room.size("whiteboard"), room.lift("whiteboard")
    room.place_first(
        ([item], [item.front(0.8)])
        for item in (
            room.on_wall("whiteboard", face, along, size, lift, 0.005)
            for face, along in room.wall_positions(size[1] + 0.2, step=0.2)
        )
    )


def furnish_meeting(room: FurnishedRoom) -> bool:
    """Furnishes a meeting room: a large central table, a whiteboard or a screen at its end."""
    middle = room.view.cells[0].middle
    width = 2.6 if room.view.area > 19.0 else 2.0
    seats = [((3, 3), 2), ((3, 3), 1), ((3, 3), 0), ((2, 2), 0)] if width > 2.2 else [((2, 2), 2), ((2, 2), 0)]
    table = put_table(
        room, "meeting_table", "office_chair", seats, lambda point: -2.0 * math.dist(point, middle), width=width, depth=1.05
    )
    if not table:
        return False
    if room.rng.random() < 0.5:
        _hang_board(room)
    else:
        _hang_screen(room, table)
    place_at_wall(room, "sideboard", near_corner(room, 1.5))
    fill_corners(room, "plant", 1 + int(room.rng.integers(2)))
    hang_pictures(room, 2)
    return True


def _hang_screen(room: FurnishedRoom, table: FurnishingItem) -> None:
    """Hangs a large screen on the wall at one end of the table."""
    size = room.size("television", width=1.4, height=0.8)

    def screen_score(face: WallFace, along: float) -> float:
        distance = min(math.dist(face.point(along), table.point_ahead(0.0, s * table.size[1])) for s in (1, -1))
        return -3.0 * distance

    room.place_first(
        ([room.on_wall("television", face, along, size, 1.05, 0.02)], [])
        for face, along in room.wall_positions(1.6, score=screen_score)
    )


def furnish_storage(room: FurnishedRoom) -> bool:
    """Furnishes a storage room: shelves and stacked crates; in homes a wardrobe and a washing machine."""
    if not room.workplace:
        place_at_wall(room, "wardrobe", near_corner(room, 1.2), width=1.2)
        place_at_wall(room, "washing_machine", near_corner(room, 0.6))
        place_at_wall(room, "bookshelf", near_corner(room, 0.8), width=0.8)
        return True
    for width in (2.4, 2.0, 2.0) if room.view.area > 6.0 else (1.5, 1.5):
        place_at_wall(room, "wall_shelf", near_corner(room, width), width=width)
    for _ in range(int(room.rng.integers(2, 5))):
        place_at_wall(room, "crate_stack", near_corner(room, 0.55))
    return True


def furnish_shop(room: FurnishedRoom) -> bool:
    """Furnishes a sales room: checkout near the entrance, fridge and shelves along the walls, rows of gondolas between."""
    entrance = next(gate for gate in room.view.gates if not gate.other_room)
    if not _put_till(room, entrance) or not place_at_wall(room, "display_fridge", near_corner(room, 1.8)):
        return False
    aisle = round(float(room.rng.uniform(1.15, 1.35)), 2)
    if not _put_gondolas(room, entrance, aisle):
        return False
    _line_walls(room)
    fill_corners(room, "plant", 2)
    return True


def _line_walls(room: FurnishedRoom) -> None:
    """Lines the walls with shelves, of equal width within each free interval."""
    depth, _, height = room.size("wall_shelf")
    for face in room.view.sides:
        for low, high in room.free_intervals(face, depth + 0.02, height):
            count = max(1, math.ceil((high - low) / 3.0))
            width = math.floor((high - low) / count * 100.0) / 100.0 - 0.01
            if width < 1.5:
                continue
            for n in range(count):
                shelf = room.on_wall("wall_shelf", face, low + (high - low) * (n + 0.5) / count, (depth, width, height))
                room.place([shelf], [shelf.front(0.9)])


def _put_till(room: FurnishedRoom, entrance: GateView) -> bool:
    """Places the checkout counter beside the entrance, facing it, with free floor for the cashier."""
    size = room.size("till")
    face, middle = entrance.face, entrance.opening.middle
    signs = (1, -1) if room.rng.random() < 0.5 else (-1, 1)

    def groups() -> Iterator[Group]:
        for aside in (1.5, 1.3, 1.8, 2.2, 2.6):
            for off in (0.5, 0.9, 1.3, 0.3):
                for sign in signs:
                    # Its front faces along the wall, towards the entrance.
                    yaw = math.atan2(-sign * face.along[1], -sign * face.along[0])
                    point = face.point(middle + sign * (aside + size[0] / 2), off + size[1] / 2)
                    till = FurnishingItem("till", point, round(yaw, 6) + 0.0, size)
                    behind = rotated_bounds(till.point_ahead(-size[0] / 2 - 0.4), yaw, 0.8, size[1])
                    yield [till], [till.front(0.9), behind]

    return bool(room.place_first(groups()))


def _put_gondolas(room: FurnishedRoom, entrance: GateView, aisle: float) -> int:
    """Fills the centre of the largest part of the room with rows of gondolas; returns their number."""
    # Shelves line the walls, with an aisle in front of them.
    inner = _without_front_strip(_largest(room), entrance).grown(-0.47 - aisle)
    depth, _, height = room.size("gondola")
    upright, rows, per_row, length = max(
        (_fill_with_gondolas(inner, upright, depth, aisle) for upright in (True, False)),
        key=lambda filling: filling[1] * filling[2] * filling[3],
    )
    across, along = (inner.width, inner.depth) if upright else (inner.depth, inner.width)
    gap = aisle if per_row * (length + aisle) - aisle <= along + 1e-6 else 0.0
    row_distance = (across - depth) / (rows - 1) if rows > 1 else 0.0
    count = 0
    for row in range(rows):
        off = depth / 2 + row * row_distance if rows > 1 else across / 2
        for n in range(per_row):
            at = along / 2 + (n - (per_row - 1) / 2) * (length + gap)
            count += _put_gondola(room, inner, upright, off, at, (depth, length, height), aisle)
    return count


def _fill_with_gondolas(inner: Rect, upright: bool, depth: float, aisle: float) -> tuple[bool, int, int, float]:
    """Computes rows of gondolas in a rectangle; returns ``upright``, number of rows, gondolas per row, length of each, m."""
    across, along = (inner.width, inner.depth) if upright else (inner.depth, inner.width)
    rows = max(0, int((across + aisle) / (depth + aisle) + 1e-6))
    per_row = 1 if along <= 4.0 else 2
    gap = aisle if along > 5.0 else 0.0
    length = round(min(4.0, (along - (per_row - 1) * gap) / per_row) - 0.005, 2)
    return upright, rows if length >= 2.0 else 0, per_row, length


def _largest(room: FurnishedRoom) -> Rect:
    """Returns the largest rectangle within the walls."""
    cells = room.view.cells
    xs, ys = sorted({x for c in cells for x in (c.x0, c.x1)}), sorted({y for c in cells for y in (c.y0, c.y1)})
    rects = (Rect(x0, y0, x1, y1) for x0 in xs for x1 in xs for y0 in ys for y1 in ys if x0 < x1 and y0 < y1)
    return max((r for r in rects if room.view.holds(r)), key=lambda r: r.area)


def _put_gondola(
    room: FurnishedRoom, inner: Rect, upright: bool, off: float, at: float, size: tuple[float, float, float], aisle: float
) -> bool:
    """Places one gondola, shortened if an obstacle is at its end; returns whether it fits."""
    for length in (size[1], size[1] - 0.6, size[1] - 1.2):
        for shift in (0.0, (size[1] - length) / 2, (length - size[1]) / 2):
            if length < 2.0:
                return False
            middle = (inner.x0 + off, inner.y0 + at + shift) if upright else (inner.x0 + at + shift, inner.y0 + off)
            item = FurnishingItem(
                "gondola", middle, 0.0 if upright else round(math.pi / 2, 6), (size[0], round(length, 2), size[2])
            )
            depth = min(1.0, aisle - 0.05)
            if room.place(
                [item], [item.front(depth), rotated_bounds(item.point_ahead(-(size[0] + depth) / 2), item.yaw, depth, length)]
            ):
                return True
    return False


def _without_front_strip(hall: Rect, entrance: GateView) -> Rect:
    """Returns a rectangle without a strip along the wall with the entrance."""
    x, y = entrance.face.normal
    return Rect(
        hall.x0 + _FRONT_DEPTH * max(x, 0.0),
        hall.y0 + _FRONT_DEPTH * max(y, 0.0),
        hall.x1 + _FRONT_DEPTH * min(x, 0.0),
        hall.y1 + _FRONT_DEPTH * min(y, 0.0),
    )
