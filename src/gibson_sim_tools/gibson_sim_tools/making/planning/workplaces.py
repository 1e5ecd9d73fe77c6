"""Layouts of offices and shops."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.planning.layout import BuildingLayout, Level, Space, SpaceLink, one


def office_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of an office: single offices along a corridor, or one open plan office."""
    maker = _open_plan_office if rng.random() < 0.45 else _cell_office
    spaces, links = maker(rng)
    return BuildingLayout((Level(_draw(rng, 2.8, 3.1), spaces, links),), _draw(rng, 0.1, 0.14))


def shop_layout(rng: np.random.Generator) -> BuildingLayout:
    """Returns the layout of a shop: sales room in front, storage and toilet behind."""
    width, depth = _draw(rng, 8.6, 11.5), _draw(rng, 7.2, 8.8)
    back = depth + _draw(rng, 2.9, 3.4)
    toilet = _draw(rng, 1.9, 2.2)
    if rng.random() < 0.5:
        store = width - toilet
        sales = one("sales_room", "shop", 0, 0, width, depth)
        spaces = (sales, one("storage", "storage", 0, depth, store, back), one("toilet", "toilet", store, depth, width, back))
    else:
        store = toilet + _draw(rng, 3.2, 3.8)
        wings = one("", "", 0, 0, width, depth).rects + one("", "", store, depth, width, back).rects
        spaces = (
            Space("sales_room", "shop", wings),
            one("storage", "storage", toilet, depth, store, back),
            one("toilet", "toilet", 0, depth, toilet, back),
        )
    links = (
        SpaceLink("", "sales_room", near=(width * _draw(rng, 0.3, 0.7), 0)),
        SpaceLink("sales_room", "storage"),
        SpaceLink("storage", "toilet", width=0.8),
    )
    return BuildingLayout((Level(_draw(rng, 2.9, 3.2), spaces, links),), _draw(rng, 0.1, 0.14))


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    """Returns a random length between two, in whole centimetres."""
    return round(float(rng.uniform(low, high)), 2)


def _cell_office(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """Offices above a corridor; meeting room, kitchenette, toilet and one more office below."""
    width = _draw(rng, 13.5, 16.5)
    lower = _draw(rng, 3.9, 4.5)
    upper = lower + _draw(rng, 1.7, 2.0)
    depth = upper + _draw(rng, 4.2, 4.9)
    count = 4 if width > 14.8 else 3
    edges = [round(width * n / count, 2) for n in range(count + 1)]
    meeting = _draw(rng, 4.9, 5.6)
    kitchen = meeting + _draw(rng, 2.7, 3.1)
    toilet = kitchen + _draw(rng, 1.9, 2.2)
    offices = tuple(one(f"office_{n + 1}", "office", edges[n], upper, edges[n + 1], depth) for n in range(count))
    spaces = (
        one("corridor", "corridor", 0, lower, width, upper),
        *offices,
        one("meeting_room", "meeting", 0, 0, meeting, lower),
        one("kitchenette", "kitchenette", meeting, 0, kitchen, lower),
        one("toilet", "toilet", kitchen, lower - 2.1, toilet, lower),
        one("storage", "storage", kitchen, 0, toilet, lower - 2.1),
        one(f"office_{count + 1}", "office", toilet, 0, width, lower),
    )
    links = (
        SpaceLink("", "corridor", near=(0, (lower + upper) / 2)),
        *(SpaceLink("corridor", s.name) for s in (*offices, spaces[count + 1])),
        SpaceLink("corridor", "kitchenette", "passage", _draw(rng, 0.9, 1.4)),
        SpaceLink("corridor", "toilet", width=0.8),
        SpaceLink("kitchenette", "storage", near=(kitchen, 0.8)),
        SpaceLink("corridor", spaces[-1].name),
    )
    return spaces, links


def _open_plan_office(rng: np.random.Generator) -> tuple[tuple[Space, ...], tuple[SpaceLink, ...]]:
    """An open plan office above a corridor; meeting room, kitchenette and toilet below; an office at the end."""
    lower = _draw(rng, 3.9, 4.4)
    upper = lower + _draw(rng, 1.7, 2.0)
    depth = upper + _draw(rng, 5.6, 6.6)
    meeting = _draw(rng, 4.6, 5.4)
    kitchen = meeting + _draw(rng, 2.7, 3.1)
    toilet = kitchen + _draw(rng, 1.9, 2.2)
    width = toilet + _draw(rng, 3.3, 3.9)
    spaces = (
        one("corridor", "corridor", 0, lower, toilet, upper),
        one("open_plan_office", "open_office", 0, upper, width, depth),
        one("meeting_room", "meeting", 0, 0, meeting, lower),
        one("kitchenette", "kitchenette", meeting, 0, kitchen, lower),
        one("toilet", "toilet", kitchen, lower - 2.1, toilet, lower),
        one("storage", "storage", kitchen, 0, toilet, lower - 2.1),
        one("office", "office", toilet, 0, width, upper),
    )
    links = (
        SpaceLink("", "corridor", near=(0, (lower + upper) / 2)),
        SpaceLink("corridor", "open_plan_office", "passage", _draw(rng, 1.4, 2.0), near=(2.0, upper)),
        SpaceLink("corridor", "open_plan_office", "passage", _draw(rng, 1.2, 1.6), near=(toilet - 1.5, upper)),
        SpaceLink("corridor", "meeting_room"),
        SpaceLink("corridor", "kitchenette", "passage", _draw(rng, 0.9, 1.4)),
        SpaceLink("corridor", "toilet", width=0.8),
        SpaceLink("kitchenette", "storage", near=(kitchen, 0.8)),
        SpaceLink("corridor", "office", near=(toilet, (lower + upper) / 2)),
    )
    return spaces, links
