"""Furnishes offices, meeting rooms and storage rooms."""

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
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem


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
