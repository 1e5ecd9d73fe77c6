"""Completes furnished rooms: radiators, curtains, pictures and plants; ceiling lamps and the light sources of all lamps; loose objects on tables,
counters and the floor.
"""

from __future__ import annotations

import math

from gibson_sim_tools.making.building import Body, Lamp
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.planning.rectangles import Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem, rounded

_ROOMS_WITH_CURTAINS = ("living", "bedroom", "study")
_COOL_ROOMS = ("office", "open_office", "meeting", "shop", "storage", "kitchenette", "corridor")
_MIN_DISTANCE = 1.3
"""Minimum distance from a pendant to the next lamp, m."""
_TABLE_KINDS = ("dining_table", "meeting_table")
_OBJECTS_ON: dict[str, tuple[str, ...]] = {
    "coffee_table": ("remote_control", "book_a", "mug", "candle", "bowl", "book_stack", "glass_tumbler"),
    "tv_board": ("vase", "remote_control", "clock", "book_b", "candle"),
    "sideboard": ("vase", "book_stack", "bowl", "candle", "clock", "teapot"),
    "dining_table": ("plate", "glass_tumbler", "bowl", "bottle_wine", "fruit_apple", "fruit_orange", "teapot", "cup", "vase"),
    "kitchen_counter": ("bottle_water", "bottle_wine", "can_food", "box_cereal", "mug", "bowl", "fruit_orange", "teapot", "cup"),
    "nightstand": ("book_b", "clock", "glass_tumbler", "mug", "candle"),
    "chest_of_drawers": ("vase", "box_small", "book_a", "clock", "candle"),
    "washing_machine": ("box_small", "bottle_water"),
    "shoe_cabinet": ("bowl", "vase", "book_b", "box_small"),
    "desk": ("pen_cup", "mug", "book_a", "book_stack", "book_b", "bottle_water"),
    "filing_cabinet": ("box_small", "book_stack", "vase"),
    "meeting_table": ("bottle_water", "glass_tumbler", "laptop", "cup", "glass_tumbler"),
    "till": ("box_small", "can_soda", "pen_cup"),
}
_COUNT_RANGES: dict[str, tuple[int, int]] = {
    "dining_table": (4, 8),
    "kitchen_counter": (1, 4),
    "meeting_table": (4, 7),
    "coffee_table": (2, 4),
    "desk": (1, 3),
}
_FLOOR_OBJECTS: dict[str, tuple[str, ...]] = {
    "living": ("basket", "toy_ball"),
    "bedroom": ("basket", "ball"),
    "study": ("bin_waste",),
    "kitchen": ("bin_waste",),
    "kitchenette": ("bin_waste",),
    "bathroom": ("bin_waste", "basket", "stool"),
    "office": ("bin_waste",),
    "open_office": ("bin_waste", "bin_waste", "box_cardboard"),
    "meeting": ("bin_waste",),
    "storage": ("box_cardboard", "box_cardboard", "box_cardboard"),
    "shop": ("basket", "box_cardboard"),
}


def hang_radiators(room: FurnishedRoom) -> None:
    """Adds a radiator below each window that is high and wide enough, except in rooms with counters."""
    if room.kind in ("kitchen", "kitchenette", "shop", "storage", "toilet"):
        return
    for window in room.view.windows:
        width = min(1.4, window.opening.width - 0.1)
        if width >= 0.6:
            size = room.size("radiator", width=width)
            room.place([room.on_wall("radiator", window.face, window.opening.middle, size, room.lift("radiator"), 0.02)])


def hang_curtains(room: FurnishedRoom) -> None:
    """Hangs curtains on both sides of each window if both fit, else none."""
    if room.kind not in _ROOMS_WITH_CURTAINS or room.rng.random() < 0.15:
        return
    for window in room.view.windows:
        size = room.size("curtain", height=min(room.height - 0.2, 2.4))
        half = (window.opening.width + size[1]) / 2
        lift = room.lift("curtain")
        room.place([room.on_wall("curtain", window.face, window.opening.middle + s * half, size, lift) for s in (-1, 1)])


