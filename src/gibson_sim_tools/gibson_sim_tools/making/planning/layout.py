"""Layout of a building: rooms, their rectangles and their connections, without walls. Generates layouts of flats, houses, offices and shops:
a few types of plan with random dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gibson_sim_tools.making.building import Point
from gibson_sim_tools.making.planning.rectangles import Rect, bounding_rect

OUTSIDE_THICKNESS = 0.3
"""Thickness of outside walls, m."""
_STAIR_WIDTH = 0.95
_STEPS = 16
_TREAD = 0.25
_RUN = (_STEPS - 1) * _TREAD
"""Horizontal length of a flight, m."""


@dataclass(frozen=True, slots=True)
class Space:
    """A room as a union of adjacent rectangles."""

    name: str
    kind: str
    rects: tuple[Rect, ...]


@dataclass(frozen=True, slots=True)
class SpaceLink:
    """A door or a passage between two spaces."""

    from_room: str
    """Name of a room; empty = outside."""
    to_room: str
    """Name of the room into which a door opens."""
    kind: Literal["door", "passage"] = "door"
    width: float = 0.9
    near: Point | None = None
    """Preferred position, m; None = anywhere."""
    sliding: bool = False


@dataclass(frozen=True, slots=True)
class Flight:
    """A straight flight of stairs to the storey above."""

    foot: Point
    """Centre of the first edge, m."""
    top: Point
    """Centre of the last edge, m."""
    width: float
    steps: int
    hole: Rect
    """Opening in the floor above."""
    lower_room: str
    upper_room: str


@dataclass(frozen=True, slots=True)
class Level:
    """The layout of a storey."""

    height: float
    spaces: tuple[Space, ...]
    links: tuple[SpaceLink, ...]
    windowless: tuple[str, ...] = ()
    """Names of rooms without windows."""


@dataclass(frozen=True, slots=True)
class BuildingLayout:
    """The layout of a building."""

    levels: tuple[Level, ...]
    partition: float
    """Thickness of inside walls, m."""
    flights: tuple[Flight, ...] = ()
    slab: float = 0.3
    """Thickness of the floor between two storeys, m."""

    def bounds(self) -> Rect:
        """Returns the bounding rectangle of all storeys."""
        return bounding_rect(
            p for level in self.levels for s in level.spaces for r in s.rects for p in ((r.x0, r.y0), (r.x1, r.y1))
        )


def rect_space(name: str, kind: str, x0: float, y0: float, x1: float, y1: float) -> Space:
    """Returns a space of one rectangle, rounded to centimetres."""
    return Space(name, kind, (Rect(round(x0, 2), round(y0, 2), round(x1, 2), round(y1, 2)),))


def random_orientation(layout: BuildingLayout, rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout, randomly mirrored and transposed, with its lower left corner at the origin."""
    mirror, swap = bool(rng.integers(2)), bool(rng.integers(2))
    bounds = layout.bounds()

    def point(p: Point) -> Point:
        x = bounds.x1 - p[0] if mirror else p[0] - bounds.x0
        y = p[1] - bounds.y0
        mapped = (y, x) if swap else (x, y)
        return (round(mapped[0], 3), round(mapped[1], 3))

    def rect(r: Rect) -> Rect:
        return bounding_rect((point((r.x0, r.y0)), point((r.x1, r.y1))))

    levels = tuple(
        replace(
            level,
            spaces=tuple(replace(s, rects=tuple(rect(r) for r in s.rects)) for s in level.spaces),
            links=tuple(replace(link, near=point(link.near) if link.near else None) for link in level.links),
        )
        for level in layout.levels
    )
    flights = tuple(replace(f, foot=point(f.foot), top=point(f.top), hole=rect(f.hole)) for f in layout.flights)
    return replace(layout, levels=levels, flights=flights)


