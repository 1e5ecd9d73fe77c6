"""Generates layouts of offices and shops."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.planning.layout import BuildingLayout, Level, Space, SpaceLink, rect_space


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


def _sample(rng: np.random.Generator, low: float, high: float) -> float:
    """Samples a length between two limits, m, rounded to centimetres."""
    return round(float(rng.uniform(low, high)), 2)


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