def hang_above(room: FurnishedRoom, kind: str, item: FurnishingItem, face: WallFace, *, min_gap: float = 0.25) -> bool:
    """Hangs a piece on the wall above an item, centred.

    Args:
        room: the room.
        kind: kind of the piece.
        item: the item below.
        face: the wall.
        min_gap: minimum distance between the two, metres.
    """
    along = (item.middle[0] - face.start[0]) * face.along[0] + (item.middle[1] - face.start[1]) * face.along[1]
    limits = CATALOGUE[kind].lift
    low = max(limits[0], item.lift + item.size[2] + min_gap)
    size = room.size(
        kind, width=min(float(room.rng.uniform(*CATALOGUE[kind].width)), max(item.size[1] - 0.1, CATALOGUE[kind].width[0]))
    )
    return low <= limits[1] + 0.15 and room.place(
        [room.on_wall(kind, face, along, size, max(low, min(room.lift(kind), limits[1])), 0.005)]
    )


def hang_pictures(room: FurnishedRoom, count: int) -> None:
    """Hangs pictures on bare walls, centred in the free intervals."""
    hung: list[FurnishingItem] = []
    for _ in range(count):
        size, lift = room.size("painting"), room.lift("painting")

        def picture_score(face: WallFace, along: float) -> float:
            point = face.point(along)
            distance = min((math.dist(point, p.middle) for p in hung), default=3.0)
            return 2.0 * min(distance, 3.0) + min(room.corner_gap(face, along, 0.4), 1.2) - (1.0 if face.outer else 0.0)

        for face, along in room.wall_positions(size[1] + 0.3, score=picture_score, step=0.25):
            item = room.on_wall("painting", face, along, size, lift, 0.005)
            if room.place([item]):
                hung.append(item)
                break


def fill_corners(room: FurnishedRoom, kind: str, count: int) -> None:
    """Places pieces in free corners, those far from doors first."""
    for _ in range(count):
        size = room.size(kind)
        side = max(size[0], size[1])
        half = size[1] / 2 + 0.06
        corners = [
            (face, along)
            for face in room.view.sides
            for along in (face.low + half, face.high - half)
            if _in_corner(room, face, along)
        ]
        corners.sort(key=lambda spot: -room.distance_to_doors(spot[0].point(spot[1], side)) + float(room.rng.random()))
        for face, along in corners:
            if face.length > side + 0.3 and room.place([room.on_wall(kind, face, along, size, gap=0.06)]):
                break


def _in_corner(room: FurnishedRoom, face: WallFace, along: float) -> bool:
    """Returns whether the nearer end of a wall is an inside corner of the room."""
    end = face.low - 0.05 if along < (face.low + face.high) / 2 else face.high + 0.05
    return not any(cell.holds(face.point(end, 0.1)) for cell in room.view.cells)


