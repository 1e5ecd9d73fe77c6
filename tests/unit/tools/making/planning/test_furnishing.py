"""What fits into a room: a single one of 5 x 4 m within its walls, with a door below and a window above."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim_tools.making.building import Body, Building, Opening, Piece, Room, Storey, Wall
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.planning.floor_grid import FloorGrid
from gibson_sim_tools.making.planning.furnishing.dressing import add_lamps, put_on_floor, scatter
from gibson_sim_tools.making.planning.furnishing.groups import desk_group, place_at_wall, place_body_at_wall, table_group, wall_of
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.rooms import RoomView, WallFace, room_view
from gibson_sim_tools.making.planning.space import WALL_GAP, FurnishedRoom, FurnishingItem, Furnishings

CORNERS = ((-0.15, -0.15), (5.15, -0.15), (5.15, 4.15), (-0.15, 4.15))
"""The middle lines of walls of 0.3 m; the floor goes from (0, 0) to (5, 4)."""
DOOR = Opening("door", 0.85, 0.9, 0.0, 2.0, swing=1)
WINDOW = Opening("window", 2.65, 1.2, 0.9, 1.2)


def storey() -> Storey:
    walls = []
    for k in range(4):
        openings = {0: (DOOR,), 2: (WINDOW,)}.get(k, ())
        walls.append(Wall(CORNERS[k], CORNERS[(k + 1) % 4], 0.3, 2.5, "room", "", openings))
    return Storey(0.0, 2.5, (Room("room", "living", CORNERS),), tuple(walls))


def view() -> RoomView:
    return room_view(storey(), storey().rooms[0], ())


def furnished(seed: int = 0) -> FurnishedRoom:
    return FurnishedRoom(view(), 0, 0.0, 2.5, Furnishings(np.random.default_rng(seed)))


def face(room: FurnishedRoom, normal: tuple[int, int]) -> WallFace:
    return next(f for f in room.view.sides if f.normal == normal)


def item(
    x: float, y: float, size: tuple[float, float, float] = (1.0, 1.0, 1.0), kind: str = "armchair", **more: float
) -> FurnishingItem:
    return FurnishingItem(kind, (x, y), more.get("yaw", 0.0), size, more.get("lift", 0.0))


def test_an_item_has_a_box_and_a_zone_in_front() -> None:
    chair = item(2.0, 1.0, (0.5, 1.0, 0.8), yaw=math.pi / 2, lift=0.1)
    assert chair.rect == pytest.approx((1.5, 0.75, 2.5, 1.25))
    assert (chair.box.z0, chair.box.z1) == pytest.approx((0.1, 0.9))
    assert chair.point_ahead(1.0, 0.5) == pytest.approx((1.5, 2.0))
    assert chair.front(0.6) == pytest.approx((1.5, 1.25, 2.5, 1.85))
    assert item(0, 0, kind="rug").lies_flat and not chair.lies_flat


@pytest.mark.parametrize(
    ("candidate", "fits"),
    [
        (item(3.0, 2.0), True),
        (item(4.6, 2.0), False),  # through the wall
        (item(0.7, 0.7), False),  # in the sweep of the door
        (item(0.7, 0.7, (1.0, 1.0, 0.2), lift=2.1), True),  # above it
        (item(2.5, 3.5), False),  # higher than the sill, before the window
        (item(2.5, 3.5, (1.0, 1.0, 0.8)), True),  # below the sill
        (item(3.0, 2.0, (1.0, 1.0, 2.6)), False),  # higher than the ceiling
        (item(0.7, 0.7, (0.5, 0.5, 0.01), kind="rug"), True),  # rugs may be walked on
    ],
)
def test_an_item_fits_only_clear_of_doors_windows_and_walls(candidate: FurnishingItem, fits: bool) -> None:
    assert furnished().fits(candidate) is fits


def test_placed_items_take_their_place_and_keep_their_fronts_free() -> None:
    room = furnished()
    assert room.place([item(3.0, 2.0)], [Rect(3.5, 1.5, 4.3, 2.5)])
    assert not room.fits(item(3.4, 2.4))
    assert not room.fits(item(4.2, 2.0, (0.4, 0.4, 0.8)))
    assert room.fits(item(3.0, 2.0, (0.5, 0.5, 0.3), lift=1.0)), "on top"
    assert not room.is_open(Rect(2.0, 2.0, 3.0, 3.0)) and room.is_open(Rect(0.5, 3.0, 1.5, 3.5))
    (piece,) = room.furnishings.pieces
    assert (piece.name, piece.position, piece.storey) == ("room_armchair", (3.0, 2.0, 0.0), 0)


def test_an_item_that_blocks_the_path_from_the_door_to_a_front_is_not_placed() -> None:
    room = furnished()
    assert room.place([item(4.6, 3.6, (0.6, 0.6, 0.6))], [Rect(4.3, 2.6, 4.9, 3.2)])
    # A shelf across the room leaves a gap of 0.4 m, less than a way.
    assert not room.place([item(3.0, 1.8, (0.3, 3.6, 0.8))])
    assert room.place([item(3.0, 1.5, (0.3, 2.0, 0.8))])


def test_furnishings_can_be_rewound_and_names_are_counted() -> None:
    furnishings = Furnishings(np.random.default_rng(0))
    assert [furnishings.name("lamp"), furnishings.name("lamp"), furnishings.name("rug")] == ["lamp", "lamp_2", "rug"]
    snapshot = furnishings.snapshot()
    furnishings.bodies.append(Body("b", "mug", (0.0, 0.0, 0.0)))
    assert furnishings.name("lamp") == "lamp_3"
    furnishings.restore(snapshot)
    assert not furnishings.bodies and furnishings.name("lamp") == "lamp_3"


def test_free_intervals_of_a_wall_end_at_doors_and_windows_that_are_too_low() -> None:
    room = furnished()
    below, above = face(room, (0, 1)), face(room, (0, -1))
    # The zone of the door goes from 0.85 - 0.48 m to 0.85 + 0.48 m; the floor begins at 0.15 m along the middle line of the wall.
    assert room.free_intervals(below, 0.5, 0.8) == [pytest.approx((0.15, 0.37)), pytest.approx((1.33, 5.15))]
    assert room.free_intervals(above, 0.5, 0.8) == [pytest.approx((0.15, 5.15))]
    high = room.free_intervals(above, 0.3, 2.0)
    assert [b - a for a, b in high] == pytest.approx([1.9, 1.9])


def test_spots_lie_along_walls_and_the_best_come_first() -> None:
    room = furnished()
    right = face(room, (-1, 0))
    wall_positions = list(room.wall_positions(1.0, faces=[right], score=lambda _, along: 10.0 * along))
    assert wall_positions[0][1] == pytest.approx(right.high - 0.5) and wall_positions[-1][1] == pytest.approx(right.low + 0.5)
    assert list(room.wall_positions(4.5, faces=[right])) == []
    assert room.corner_gap(right, right.low + 0.7, 1.0) == pytest.approx(0.2)


def test_an_item_on_a_wall_stands_a_gap_before_it_and_finds_it_again() -> None:
    room = furnished()
    left = face(room, (1, 0))
    shelf = room.on_wall("bookshelf", left, left.low + 1.0, (0.3, 0.8, 2.0))
    assert shelf.middle[0] == pytest.approx(0.15 + WALL_GAP) and shelf.yaw == 0.0
    assert wall_of(room, shelf) is left
    assert wall_of(room, item(2.5, 2.0)) is None


def test_sizes_are_those_of_the_catalogue_or_fixed() -> None:
    room, kind = furnished(), CATALOGUE["sofa"]
    depth, width, height = room.size("sofa", width=2.0)
    assert width == 2.0 and kind.depth[0] <= depth <= kind.depth[1] and kind.height[0] <= height <= kind.height[1]
    assert 0.9 <= room.lift("television") <= 1.1


def test_chairs_face_their_table() -> None:
    table = item(2.5, 2.0, (0.8, 1.6, 0.75), "dining_table")
    items, fronts = table_group(furnished(), table, "chair", (0.5, 0.45, 0.9), (2, 1), 1)
    chairs = [c for c in items if c.kind == "chair"]
    assert len(chairs) == len(fronts) == 4
    for chair in chairs:
        toward = chair.point_ahead(1.0)
        assert math.dist(toward, table.middle) < math.dist(chair.middle, table.middle)
        assert not chair.rect.overlaps(table.rect)
    # On the front side 0.4 + 0.03 + 0.25 m ahead, a quarter of the width aside.
    assert chairs[0].middle == pytest.approx((3.18, 1.6))


def test_a_desk_has_its_chair_before_it_and_monitor_and_keyboard_on_it() -> None:
    desk = item(0.4, 2.0, (0.8, 1.4, 0.75), "desk")
    items, _ = desk_group(furnished(), desk, (0.6, 0.6, 1.0), lamp=False)
    by_kind = {i.kind: i for i in items}
    assert set(by_kind) == {"desk", "office_chair", "monitor", "keyboard"}
    assert by_kind["office_chair"].middle[0] == pytest.approx(0.8 + 0.04 + 0.3)
    assert by_kind["monitor"].lift == by_kind["keyboard"].lift == 0.75
    assert by_kind["monitor"].middle[0] < by_kind["keyboard"].middle[0]


def test_pieces_and_movable_bodies_come_to_walls() -> None:
    room = furnished()
    wardrobe = place_at_wall(room, "wardrobe")
    cabinet = place_body_at_wall(room, "cabinet_drawers", 0.8)
    assert wardrobe is not None and wall_of(room, wardrobe) is not None
    assert cabinet is not None and cabinet.movable and [b.model for b in room.furnishings.bodies] == ["cabinet_drawers"]
    assert not cabinet.rect.overlaps(wardrobe.rect)


def test_loose_objects_stand_on_top_of_tables_and_apart() -> None:
    room = furnished()
    table = item(2.5, 2.0, (0.8, 1.6, 0.75), "dining_table")
    assert room.place([table])
    scatter(room)
    on_top = [b for b in room.furnishings.bodies if b.position[2] == 0.75]
    assert 1 <= len(on_top) <= 8
    assert all(table.rect.holds((b.position[0], b.position[1])) for b in on_top)


def test_a_bin_stands_at_a_wall_away_from_the_door() -> None:
    room = furnished()
    put_on_floor(room, "bin_waste")
    (body,) = room.furnishings.bodies
    x, y, z = body.position
    # In a corner: half of its 0.28 m, and 4 cm from the wall behind it, 3 cm from the one beside it.
    assert z == 0.0 and sorted((x, y, 5.0 - x, 4.0 - y))[:2] == pytest.approx([0.17, 0.18])
    assert math.dist((x, y), (0.7, 0.4)) > 2.0


def test_every_room_gets_a_ceiling_lamp_that_shines() -> None:
    room = furnished()
    add_lamps(room)
    lamps = [p for p in room.furnishings.pieces if CATALOGUE[p.kind].stands == "ceiling"]
    assert lamps and len(room.furnishings.lamps) == len(lamps)
    for piece in lamps:
        assert piece.position[2] + piece.size[2] == pytest.approx(2.5)
        assert min(math.dist(piece.position[:2], lamp.position[:2]) for lamp in room.furnishings.lamps) < 1e-3


def _building(*pieces: Piece, bodies: tuple[Body, ...] = ()) -> Building:
    return Building("b", "flat", 0, (storey(),), pieces, bodies, (), ())


def test_a_shelf_across_the_room_makes_two_regions() -> None:
    across = Piece("shelf", "bookshelf", 0, "room", (3.0, 2.0, 0.0), 0.0, (0.3, 4.0, 2.0))
    free, split = (FloorGrid(b, 0, {"room": view()}, with_bodies=False) for b in (_building(), _building(across)))
    assert free.free.sum() * 0.025**2 == pytest.approx(20.0, rel=0.02)
    assert free.regions(0.25).max() == 1 and split.regions(0.25).max() == 2
    regions = split.regions(0.25)
    left, right = (split.region_near(regions, point, 0.3) for point in ((1.0, 2.0), (4.0, 2.0)))
    assert left and right and left != right
    assert split.region_near(regions, (3.0, 2.0), 0.05) == 0


def test_the_most_open_place_of_an_empty_room_is_its_middle_line() -> None:
    grid = FloorGrid(_building(), 0, {"room": view()}, with_bodies=True)
    x, y = grid.most_open(view().cells, 0.2) or (0.0, 0.0)
    assert y == pytest.approx(2.0, abs=0.05) and 1.9 < x < 3.1
    assert grid.most_open(view().cells, 2.5) is None


def test_bodies_on_the_floor_are_obstacles_if_included() -> None:
    box = Body("box", "box_cardboard", (2.5, 2.0, 0.0))
    with_it, without_it = (
        FloorGrid(_building(bodies=(box,)), 0, {"room": view()}, with_bodies=counts).free.sum() for counts in (True, False)
    )
    assert (without_it - with_it) * 0.025**2 == pytest.approx(0.3 * 0.4, rel=0.15)
