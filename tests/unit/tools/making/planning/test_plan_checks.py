"""Every fault of a plan is named: in a room of 5 x 4 m with a door to the outside, a lamp and a start."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gibson_sim_tools.making.building import Body, Building, Lamp, Opening, Piece, Room, Start, Storey, Wall
from gibson_sim_tools.making.planning.checks import check_building, piece_box
from gibson_sim_tools.making.planning.drawing import draw_plan

CORNERS = ((-0.15, -0.15), (5.15, -0.15), (5.15, 4.15), (-0.15, 4.15))
DOOR = Opening("door", 0.85, 0.9, 0.0, 2.0, swing=1)
WINDOW = Opening("window", 2.65, 1.2, 0.9, 1.2)
LAMP = Piece("lamp", "ceiling_lamp", 0, "room", (2.5, 2.0, 2.4), 0.0, (0.4, 0.4, 0.1))
SOFA = Piece("sofa", "sofa", 0, "room", (0.45, 2.5, 0.0), 0.0, (0.9, 2.0, 0.8))
TABLE = Piece("table", "coffee_table", 0, "room", (3.0, 2.5, 0.0), 0.0, (0.6, 1.0, 0.4))


def building(*pieces: Piece, openings: dict[int, tuple[Opening, ...]] | None = None, bodies: tuple[Body, ...] = ()) -> Building:
    at = {0: (DOOR,), 2: (WINDOW,)} | (openings or {})
    walls = tuple(Wall(CORNERS[k], CORNERS[(k + 1) % 4], 0.3, 2.5, "room", "", at.get(k, ())) for k in range(4))
    storeys = (Storey(0.0, 2.5, (Room("room", "living", CORNERS),), walls),)
    lamps = (Lamp("ceiling", (2.5, 2.0, 2.4), 20.0),)
    return Building("b", "flat", 0, storeys, (LAMP, *pieces), bodies, lamps, (Start("room", (2.5, 1.5, 0.0), 0.0),))


def moved(piece: Piece, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Piece:
    return replace(piece, position=(x, y, z), yaw=yaw)


def test_the_room_by_itself_is_fine() -> None:
    assert check_building(building(SOFA, TABLE)) == []


@pytest.mark.parametrize(
    ("plan", "fault"),
    [
        (building(SOFA, replace(TABLE, name="sofa")), "piece name 'sofa' is used twice"),
        (building(TABLE, bodies=(Body("b", "mug", (3.0, 2.5, 0.4)), Body("b", "cup", (3.0, 2.8, 0.4)))), "body name 'b' is used twice"),
        (building(moved(SOFA, 0.45, 3.5)), "sofa extends beyond room"),
        (building(moved(SOFA, 0.45, 2.5, 0.2)), "sofa is 0.200 m above the floor"),
        (building(TABLE, moved(replace(TABLE, name="other"), 3.3, 2.5)), "table and other overlap"),
        (building(moved(TABLE, 0.9, 0.6)), "table blocks the door from room to outside"),
        (building(replace(moved(TABLE, 2.5, 3.6), size=(0.6, 0.6, 1.4))), "table blocks a window of room"),
        (building(replace(TABLE, kind="bookshelf", name="shelf")), "shelf has no wall behind it"),
        (building(replace(TABLE, kind="monitor", name="monitor")), "monitor rests on nothing"),
        (building(replace(SOFA, size=(0.9, 2.0, 2.6))), "sofa is higher than the ceiling"),
        (building(bodies=(Body("mug", "mug", (3.0, 2.5, 0.4)),)), "mug floats"),
        (building(bodies=(Body("mug", "mug", (7.0, 2.5, 0.0)),)), "mug is outside all rooms"),
        (building(openings={0: (replace(DOOR, width=0.7),)}), "door between room and outside is 0.70 m wide; at least 0.8 m are needed"),
        (building(openings={0: (replace(DOOR, middle=0.3),)}), "door between room and outside extends beyond its wall or meets another opening"),
        (building(openings={2: (replace(WINDOW, height=1.7),)}), "window between room and outside is higher than the ceiling"),
        (building(openings={0: ()}), "room has no door"),
        (building(Piece("lamp_2", "floor_lamp", 0, "room", (4.5, 3.5, 0.0), 0.0, (0.4, 0.4, 1.6))), "lamp_2 has no light source"),
        (replace(building(), lamps=()), "lamp has no light source"),
        (replace(building(), pieces=()), "room has no ceiling lamp"),
        (replace(building(), starts=()), "room has no start"),
        (replace(building(), lamps=(*building().lamps, Lamp("floor", (1.0, 1.0, 1.0), 5.0))), "the light source at (1.0, 1.0, 1.0) has no lamp"),
    ],
)  # fmt: skip
def test_a_fault_is_named(plan: Building, fault: str) -> None:
    assert fault in check_building(plan)


def test_a_shelf_that_cuts_the_room_leaves_a_start_out_of_reach() -> None:
    shelf = Piece("shelf", "partition", 0, "room", (2.0, 2.0, 0.0), 0.0, (0.05, 4.0, 1.4))
    assert any("cannot be reached by a robot" in line for line in check_building(building(shelf)))


def test_an_unknown_material_is_named() -> None:
    plan = building()
    (storey,) = plan.storeys
    room = replace(storey.rooms[0], floor="lava")
    assert "room: material 'lava' is unknown" in check_building(replace(plan, storeys=(replace(storey, rooms=(room,)),)))


def test_the_box_of_a_piece_is_a_millimetre_smaller_on_each_side() -> None:
    box = piece_box(moved(TABLE, 1.0, 2.0, 0.5))
    assert box.rect == pytest.approx((0.701, 1.501, 1.299, 2.499)) and (box.z0, box.z1) == pytest.approx((0.501, 0.899))


def test_a_plan_is_drawn_north_up_at_90_pixels_a_metre() -> None:
    picture = draw_plan(building(SOFA), 0)
    # 5.3 x 4.3 m to the middle lines of the walls, and 0.5 m around.
    assert picture.shape == pytest.approx((477, 567, 3), abs=1)
    assert picture[45, 500].max() < 90 < picture[10, 10].min()
    window, door = picture[45, 45 + round(2.65 * 90)], picture[477 - 45, 45 + round(0.85 * 90)]
    assert window.tolist() == [150, 205, 240] and door.tolist() == [240, 235, 220]