def add_lamps(room: FurnishedRoom) -> None:
    """Adds lamps and their light sources: pendants above dining and meeting tables, panels in offices and shops, round lamps elsewhere."""
    _above_tables(room)
    panels = room.kind in ("office", "open_office", "meeting", "shop", "kitchenette")
    spacing = 3.0 if panels else 4.2
    temperature = 4000.0 if room.kind in _COOL_ROOMS and panels else 3000.0
    kind = "panel_lamp" if panels else "ceiling_lamp"
    for cell in room.view.cells:
        if min(cell.width, cell.depth) < 0.8 or cell.area < 1.5:
            continue
        for middle in _grid(cell, spacing):
            if any(math.dist(p.middle, middle) < _MIN_DISTANCE for p in room.items if p.kind == "pendant_lamp"):
                continue
            size = room.size(kind)
            item = FurnishingItem(kind, middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([item]):
                lit_area = cell.area / len(_grid(cell, spacing))
                _add_light_source(room, item, "panel" if panels else "ceiling", 12.0 + 5.0 * lit_area, temperature)
    _light_standing_lamps(room)


def _grid(cell: Rect, spacing: float) -> list[tuple[float, float]]:
    """Returns evenly spaced points in a rectangle."""
    columns, rows = max(1, round(cell.width / spacing)), max(1, round(cell.depth / spacing))
    return [
        (round(cell.x0 + cell.width * (c + 0.5) / columns, 3), round(cell.y0 + cell.depth * (r + 0.5) / rows, 3))
        for c in range(columns)
        for r in range(rows)
    ]


def _above_tables(room: FurnishedRoom) -> None:
    """Hangs pendants above tables, where no headroom is needed."""
    for table in [p for p in room.items if p.kind in _TABLE_KINDS]:
        count = 2 if table.size[1] > 2.2 else 1
        for n in range(count):
            size = room.size("pendant_lamp", height=min(0.9, room.height - 1.6))
            middle = table.point_ahead(0.0, table.size[1] * ((n + 0.5) / count - 0.5))
            item = FurnishingItem("pendant_lamp", middle, 0.0, size, round(room.height - size[2], 4))
            if room.place([item]):
                _add_light_source(room, item, "pendant", 35.0, 2700.0)


def _light_standing_lamps(room: FurnishedRoom) -> None:
    """Adds the light sources of floor lamps and desk lamps."""
    for item in room.items:
        if item.kind == "floor_lamp":
            _add_light_source(room, item, "floor", 25.0, 2700.0)
        elif item.kind == "desk_lamp":
            _add_light_source(room, item, "desk", 8.0, 3000.0)


def _add_light_source(room: FurnishedRoom, item: FurnishingItem, kind: str, power: float, temperature: float) -> None:
    """Adds the light source of a lamp: below a hanging lamp, in the shade of a standing one."""
    hangs = kind in ("ceiling", "pendant", "panel")
    # Slightly below a hanging lamp, so that its body does not block the light.
    z = item.lift - 0.03 if hangs else item.lift + item.size[2] - (0.15 if kind == "floor" else 0.1)
    size = math.floor(min(item.size[0], item.size[1]) * 80.0) / 100.0
    position = (round(item.middle[0], 4), round(item.middle[1], 4), round(room.floor_z + z, 4))
    room.furnishings.lamps.append(Lamp(kind, position, round(power, 1), temperature, size))  # type: ignore[arg-type]


def scatter(room: FurnishedRoom) -> None:
    """Places loose objects on furniture with a usable top, and a few on the floor."""
    for item in list(room.items):
        if not item.movable and CATALOGUE[item.kind].top:
            _place_on_top(room, item)
    for model in _FLOOR_OBJECTS.get(room.kind, ()):
        if room.rng.random() < 0.75:
            put_on_floor(room, model)


def put_on_floor(room: FurnishedRoom, model: str) -> None:
    """Places a body against a wall, far from doors."""
    size = SIZES[model]

    def floor_score(face: WallFace, along: float) -> float:
        return room.distance_to_doors(face.point(along, 0.3)) - 1.5 * room.corner_gap(face, along, size[1])

    room.place_first(
        ([FurnishingItem(model, rounded(face.point(along, size[0] / 2 + 0.04)), face.yaw, size, movable=True)], [])
        for face, along in room.wall_positions(size[1] + 0.06, score=floor_score, step=0.2)
    )


def _place_on_top(room: FurnishedRoom, item: FurnishingItem) -> None:
    """Places objects on top of an item, without overlaps."""
    low, high = _COUNT_RANGES.get(item.kind, (0, 3))
    count = int(room.rng.integers(low, high + 1))
    models = _OBJECTS_ON.get(item.kind, ("vase", "book_stack"))
    top = item.lift + item.size[2]
    # Items on the top, or too low above it for objects below.
    occupied = [
        p.rect.grown(0.02)
        for p in room.items
        if p is not item and p.lift < top + 0.4 and p.lift + p.size[2] > top and p.rect.overlaps(item.rect)
    ]
    area = item.rect.grown(-0.03)
    pool = [models[int(n)] for n in room.rng.permutation(len(models))]
    for model in (pool * 2)[:count]:
        size = SIZES[model]
        for _ in range(12):
            yaw = round(item.yaw + float(room.rng.uniform(-0.5, 0.5)), 4)
            middle = (float(room.rng.uniform(area.x0, area.x1)), float(room.rng.uniform(area.y0, area.y1)))
            rect = rotated_bounds(middle, yaw, size[0], size[1])
            if rect.overlap_area(area) >= rect.area - 1e-9 and not any(rect.overlaps(t) for t in occupied):
                _add_object(room, model, middle, top, yaw, rect, occupied)
                break


def _add_object(
    room: FurnishedRoom, model: str, middle: tuple[float, float], top: float, yaw: float, rect: Rect, occupied: list[Rect]
) -> None:
    """Adds one loose object."""
    occupied.append(rect.grown(0.015))
    name = room.furnishings.name(f"{room.view.room.name}_{model}")
    x, y = rounded(middle)
    room.add_body(Body(name, model, (x, y, round(room.floor_z + top, 4)), yaw))
