"""Layouts of homes and workplaces, and their palettes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gibson_sim_tools.making.building import MATERIALS, BuildingKind
from gibson_sim_tools.making.planning.layout import (
    BuildingLayout,
    Flight,
    Level,
    SpaceLink,
    flat_layout,
    house_layout,
    office_layout,
    random_orientation,
    rect_space,
    shop_layout,
)
from gibson_sim_tools.making.planning.planner import palette, surfaces
from gibson_sim_tools.making.planning.rectangles import Rect

MAKERS = (flat_layout, house_layout, office_layout, shop_layout)
SEEDS = range(12)


def _layouts(maker: Callable[[np.random.Generator], BuildingLayout]) -> list[BuildingLayout]:
    return [maker(np.random.default_rng(seed)) for seed in SEEDS]


@pytest.mark.parametrize("maker", MAKERS)
def test_rooms_do_not_overlap_and_have_names_of_their_own(maker: Callable[[np.random.Generator], BuildingLayout]) -> None:
    for layout in _layouts(maker):
        for level in layout.levels:
            rects = [(s.name, r) for s in level.spaces for r in s.rects]
            assert len({s.name for s in level.spaces}) == len(level.spaces)
            assert all(r.width > 0.8 and r.depth > 0.8 for _, r in rects)
            assert not any(a.overlap_area(b) > 1e-6 for k, (_, a) in enumerate(rects) for _, b in rects[k + 1 :])


@pytest.mark.parametrize("maker", MAKERS)
def test_links_join_all_rooms_of_a_storey_and_one_leads_outside(maker: Callable[[np.random.Generator], BuildingLayout]) -> None:
    for layout in _layouts(maker):
        for number, level in enumerate(layout.levels):
            names = {s.name for s in level.spaces}
            assert {n for link in level.links for n in (link.from_room, link.to_room)} - {""} == names
            assert sum(not link.from_room for link in level.links) == (1 if number == 0 else 0)
            reached = {next(iter(names))}
            for _ in names:
                reached |= {
                    n for li in level.links if {li.from_room, li.to_room} & reached for n in (li.from_room, li.to_room) if n
                }
            assert reached == names


def test_a_house_has_a_flight_that_ends_at_the_edge_of_its_hole() -> None:
    for layout in _layouts(house_layout):
        (flight,) = layout.flights
        # 16 rises, 15 treads of 25 cm.
        assert flight.top[1] - flight.foot[1] == pytest.approx(3.75)
        assert flight.hole.y1 == pytest.approx(flight.top[1]) and flight.hole.width == pytest.approx(0.95)
        assert (flight.lower_room, flight.upper_room) == ("hall", "upper_hall")


def test_a_space_is_rounded_to_centimetres_and_a_layout_has_bounds() -> None:
    layout = BuildingLayout(
        (Level(2.5, (rect_space("a", "living", 0, 0, 2.004, 3.006), rect_space("b", "hall", -1, 0, 0, 1)), ()),), 0.1
    )
    assert layout.levels[0].spaces[0].rects == (Rect(0, 0, 2.0, 3.01),)
    assert layout.bounds() == Rect(-1, 0, 2.0, 3.01)


class _Choices:
    """Random numbers that are given."""

    def __init__(self, *values: int) -> None:
        self._values = list(values)

    def integers(self, _: int) -> int:
        return self._values.pop(0)


@pytest.mark.parametrize(
    ("mirror", "swap", "rect", "near", "foot"),
    [
        (0, 0, (0.0, 0.0, 4.0, 2.0), (1.0, 0.5), (3.0, 1.0)),
        (1, 0, (0.0, 0.0, 4.0, 2.0), (3.0, 0.5), (1.0, 1.0)),
        (0, 1, (0.0, 0.0, 2.0, 4.0), (0.5, 1.0), (1.0, 3.0)),
        (1, 1, (0.0, 0.0, 2.0, 4.0), (0.5, 3.0), (1.0, 1.0)),
    ],
)
def test_a_layout_is_mirrored_and_transposed_with_all_that_is_in_it(
    mirror: int, swap: int, rect: tuple[float, ...], near: tuple[float, float], foot: tuple[float, float]
) -> None:
    """A room of 4 x 2 m whose lower left corner is at (1, 5)."""
    level = Level(2.5, (rect_space("a", "hall", 1, 5, 5, 7),), (SpaceLink("", "a", near=(2.0, 5.5)),))
    flight = Flight((4.0, 6.0), (4.0, 6.5), 0.9, 3, Rect(3.5, 6.0, 4.5, 6.5), "a", "b")
    out = random_orientation(BuildingLayout((level,), 0.1, (flight,)), _Choices(mirror, swap))  # type: ignore[arg-type]
    assert out.levels[0].spaces[0].rects[0] == rect
    assert out.levels[0].links[0].near == near
    assert out.flights[0].foot == foot and out.flights[0].hole.area == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["flat", "house", "office", "shop"])
def test_palettes_name_known_materials(kind: BuildingKind) -> None:
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        colours = palette(kind, rng)
        for room in ("bathroom", "kitchen", "storage", "hall", "bedroom", "living", "shop", "meeting"):
            assert set(surfaces(colours, room, rng)) <= set(MATERIALS)


def test_wet_rooms_have_wet_floors_and_soft_rooms_no_brick() -> None:
    rng = np.random.default_rng(0)
    colours = palette("flat", rng)
    assert surfaces(colours, "toilet", rng) == (colours.wet_floor, colours.wet_walls)
    assert surfaces(colours, "storage", rng) == (colours.store_floor, "plaster_white")
    assert surfaces(colours, "corridor", rng) == (colours.floor, colours.walls)
    assert all(not surfaces(colours, "bedroom", rng)[1].startswith("brick") for _ in range(20))
