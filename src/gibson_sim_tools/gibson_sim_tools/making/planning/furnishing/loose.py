"""Adds loose objects to tables, counters and the floor."""

from __future__ import annotations

from gibson_sim_tools.making.building import Body
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.planning.rectangles import Rect, rotated_bounds
from gibson_sim_tools.making.planning.rooms import WallFace
from gibson_sim_tools.making.planning.space import FurnishedRoom, FurnishingItem

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
        ([FurnishingItem(model, _rounded(face.point(along, size[0] / 2 + 0.04)), face.yaw, size, movable=True)], [])
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
    x, y = _rounded(middle)
    room.add_body(Body(name, model, (x, y, round(room.floor_z + top, 4)), yaw))


def _rounded(point: tuple[float, float]) -> tuple[float, float]:
    """Returns a point rounded to 0.1 mm."""
    return (round(point[0], 4), round(point[1], 4))