def flat_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of a flat: one storey, five to seven rooms."""
    layouts = (_corridor_flat, _hall_flat, _open_flat, _ell_flat, _small_flat)
    spaces, links = layouts[int(rng.integers(len(layouts)))](rng)
    return BuildingLayout((Level(_sample(rng, 2.5, 2.75), spaces, links),), _sample(rng, 0.1, 0.14))


def house_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of a house of two storeys."""
    # Half the thickness must be a whole number of centimetres, so that stairs end at the face of a wall.
    partition = float(rng.choice((0.1, 0.12, 0.14)))
    return _side_hall_house(rng, partition) if rng.random() < 0.5 else _middle_hall_house(rng, partition)


def _sample(rng: np.random.Generator, low: float, high: float) -> float:
    """Samples a length between two limits, m, rounded to centimetres."""
    return round(float(rng.uniform(low, high)), 2)


def _connection(rng: np.random.Generator, from_room: str, to_room: str, *, near: tuple[float, float] | None = None) -> SpaceLink:
    """Returns a link that is randomly a passage or a door."""
    is_passage = rng.random() < 0.6
    return SpaceLink(from_room, to_room, "passage" if is_passage else "door", _sample(rng, 1.1, 1.5) if is_passage else 0.9, near)


def _corridor_flat(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns a flat with a corridor between the living room above and kitchen and bath below, and bedrooms at its end."""
    large = rng.random() < 0.4
    end = _sample(rng, 7.7, 8.1) if large else _sample(rng, 6.2, 7.0)
    width = end + (_sample(rng, 3.1, 3.4) if large else _sample(rng, 3.2, 3.9))
    lower, corridor, upper = _sample(rng, 3.1, 3.5), _sample(rng, 1.4, 1.55), _sample(rng, 3.9, 4.3)
    living_end = end - _sample(rng, 2.6, 2.8) if large else end
    y1, y2, depth = lower, lower + corridor, lower + corridor + upper
    bath_end = end - 1.5
    kitchen_end = min(_sample(rng, 2.6, 3.0), bath_end - 2.0)
    second_kind = "study" if rng.random() < 0.35 and not large else "bedroom"
    extra_rooms = (rect_space("study", "study", living_end, y2, end, depth),) if large else ()
    spaces = (
        rect_space("corridor", "corridor", 0, y1, end, y2),
        rect_space("living_room", "living", 0, y2, living_end, depth),
        rect_space("bedroom_1", "bedroom", end, y1, width, depth),
        rect_space("study" if second_kind == "study" else "bedroom_2", second_kind, bath_end, 0, width, y1),
        rect_space("bathroom", "bathroom", kitchen_end, 0, bath_end, y1),
        rect_space("kitchen", "kitchen", 0, 0, kitchen_end, y1),
        *extra_rooms,
    )
    links = (
        SpaceLink("", "corridor", near=(0, y1 + corridor / 2)),
        _connection(rng, "corridor", "living_room", near=(_sample(rng, 2.0, 4.5), y2)),
        SpaceLink("corridor", "bedroom_1", near=(end, y1 + corridor / 2)),
        SpaceLink("corridor", spaces[3].name, near=(end, y1)),
        SpaceLink("corridor", "bathroom", width=0.8),
        SpaceLink("corridor", "kitchen", sliding=bool(rng.random() < 0.25)),
        *(SpaceLink("corridor", space.name) for space in extra_rooms),
    )
    return spaces, links


def _hall_flat(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns a flat with a square hall below living room and bedroom, between kitchen and bath."""
    left = _sample(rng, 3.0, 3.5)
    right = left + _sample(rng, 2.9, 3.1)
    width = right + _sample(rng, 2.5, 3.0)
    middle = _sample(rng, 3.9, 4.3)
    depth = middle + _sample(rng, 3.9, 4.6)
    store = middle - _sample(rng, 2.1, 2.3)
    parting = round((left + right) / 2, 2)
    spaces = (
        rect_space("hall", "hall", left, 0, right, middle),
        rect_space("kitchen", "kitchen", 0, 0, left, middle),
        rect_space("living_room", "living", 0, middle, parting, depth),
        rect_space("bedroom", "bedroom", parting, middle, width, depth),
        rect_space("bathroom", "bathroom", right, store, width, middle),
        rect_space("storage", "storage", right, 0, width, store),
    )
    links = (
        SpaceLink("", "hall", near=((left + right) / 2, 0)),
        SpaceLink("hall", "living_room", near=(parting - 0.7, middle)),
        SpaceLink("hall", "bedroom", near=(parting + 0.7, middle)),
        SpaceLink("hall", "kitchen", near=(left, 1.0)),
        SpaceLink("hall", "bathroom", width=0.8, near=(right, middle - 0.7)),
        SpaceLink("hall", "storage", near=(right, 0.8), sliding=bool(rng.random() < 0.4)),
        SpaceLink("kitchen", "living_room", "passage", _sample(rng, 1.2, 1.7), near=(_sample(rng, 1.0, left - 0.6), middle)),
    )
    return spaces, links


def _small_flat(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns a flat with a short corridor between bedroom and bath, a living room, and a kitchen open to it."""
    left = _sample(rng, 4.5, 4.9)
    width = left + _sample(rng, 3.6, 3.9)
    lower, corridor = _sample(rng, 2.5, 2.8), _sample(rng, 1.4, 1.5)
    upper = lower + corridor
    depth = upper + _sample(rng, 3.4, 3.8)
    spaces = (
        rect_space("corridor", "corridor", left, lower, width, upper),
        rect_space("living_room", "living", 0, lower, left, depth),
        rect_space("kitchen", "kitchen", 0, 0, left, lower),
        rect_space("bathroom", "bathroom", left, 0, width, lower),
        rect_space("bedroom", "bedroom", left, upper, width, depth),
    )
    links = (
        SpaceLink("", "corridor", near=(width, lower + corridor / 2)),
        SpaceLink("corridor", "living_room", near=(left, lower + corridor / 2)),
        SpaceLink("corridor", "bathroom", width=0.8),
        SpaceLink("corridor", "bedroom"),
        SpaceLink("kitchen", "living_room", "passage", _sample(rng, 1.4, 2.4), near=(_sample(rng, 1.5, left - 1.2), lower)),
    )
    return spaces, links


def _open_flat(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns a flat with an open kitchen beside the living room, and a hall between these and bedrooms and bath."""
    left = _sample(rng, 4.4, 5.2)
    hall = left + _sample(rng, 1.45, 1.6)
    width = hall + _sample(rng, 3.2, 3.8)
    depth = _sample(rng, 8.5, 9.2)
    kitchen = _sample(rng, 2.9, 3.3)
    top = depth - _sample(rng, 3.0, 3.5)
    bath = top - _sample(rng, 2.1, 2.4)
    spaces = (
        rect_space("hall", "hall", left, 0, hall, top),
        rect_space("kitchen", "kitchen", 0, 0, left, kitchen),
        rect_space("living_room", "living", 0, kitchen, left, depth),
        rect_space("bedroom_1", "bedroom", left, top, width, depth),
        rect_space("bathroom", "bathroom", hall, bath, width, top),
        rect_space("bedroom_2", "bedroom", hall, 0, width, bath),
    )
    links = (
        SpaceLink("", "hall", near=((left + hall) / 2, 0)),
        _connection(rng, "hall", "living_room", near=(left, top - 1.0)),
        SpaceLink("hall", "bedroom_1", near=((left + hall) / 2, top)),
        SpaceLink("hall", "bathroom", width=0.8),
        SpaceLink("hall", "bedroom_2", near=(hall, bath)),
        SpaceLink("kitchen", "living_room", "passage", _sample(rng, 1.9, 2.6), near=(_sample(rng, 1.5, left - 1.2), kitchen)),
    )
    return spaces, links


def _ell_flat(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns a flat in two wings: living room and kitchen in one, bath and bedrooms along a corridor with windows in the other."""
    wing = _sample(rng, 4.3, 5.0)
    lower, corridor = _sample(rng, 3.2, 3.6), _sample(rng, 1.55, 1.7)
    bath = wing + _sample(rng, 2.1, 2.5)
    end = bath + _sample(rng, 3.0, 3.4)
    width = end + _sample(rng, 3.1, 3.6)
    y2, depth = lower + corridor, lower + _sample(rng, 4.8, 5.6)
    last = "study" if rng.random() < 0.4 else "bedroom"
    spaces = (
        rect_space("corridor", "corridor", wing, lower, end, y2),
        rect_space("living_room", "living", 0, lower, wing, depth),
        rect_space("kitchen", "kitchen", 0, 0, wing, lower),
        rect_space("bathroom", "bathroom", wing, 0, bath, lower),
        rect_space("study" if last == "study" else "bedroom_2", last, bath, 0, end, lower),
        rect_space("bedroom_1", "bedroom", end, 0, width, y2),
    )
    links = (
        SpaceLink("", "corridor", near=(wing + 1.6, y2)),
        SpaceLink("corridor", "living_room", near=(wing, lower + corridor / 2)),
        SpaceLink("corridor", "bathroom", width=0.8),
        SpaceLink("corridor", spaces[4].name),
        SpaceLink("corridor", "bedroom_1", near=(end, lower + corridor / 2)),
        SpaceLink("kitchen", "living_room", "passage", _sample(rng, 1.2, 2.2), near=(_sample(rng, 1.2, wing - 1.0), lower)),
    )
    return spaces, links


def _flight(hall_start: float, partition: float, outer: bool, foot: float, front: float) -> Flight:
    """Returns the stair along the left wall of a hall, ascending along y. ``front``: centre line of the wall in front of the opening above."""
    x0 = round(hall_start + (OUTSIDE_THICKNESS if outer else partition) / 2, 3)
    middle = round(x0 + _STAIR_WIDTH / 2, 3)
    hole = Rect(x0, round(front + partition / 2, 3), round(x0 + _STAIR_WIDTH, 3), round(foot + _RUN, 3))
    return Flight((middle, foot), (middle, round(foot + _RUN, 3)), _STAIR_WIDTH, _STEPS, hole, "hall", "upper_hall")


def _side_hall_house(rng: np.random.Generator, partition: float) -> BuildingLayout:
    """Returns a narrow house: hall and stair along one outer wall, all rooms on the other side."""
    hall = _sample(rng, 2.4, 2.55)
    width = hall + _sample(rng, 4.5, 5.4)
    depth = _sample(rng, 7.7, 8.4)
    foot = _sample(rng, 1.75, 1.9)
    front, back = round(foot + 0.35, 2), round(foot + _RUN + partition / 2, 2)
    kitchen, parting = _sample(rng, 3.0, 3.4), _sample(rng, 3.7, depth - 3.9)
    ground = (
        rect_space("hall", "hall", 0, 0, hall, back),
        rect_space("toilet", "toilet", 0, back, hall, depth),
        rect_space("kitchen", "kitchen", hall, 0, width, kitchen),
        rect_space("living_room", "living", hall, kitchen, width, depth),
    )
    ground_links = (
        SpaceLink("", "hall", near=(hall - 0.7, 0)),
        SpaceLink("hall", "toilet", width=0.8, near=(hall - 0.6, back)),
        SpaceLink("hall", "kitchen", near=(hall, 2.0), sliding=bool(rng.random() < 0.4)),
        SpaceLink("hall", "living_room", near=(hall, kitchen + 1.2)),
        SpaceLink("kitchen", "living_room", "passage", _sample(rng, 1.2, 2.0), near=(width - 1.6, kitchen)),
    )
    upper = (
        rect_space("upper_hall", "hall", 0, front, hall, depth),
        rect_space("bathroom", "bathroom", 0, 0, hall, front),
        rect_space("bedroom_1", "bedroom", hall, parting, width, depth),
        rect_space("bedroom_2", "bedroom", hall, 0, width, parting),
    )
    upper_links = (
        SpaceLink("upper_hall", "bathroom", width=0.8, near=(hall - 0.6, front)),
        SpaceLink("upper_hall", "bedroom_1", near=(hall, parting + 0.8)),
        SpaceLink("upper_hall", "bedroom_2", near=(hall, parting - 0.8)),
    )
    height = _sample(rng, 2.5, 2.6)
    levels = (Level(height, ground, ground_links, ("hall",)), Level(height, upper, upper_links))
    return BuildingLayout(levels, partition, (_flight(0.0, partition, True, foot, front),))


def _middle_hall_house(rng: np.random.Generator, partition: float) -> BuildingLayout:
    """Returns a wide house: hall and stair in the middle, rooms on both sides."""
    left = _sample(rng, 3.9, 4.3)
    hall = left + _sample(rng, 2.4, 2.55)
    width = hall + _sample(rng, 3.2, 3.7)
    depth = _sample(rng, 7.7, 8.2)
    foot = _sample(rng, 1.75, 1.9)
    front, back = round(foot + 0.35, 2), round(foot + _RUN + partition / 2, 2)
    kitchen, parting, suite = _sample(rng, 3.9, 4.3), _sample(rng, 3.7, depth - 3.8), _sample(rng, 2.3, 2.6)
    room = "study" if rng.random() < 0.6 else "bedroom"
    ground = (
        rect_space("hall", "hall", left, 0, hall, back),
        rect_space("toilet", "toilet", left, back, hall, depth),
        rect_space("living_room", "living", 0, 0, left, depth),
        rect_space("study" if room == "study" else "guest_room", room, hall, 0, width, depth - kitchen),
        rect_space("kitchen", "kitchen", hall, depth - kitchen, width, depth),
    )
    ground_links = (
        SpaceLink("", "hall", near=(hall - 0.7, 0)),
        SpaceLink("hall", "toilet", width=0.8, near=(hall - 0.6, back)),
        SpaceLink("hall", "living_room", near=(left, 0.9)),
        SpaceLink("hall", "kitchen", near=(hall, depth - kitchen + 0.7)),
        SpaceLink("hall", ground[3].name, near=(hall, depth - kitchen - 0.8)),
    )
    upper = (
        rect_space("upper_hall", "hall", left, front, hall, depth),
        rect_space("bathroom", "bathroom", left, 0, hall, front),
        rect_space("bedroom_1", "bedroom", 0, suite, left, depth),
        rect_space("ensuite", "bathroom", 0, 0, left, suite),
        rect_space("bedroom_2", "bedroom", hall, parting, width, depth),
        rect_space("bedroom_3", "bedroom", hall, 0, width, parting),
    )
    upper_links = (
        SpaceLink("upper_hall", "bathroom", width=0.8, near=(hall - 0.6, front)),
        SpaceLink("upper_hall", "bedroom_1", near=(left, depth - 1.0)),
        SpaceLink("bedroom_1", "ensuite", width=0.8),
        SpaceLink("upper_hall", "bedroom_2", near=(hall, parting + 0.8)),
        SpaceLink("upper_hall", "bedroom_3", near=(hall, parting - 0.8)),
    )
    height = _sample(rng, 2.5, 2.6)
    levels = (Level(height, ground, ground_links, ("hall",)), Level(height, upper, upper_links))
    return BuildingLayout(levels, partition, (_flight(left, partition, False, foot, front),))


def office_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of an office: single offices along a corridor, or an open plan office."""
    office_type = _open_plan_office if rng.random() < 0.45 else _cell_office
    spaces, links = office_type(rng)
    return BuildingLayout((Level(_sample(rng, 2.8, 3.1), spaces, links),), _sample(rng, 0.1, 0.14))


def shop_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of a shop: sales room in front, storage and toilet behind."""
    width, depth = _sample(rng, 8.6, 11.5), _sample(rng, 7.2, 8.8)
    back_wall = depth + _sample(rng, 2.9, 3.4)
    toilet = _sample(rng, 1.9, 2.2)
    if rng.random() < 0.5:
        store = width - toilet
        sales = rect_space("sales_room", "shop", 0, 0, width, depth)
        spaces = (
            sales,
            rect_space("storage", "storage", 0, depth, store, back_wall),
            rect_space("toilet", "toilet", store, depth, width, back_wall),
        )
    else:
        store = toilet + _sample(rng, 3.2, 3.8)
        wings = rect_space("", "", 0, 0, width, depth).rects + rect_space("", "", store, depth, width, back_wall).rects
        spaces = (
            Space("sales_room", "shop", wings),
            rect_space("storage", "storage", toilet, depth, store, back_wall),
            rect_space("toilet", "toilet", 0, depth, toilet, back_wall),
        )
    links = (
        SpaceLink("", "sales_room", near=(width * _sample(rng, 0.3, 0.7), 0)),
        SpaceLink("sales_room", "storage"),
        SpaceLink("storage", "toilet", width=0.8),
    )
    return BuildingLayout((Level(_sample(rng, 2.9, 3.2), spaces, links),), _sample(rng, 0.1, 0.14))


def _cell_office(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns offices above a corridor; meeting room, kitchenette, toilet and another office below."""
    width = _sample(rng, 13.5, 16.5)
    lower = _sample(rng, 3.9, 4.5)
    upper = lower + _sample(rng, 1.7, 2.0)
    depth = upper + _sample(rng, 4.2, 4.9)
    count = 4 if width > 14.8 else 3
    edges = [round(width * n / count, 2) for n in range(count + 1)]
    meeting = _sample(rng, 4.9, 5.6)
    kitchen = meeting + _sample(rng, 2.7, 3.1)
    toilet = kitchen + _sample(rng, 1.9, 2.2)
    offices = tuple(rect_space(f"office_{n + 1}", "office", edges[n], upper, edges[n + 1], depth) for n in range(count))
    spaces = (
        rect_space("corridor", "corridor", 0, lower, width, upper),
        *offices,
        rect_space("meeting_room", "meeting", 0, 0, meeting, lower),
        rect_space("kitchenette", "kitchenette", meeting, 0, kitchen, lower),
        rect_space("toilet", "toilet", kitchen, lower - 2.1, toilet, lower),
        rect_space("storage", "storage", kitchen, 0, toilet, lower - 2.1),
        rect_space(f"office_{count + 1}", "office", toilet, 0, width, lower),
    )
    links = (
        SpaceLink("", "corridor", near=(0, (lower + upper) / 2)),
        *(SpaceLink("corridor", s.name) for s in (*offices, spaces[count + 1])),
        SpaceLink("corridor", "kitchenette", "passage", _sample(rng, 0.9, 1.4)),
        SpaceLink("corridor", "toilet", width=0.8),
        SpaceLink("kitchenette", "storage", near=(kitchen, 0.8)),
        SpaceLink("corridor", spaces[-1].name),
    )
    return spaces, links


def _open_plan_office(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Returns an open plan office above a corridor; meeting room, kitchenette and toilet below; an office at the end."""
    lower = _sample(rng, 3.9, 4.4)
    upper = lower + _sample(rng, 1.7, 2.0)
    depth = upper + _sample(rng, 5.6, 6.6)
    meeting = _sample(rng, 4.6, 5.4)
    kitchen = meeting + _sample(rng, 2.7, 3.1)
    toilet = kitchen + _sample(rng, 1.9, 2.2)
    width = toilet + _sample(rng, 3.3, 3.9)
    spaces = (
        rect_space("corridor", "corridor", 0, lower, toilet, upper),
        rect_space("open_plan_office", "open_office", 0, upper, width, depth),
        rect_space("meeting_room", "meeting", 0, 0, meeting, lower),
        rect_space("kitchenette", "kitchenette", meeting, 0, kitchen, lower),
        rect_space("toilet", "toilet", kitchen, lower - 2.1, toilet, lower),
        rect_space("storage", "storage", kitchen, 0, toilet, lower - 2.1),
        rect_space("office", "office", toilet, 0, width, upper),
    )
    links = (
        SpaceLink("", "corridor", near=(0, (lower + upper) / 2)),
        SpaceLink("corridor", "open_plan_office", "passage", _sample(rng, 1.4, 2.0), near=(2.0, upper)),
        SpaceLink("corridor", "open_plan_office", "passage", _sample(rng, 1.2, 1.6), near=(toilet - 1.5, upper)),
        SpaceLink("corridor", "meeting_room"),
        SpaceLink("corridor", "kitchenette", "passage", _sample(rng, 0.9, 1.4)),
        SpaceLink("corridor", "toilet", width=0.8),
        SpaceLink("kitchenette", "storage", near=(kitchen, 0.8)),
        SpaceLink("corridor", "office", near=(toilet, (lower + upper) / 2)),
    )
    return spaces, links
