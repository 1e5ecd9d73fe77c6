"""Plans of buildings: requirements of architecture, furniture and robots."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim_tools.making.building import Building, BuildingKind, Piece
from gibson_sim_tools.making.planning import check_building, draw_plan, plan_building
from gibson_sim_tools.making.planning.rooms import cells_of
from gibson_sim_tools.making.planning.shipped import SHIPPED

KINDS: tuple[BuildingKind, ...] = ("flat", "house", "office", "shop")


@cache
def planned(kind: BuildingKind, seed: int = 1) -> Building:
    return plan_building(kind, seed)


def area(building: Building, storey: int) -> float:
    return sum(c.area for room in building.storeys[storey].rooms for c in cells_of(room.corners))


def piece_of(building: Building, kind: str) -> Piece:
    return next(p for p in building.pieces if p.kind == kind)


def moved(building: Building, piece: Piece, position: tuple[float, float, float]) -> Building:
    others = tuple(p for p in building.pieces if p is not piece)
    return replace(building, pieces=(*others, replace(piece, position=position)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_plan_has_no_faults(kind: BuildingKind) -> None:
    assert check_building(planned(kind)) == []


@pytest.mark.parametrize("kind", ["house", "shop"])
def test_the_same_seed_gives_the_same_plan(kind: BuildingKind) -> None:
    assert plan_building(kind, 1) == planned(kind)


def test_another_seed_gives_another_plan() -> None:
    assert planned("flat", 6).storeys != planned("flat").storeys


@pytest.mark.parametrize("seed", [1, 6])
def test_a_flat_has_one_storey_of_60_to_110_square_metres(seed: int) -> None:
    flat = planned("flat", seed)
    assert len(flat.storeys) == 1
    assert 60.0 <= area(flat, 0) <= 110.0
    assert 4 <= len(flat.storeys[0].rooms) <= 7


def test_a_house_has_two_storeys_and_a_stair_that_ends_on_the_upper_floor() -> None:
    house = planned("house")
    assert len(house.storeys) == 2
    assert 100.0 <= area(house, 0) + area(house, 1) <= 180.0
    (stair,) = house.stairs
    rise = (house.storeys[1].floor_z - house.storeys[0].floor_z) / stair.steps
    assert 0.15 <= rise <= 0.2
    length = (stair.steps - 1) * stair.tread
    top = (stair.foot[0] + math.cos(stair.yaw) * length, stair.foot[1] + math.sin(stair.yaw) * length)
    xs, ys = zip(*stair.hole, strict=True)
    assert any(abs(a - b) < 1e-3 for a, b in ((top[0], min(xs)), (top[0], max(xs)), (top[1], min(ys)), (top[1], max(ys))))


@pytest.mark.parametrize("kind", ["flat", "house"])
def test_a_home_has_the_usual_furniture(kind: BuildingKind) -> None:
    home = planned(kind)
    assert {"sofa", "television", "dining_table", "kitchen_sink", "extractor_hood", "wardrobe", "toilet", "basin"} <= {
        p.kind for p in home.pieces
    }
    models = {b.model for b in home.bodies}
    assert "fridge_body" in models
    assert models & {"cabinet_drawers", "cabinet_doors"}


def test_an_office_and_a_shop_have_the_usual_equipment() -> None:
    assert {"desk", "office_chair", "monitor", "meeting_table", "panel_lamp"} <= {p.kind for p in planned("office").pieces}
    assert {"gondola", "wall_shelf", "till", "display_fridge"} <= {p.kind for p in planned("shop").pieces}


def test_the_front_door_is_closed_and_most_others_are_open() -> None:
    doors = [b for b in planned("house").bodies if b.model.startswith("door_")]
    closed = [b.name for b in doors if b.joints["hinge"] == 0.0]
    assert "front_door" in closed
    assert all(name == "front_door" or name.endswith("_closed") for name in closed)
    assert len(doors) > 2 * len(closed)


def test_a_piece_in_the_place_of_another_is_found() -> None:
    flat = planned("flat")
    assert any(
        "overlap" in line for line in check_building(moved(flat, piece_of(flat, "wardrobe"), piece_of(flat, "sofa").position))
    )


def test_a_piece_in_the_air_is_found() -> None:
    flat = planned("flat")
    table = piece_of(flat, "coffee_table")
    found = check_building(moved(flat, table, (table.position[0], table.position[1], 0.3)))
    assert any("above the floor" in line for line in found)
    assert any("floats" in line for line in found)


def test_a_piece_before_a_door_is_found() -> None:
    flat = planned("flat")
    hinge = next(b for b in flat.bodies if b.name == "front_door").position
    assert any("blocks the" in line for line in check_building(moved(flat, piece_of(flat, "shoe_cabinet"), hinge)))


def test_a_piece_before_a_window_is_found() -> None:
    flat = planned("flat")
    radiator = piece_of(flat, "radiator")
    wardrobe = piece_of(flat, "wardrobe")
    assert any(
        "blocks a window" in line
        for line in check_building(moved(flat, wardrobe, (radiator.position[0], radiator.position[1], 0.0)))
    )


def test_a_piece_outside_its_room_is_found() -> None:
    flat = planned("flat")
    assert any("extends beyond" in line for line in check_building(moved(flat, piece_of(flat, "sofa"), (-3.0, 0.0, 0.0))))


def test_a_gap_in_the_shell_is_found() -> None:
    flat = planned("flat")
    storey = flat.storeys[0]
    gap = replace(flat, storeys=(replace(storey, walls=storey.walls[1:]),))
    assert any("nothing joins" in line or "of walls for" in line for line in check_building(gap))


def test_a_room_behind_a_closed_door_is_found() -> None:
    office = planned("office")
    bodies = tuple(replace(b, joints={"hinge": 0.0}) if b.model.startswith("door_") else b for b in office.bodies)
    assert any("cannot be reached by a robot" in line for line in check_building(replace(office, bodies=bodies)))


def test_a_lamp_without_light_is_found() -> None:
    flat = planned("flat")
    assert any("has no light source" in line for line in check_building(replace(flat, lamps=flat.lamps[1:])))


def test_a_plan_can_be_drawn() -> None:
    picture = draw_plan(planned("house"), 1)
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3
    assert picture.std() > 20.0


def test_an_unknown_kind_and_a_negative_seed_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"castle.*known: flat"):
        plan_building("castle", 1)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="seed -1"):
        plan_building("flat", -1)


def test_ten_designs_are_shipped() -> None:
    kinds = [design.kind for design in SHIPPED]
    assert {kind: kinds.count(kind) for kind in KINDS} == {"flat": 4, "house": 3, "office": 2, "shop": 1}
    assert len({design.name for design in SHIPPED}) == 10
