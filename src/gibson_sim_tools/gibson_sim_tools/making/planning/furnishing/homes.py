"""Furnishes living rooms, bedrooms, studies and halls."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.furnishing.dressing import fill_corners, hang_above, hang_pictures
from gibson_sim_tools.making.planning.furnishing.groups import (
    Group,
    far_from_doors,
    near_corner,
    place_at_wall,
    place_body_at_wall,
    put_desk,
    put_table,
    wall_of,
)
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

_VIEWING_GAP = 0.8
"""Minimum depth of free floor in front of a television, m."""
_TABLE_GAP = 0.4
"""Distance from the sofa to the table in front of it, m."""


def furnish_living(room: FurnishedRoom) -> bool:
    """Furnishes a living room: sofa and television, a dining table if it is large; shelves, plants, pictures."""
    if not _put_sofa(room):
        return False
    sofa = next(p for p in room.items if p.kind == "sofa")
    wall_behind = wall_of(room, sofa)
    if wall_behind:
        hang_above(room, "painting", sofa, wall_behind)
    if room.view.area > 17.0:
        table = put_table(
            room,
            "dining_table",
            "chair_wooden" if room.rng.random() < 0.3 else "chair",
            [((2, 2), 2), ((2, 2), 0), ((1, 1), 0)] if room.rng.random() < 0.5 else [((2, 2), 0), ((1, 1), 1)],
            lambda point: min(3.0, math.dist(point, sofa.middle)) - 0.3 * _distance_to_window(room, point),
            apart_from=tuple(p.rect for p in room.items if p.kind == "rug"),
            depth=round(float(room.rng.uniform(0.75, 0.95)), 2),
            width=round(float(room.rng.uniform(1.3, 2.0 if room.view.area > 24.0 else 1.6)), 2),
        )
        if room.strict and not table and room.view.area > 20.0:
            return False
    _add_armchair(room)
    if room.rng.random() < 0.8:
        place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    if room.rng.random() < 0.5:
        board = place_at_wall(room, "sideboard")
        wall = wall_of(room, board) if board else None
        if board and wall:
            hang_above(room, "painting", board, wall)
    else:
        place_body_at_wall(room, "cabinet_doors", 0.7, near_corner(room, 0.8))
    if room.rng.random() < 0.35 and room.view.area > 22.0:
        place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    fill_corners(room, "floor_lamp", 1)
    fill_corners(room, "plant", 1 + int(room.rng.integers(2)))
    hang_pictures(room, 1 + int(room.rng.integers(3)))
    return True


def _distance_to_window(room: FurnishedRoom, point: Point) -> float:
    """Returns the distance to the nearest window, m."""
    return min((math.dist(point, w.face.point(w.opening.middle)) for w in room.view.windows), default=3.0)


def _put_sofa(room: FurnishedRoom) -> bool:
    """Places television and sofa opposite each other, with a table and a rug between; returns whether they fit."""
    sofa, board = room.size("sofa"), room.size("tv_board")
    screen, table = (
        room.size("television", width=min(board[1] - 0.1, float(room.rng.uniform(1.0, 1.4)))),
        room.size("coffee_table"),
    )
    if room.view.area < 16.0:
        sofa = (sofa[0], min(sofa[1], 1.9), sofa[2])

    has_dining_table = room.view.area > 17.0  # The sofa at one end leaves space for a table at the other.

    def sofa_score(face: WallFace, along: float) -> float:
        depth = room.view.depth_at(face, along)
        comfort = -abs(depth - 4.2) if depth < 5.4 else -0.8
        return (
            comfort
            + 0.6 * min(2.5, room.distance_to_doors(face.point(along, depth / 2)))
            - (
                0.5 * abs(room.corner_gap(face, along, board[1]) - 0.5)
                if has_dining_table
                else 0.4 * abs(along - (face.low + face.high) / 2)
            )
        )

    def groups() -> Iterator[Group]:
        for face, along in room.wall_positions(board[1] + 0.1, score=sofa_score):
            depth = room.view.depth_at(face, along)
            distances = [
                depth - 0.01 - sofa[0] / 2,
                depth - 0.17 - sofa[0] / 2,
                board[0] + 2.4 + sofa[0] / 2,
                board[0] + 2.1 + sofa[0] / 2,
            ]
            for distance in distances:
                gap = distance - sofa[0] / 2 - board[0]
                if gap < _VIEWING_GAP + _TABLE_GAP + table[0] + 0.02 or gap > 3.7:
                    continue
                yaw = round(math.remainder(face.yaw + math.pi, 2 * math.pi), 6)
                stand = room.on_wall("tv_board", face, along, board)
                yield (
                    [
                        stand,
                        room.on_wall("television", face, along, screen, max(room.lift("television"), board[2] + 0.1), 0.02),
                        FurnishingItem("sofa", face.point(along, distance), yaw, sofa),
                        FurnishingItem(
                            "coffee_table", face.point(along, distance - sofa[0] / 2 - _TABLE_GAP - table[0] / 2), face.yaw, table
                        ),
                    ],
                    # The floor between television and table stays free.
                    [stand.front(gap - _TABLE_GAP - table[0] - 0.02)],
                )

    placed = room.place_first(groups())
    if not placed:
        return False
    middle, yaw = placed[3].middle, placed[3].yaw
    size = room.size("rug")
    for scale in (1.0, 0.9, 0.8):
        if room.place(
            [
                FurnishingItem(
                    "rug", middle, yaw, (max(1.4, round(size[0] * scale, 2)), max(2.0, round(size[1] * scale, 2)), size[2])
                )
            ]
        ):
            break
    return True


def _add_armchair(room: FurnishedRoom) -> None:
    """Places an armchair at one end of the coffee table, facing it, and a side table beside the sofa, if they fit."""
    table = next(p for p in room.items if p.kind == "coffee_table")
    size = room.size("armchair")
    signs = (1, -1) if room.rng.random() < 0.5 else (-1, 1)
    for sign in signs:
        middle = table.point_ahead(0.1, sign * (table.size[1] / 2 + 0.4 + size[0] / 2))
        yaw = round(math.remainder(table.yaw - sign * math.pi / 2, 2 * math.pi), 6)
        if room.place([FurnishingItem("armchair", middle, yaw, size)]):
            break
    sofa, stand = next(p for p in room.items if p.kind == "sofa"), SIZES["table_side"]
    for sign in signs:
        middle = sofa.point_ahead(-0.1, sign * ((sofa.size[1] + stand[1]) / 2 + 0.05))
        if room.place([FurnishingItem("table_side", middle, sofa.yaw, stand, movable=True)]):
            return


def furnish_bedroom(room: FurnishedRoom) -> bool:
    """Furnishes a bedroom: bed with nightstands, wardrobe, chest of drawers, sometimes a desk."""
    double = room.view.area > 9.5 and not (room.view.room.name.endswith(("_2", "_3")) and room.rng.random() < 0.5)
    one_side = (1,) if room.rng.random() < 0.5 else (-1,)
    beds: list[tuple[str, tuple[int, ...]]] = [("double_bed", (1, -1)), ("double_bed", one_side)] if double else []
    if not (double and room.strict):
        beds.append(("single_bed", one_side))
    if not any(_put_bed(room, kind, sides) for kind, sides in beds):
        return False
    wardrobe = place_at_wall(room, "wardrobe", near_corner(room, 1.6)) or place_at_wall(
        room, "wardrobe", near_corner(room, 1.2), width=1.2
    )
    if not wardrobe:
        return False
    if room.rng.random() < (0.35 if double else 0.8):
        put_desk(room)
    has_joints = room.view.room.name in ("bedroom", "bedroom_1") or room.rng.random() < 0.4
    chest = (
        place_body_at_wall(room, "cabinet_drawers", 0.7, near_corner(room, 0.6))
        if has_joints
        else place_at_wall(room, "chest_of_drawers")
    )
    wall = wall_of(room, chest) if chest else None
    if chest and wall and room.rng.random() < 0.6:
        hang_above(room, "painting", chest, wall)
    if room.view.area > 15.0:
        _put_reading_chair(room)
        place_at_wall(room, "bookshelf", near_corner(room, 1.0), width=0.9)
    if room.rng.random() < 0.5:
        _hang_mirror(room)
    if room.rng.random() < 0.5:
        fill_corners(room, "plant", 1)
    if room.rng.random() < 0.4:
        fill_corners(room, "floor_lamp", 1)
    hang_pictures(room, int(room.rng.integers(1, 3)))
    return True


def _put_bed(room: FurnishedRoom, kind: str, sides: tuple[int, ...]) -> bool:
    """Places a bed with its head to a wall, nightstands beside it (1 = on its left, -1 = on its right), and sometimes a rug at its foot."""
    size, stand = room.size(kind), room.size("nightstand")
    width = size[1] + len(sides) * (stand[1] + 0.04)

    def bed_score(face: WallFace, along: float) -> float:
        offset = abs(along - (face.low + face.high) / 2) if kind == "double_bed" else room.corner_gap(face, along, width)
        return 1.2 * room.distance_to_doors(face.point(along, size[0] / 2)) - 0.8 * offset

    def groups() -> Iterator[Group]:
        for face, along in room.wall_positions(width, score=bed_score):
            middle = along - (sum(sides) * (stand[1] + 0.04) / 2)
            items = [room.on_wall(kind, face, middle, size, gap=0.03)]
            stands = [room.on_wall("nightstand", face, middle + s * (size[1] / 2 + 0.04 + stand[1] / 2), stand) for s in sides]
            yield items + stands, [items[0].front(0.6), *(s.front(0.35) for s in stands)]

    placed = room.place_first(groups())
    if not placed:
        return False
    bed = placed[0]
    wall = wall_of(room, bed)
    if wall and room.rng.random() < 0.7:
        hang_above(room, "painting", bed, wall)
    rug = room.size("rug")
    if room.rng.random() < 0.6:
        room.place(
            [
                FurnishingItem(
                    "rug", bed.point_ahead(size[0] / 2 - 0.2), bed.yaw, (1.4, min(rug[1], max(2.0, size[1] + 0.8)), rug[2])
                )
            ]
        )
    return True


def _hang_mirror(room: FurnishedRoom) -> None:
    """Hangs a tall mirror with free floor in front of it."""
    size = room.size("mirror")
    lift = room.lift("mirror")
    room.place_first(
        ([item], [item.front(0.7)])
        for item in (
            room.on_wall("mirror", face, along, size, lift, 0.005) for face, along in room.wall_positions(size[1] + 0.1, step=0.2)
        )
    )


def furnish_study(room: FurnishedRoom) -> bool:
    """Furnishes a study: desk, bookshelves, reading chair."""
    if not put_desk(room):
        return False
    place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    if room.view.area > 9.0:
        place_at_wall(room, "bookshelf", near_corner(room, 1.2))
    place_body_at_wall(room, "cabinet_drawers", 0.7)
    if room.rng.random() < 0.7:
        _put_reading_chair(room)
    fill_corners(room, "plant", 1)
    hang_pictures(room, int(room.rng.integers(1, 3)))
    return True


def _put_reading_chair(room: FurnishedRoom) -> None:
    """Places an armchair near a wall, far from doors."""
    size = room.size("armchair")
    room.place_first(
        ([item], [item.front(0.5)])
        for item in (
            room.on_wall("armchair", f, a, size, gap=0.1) for f, a in room.wall_positions(0.95, score=far_from_doors(room))
        )
    )


def furnish_hall(room: FurnishedRoom) -> bool:
    """Furnishes a hall or a corridor; without an entrance, only with pictures and sometimes a cabinet."""
    entrance = any(not gate.other_room for gate in room.view.gates)
    if entrance:
        if not room.workplace:
            place_at_wall(room, "shoe_cabinet", near_corner(room, 0.9), depth=0.26)
        shelf = next((p for p in room.items if p.kind == "shoe_cabinet"), None)
        wall = wall_of(room, shelf) if shelf else None
        if shelf and wall:
            size = room.size("mirror", height=0.9, width=min(0.6, shelf.size[1] - 0.1))
            along = (shelf.middle[0] - wall.start[0]) * wall.along[0] + (shelf.middle[1] - wall.start[1]) * wall.along[1]
            room.place([room.on_wall("mirror", wall, along, size, shelf.size[2] + 0.12, 0.005)])
        hang_on_wall(room, "coat_rack")
        if room.workplace or room.rng.random() < 0.5:
            fill_corners(room, "plant", 1)
    elif room.view.area > 6.0 and room.rng.random() < 0.6:
        place_body_at_wall(room, "cabinet_drawers", 0.6, near_corner(room, 0.6))
    hang_pictures(room, int(room.rng.integers(1, 4)))
    return True


def hang_on_wall(room: FurnishedRoom, kind: str) -> None:
    """Mounts a piece on a wall, with free floor in front of it."""
    size, lift = room.size(kind), room.lift(kind)
    room.place_first(
        ([item], [item.front(0.4)])
        for item in (
            room.on_wall(kind, face, along, size, lift, 0.005) for face, along in room.wall_positions(size[1] + 0.1, step=0.2)
        )
    )
