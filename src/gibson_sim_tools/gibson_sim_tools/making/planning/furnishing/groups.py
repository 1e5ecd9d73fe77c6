"""Places groups of furniture: table with chairs, desk with chair and monitor, single pieces at walls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.planning.rectangles import Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

Group = tuple[list[FurnishingItem], list[Rect]]


def place_at_wall(
    room: FurnishedRoom,
    kind: str,
    score: Callable[[WallFace, float], float] | None = None,
    **fixed: float,
) -> FurnishingItem | None:
    """Places a piece with its back to a wall and its front free; returns it, or None if it does not fit."""
    size = room.size(kind, **fixed)
    front = CATALOGUE[kind].front
    placed = room.place_first(
        ([item], [item.front(front)] if front > 0.1 else [])
        for item in (room.on_wall(kind, face, along, size) for face, along in room.wall_positions(size[1] + 0.02, score=score))
    )
    return placed[0] if placed else None


def place_body_at_wall(
    room: FurnishedRoom, model: str, front: float, score: Callable[[WallFace, float], float] | None = None
) -> FurnishingItem | None:
    """Places a movable body with its back to a wall; returns it, or None if it does not fit."""
    size = SIZES[model]
    placed = room.place_first(
        ([item], [item.front(front)])
        for item in (
            FurnishingItem(model, face.point(along, size[0] / 2 + 0.02), face.yaw, size, movable=True)
            for face, along in room.wall_positions(size[1] + 0.04, score=score)
        )
    )
    return placed[0] if placed else None


def wall_of(room: FurnishedRoom, item: FurnishingItem) -> WallFace | None:
    """Returns the wall behind an item; None if the item is free-standing."""
    behind = item.point_ahead(-item.size[0] / 2 - 0.05)
    for face in room.view.sides:
        along = (behind[0] - face.start[0]) * face.along[0] + (behind[1] - face.start[1]) * face.along[1]
        distance = (behind[0] - face.start[0]) * face.normal[0] + (behind[1] - face.start[1]) * face.normal[1]
        if (
            face.low <= along <= face.high
            and -0.2 < distance < 0.05
            and abs(math.remainder(face.yaw - item.yaw, 2 * math.pi)) < 0.01
        ):
            return face
    return None


def near_corner(room: FurnishedRoom, width: float) -> Callable[[WallFace, float], float]:
    """Returns a score that is higher near the ends of walls."""
    return lambda face, along: -2.5 * room.corner_gap(face, along, width)


def far_from_doors(room: FurnishedRoom) -> Callable[[WallFace, float], float]:
    """Returns a score that is higher far from doors."""
    return lambda face, along: room.distance_to_doors(face.point(along, 0.5))


def floor_points(room: FurnishedRoom, score: Callable[[Point], float], step: float = 0.2) -> Iterator[Point]:
    """Yields points of the free floor, the highest score first."""
    scored = []
    for cell in room.view.cells:
        for column in range(int(cell.width / step) + 1):
            for row in range(int(cell.depth / step) + 1):
                point = (round(cell.x0 + column * step, 3), round(cell.y0 + row * step, 3))
                scored.append((score(point) + 0.3 * float(room.rng.random()), point))
    scored.sort(key=lambda entry: -entry[0])
    yield from (point for _, point in scored)


def table_group(
    room: FurnishedRoom,
    table: FurnishingItem,
    chair: str,
    chair_size: tuple[float, float, float],
    sides: Sequence[int],
    heads: int,
) -> Group:
    """Returns a table with chairs that face it, and the zones behind the chairs that stay free.

    Args:
        room: the room.
        table: the table, its long sides along its y axis.
        chair: kind of chair, or ``chair_wooden``.
        chair_size: size of a chair.
        sides: number of chairs at the front and at the back of the table.
        heads: number of chairs at its ends, 0 to 2.
    """
    movable = chair not in CATALOGUE
    distance = table.size[0] / 2 + 0.03 + chair_size[0] / 2
    items, fronts = [table], []
    for sign, count in zip((1, -1), sides, strict=True):
        for n in range(count):
            aside = table.size[1] * ((n + 0.5) / count - 0.5)
            yaw = _wrapped(table.yaw + (math.pi if sign > 0 else 0.0))
            seat = FurnishingItem(chair, table.point_ahead(sign * distance, aside), yaw, chair_size, movable=movable)
            items.append(seat)
            fronts.append(rotated_bounds(seat.point_ahead(-chair_size[0] / 2 - 0.15), yaw, 0.3, chair_size[1]))
    for n in range(heads):
        sign = 1 if n == 0 else -1
        yaw = _wrapped(table.yaw - sign * math.pi / 2)
        seat = FurnishingItem(
            chair, table.point_ahead(0.0, sign * (table.size[1] / 2 + 0.03 + chair_size[0] / 2)), yaw, chair_size, movable=movable
        )
        items.append(seat)
        fronts.append(rotated_bounds(seat.point_ahead(-chair_size[0] / 2 - 0.15), yaw, 0.3, chair_size[1]))
    return items, fronts


def put_table(
    room: FurnishedRoom,
    table_kind: str,
    chair: str,
    seats: Sequence[tuple[tuple[int, int], int]],
    score: Callable[[Point], float],
    *,
    at_wall: bool = False,
    apart_from: Sequence[Rect] = (),
    **fixed: float,
) -> FurnishingItem | None:
    """Places a table with chairs on the free floor, in the first seating that fits.

    Args:
        room: the room.
        table_kind: key of the catalogue.
        chair: kind of chair.
        seats: numbers of chairs at front and back, and at the ends, for each seating.
        score: score of the table's centre; the highest is best.
        at_wall: whether positions with one end or one side at a wall come first.
        apart_from: rugs that the table must not cover.
        fixed: fixed dimensions of the table.
    """
    size = room.size(table_kind, **fixed)
    chair_size = room.size(chair) if chair in CATALOGUE else SIZES[chair]
    first_yaw = float(room.rng.integers(2)) * math.pi / 2
    for sides, heads in seats:

        def groups(sides: tuple[int, int] = sides, heads: int = heads) -> Iterator[Group]:
            if at_wall:
                yield from _tables_at_walls(room, table_kind, size, chair, chair_size, sum(sides))
            for point in floor_points(room, score):
                for yaw in (first_yaw, math.pi / 2 - first_yaw):
                    table = FurnishingItem(table_kind, point, _wrapped(yaw), size)
                    if room.fits(table) and not any(table.rect.overlaps(rug) for rug in apart_from):
                        yield table_group(room, table, chair, chair_size, sides, heads)

        placed = room.place_first(groups())
        if placed:
            return placed[0]
    return None


def _tables_at_walls(
    room: FurnishedRoom,
    kind: str,
    size: tuple[float, float, float],
    chair: str,
    chair_size: tuple[float, float, float],
    seats: int,
) -> Iterator[Group]:
    """Yields tables with one end at a wall and chairs on both sides, then with one side at a wall and chairs on the other side."""
    per_side = max(1, seats // 2)
    for face, along in room.wall_positions(size[0], score=far_from_doors(room)):
        table = FurnishingItem(kind, face.point(along, size[1] / 2 + 0.02), _wrapped(face.yaw + math.pi / 2), size)
        if room.fits(table):
            yield table_group(room, table, chair, chair_size, (per_side, per_side), 0)
    for face, along in room.wall_positions(size[1], score=far_from_doors(room)):
        table = FurnishingItem(kind, face.point(along, size[0] / 2 + 0.02), face.yaw, size)
        if room.fits(table):
            yield table_group(room, table, chair, chair_size, (min(seats, max(1, int(size[1] / 0.6))), 0), 0)


def desk_group(room: FurnishedRoom, desk: FurnishingItem, chair_size: tuple[float, float, float], *, lamp: bool) -> Group:
    """Returns a desk with chair, monitor, keyboard and optionally a lamp, and the zone behind the chair that stays free."""
    top = desk.size[2]
    chair = FurnishingItem(
        "office_chair", desk.point_ahead(desk.size[0] / 2 + 0.04 + chair_size[0] / 2), _wrapped(desk.yaw + math.pi), chair_size
    )
    monitor = room.size("monitor")
    items = [
        desk,
        chair,
        FurnishingItem("monitor", desk.point_ahead(-desk.size[0] / 2 + monitor[0] / 2 + 0.06), desk.yaw, monitor, top),
    ]
    keyboard = SIZES["keyboard"]
    items.append(
        FurnishingItem(
            "keyboard", desk.point_ahead(desk.size[0] / 2 - keyboard[0] / 2 - 0.08), desk.yaw, keyboard, top, movable=True
        )
    )
    if lamp:
        shade = room.size("desk_lamp", width=0.3)
        aside = (desk.size[1] / 2 - shade[1] / 2 - 0.03) * (1 if room.rng.random() < 0.5 else -1)
        if abs(aside) - shade[1] / 2 > monitor[1] / 2 + 0.02:
            items.append(
                FurnishingItem(
                    "desk_lamp", desk.point_ahead(-desk.size[0] / 2 + shade[0] / 2 + 0.05, aside), desk.yaw, shade, top
                )
            )
    return items, [rotated_bounds(chair.point_ahead(-chair_size[0] / 2 - 0.15), chair.yaw, 0.3, chair_size[1])]


def put_desk(room: FurnishedRoom, *, lamp: bool = True) -> bool:
    """Places a desk at a wall, preferably near a window and far from doors; returns whether it fits."""
    size, chair_size = room.size("desk"), room.size("office_chair")

    def desk_score(face: WallFace, along: float) -> float:
        point = face.point(along, 0.5)
        window = min((math.dist(point, w.face.point(w.opening.middle)) for w in room.view.windows), default=3.0)
        return 0.7 * room.distance_to_doors(point) - 0.6 * window

    return bool(
        room.place_first(
            desk_group(room, room.on_wall("desk", face, along, size, gap=0.03), chair_size, lamp=lamp)
            for face, along in room.wall_positions(size[1] + 0.04, score=desk_score)
        )
    )


def _wrapped(yaw: float) -> float:
    """Returns an angle wrapped to -pi to pi."""
    return round(math.remainder(yaw, 2 * math.pi), 6) + 0.0
