"""From rooms to walls, and what a room sees of them: two rooms of 4 x 3 m and 3 x 3 m, side by side."""

from __future__ import annotations

import math

import pytest

from gibson_sim_tools.making.building import Opening, Room, Storey, Wall
from gibson_sim_tools.making.planning.layout import Space, rect_space
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.rooms import (
    LEAF_DEPTH,
    PASSAGE_DEPTH,
    SLIDING_DEPTH,
    WINDOW_DEPTH,
    cells_of,
    door_zones,
    face_of,
    room_view,
    wall_rect,
    window_zone,
)
from gibson_sim_tools.making.planning.walls import outline, walls_of

A, B = rect_space("a", "living", 0, 0, 4, 3), rect_space("b", "bedroom", 4, 0, 7, 3)
WALLS = walls_of([A, B], 0.1, 2.5)
BETWEEN = next(w for w in WALLS if w.left and w.right)


def test_two_rooms_have_seven_walls_and_one_between_them() -> None:
    assert len(WALLS) == 7  # those along x are split where the middle wall meets them
    assert [w for w in WALLS if w.left and w.right] == [BETWEEN]
    assert (BETWEEN.start, BETWEEN.end, BETWEEN.thickness) == ((4.0, 0.0), (4.0, 3.0), 0.1)
    assert (BETWEEN.left, BETWEEN.right) == ("a", "b")
    outer = [w for w in WALLS if w is not BETWEEN]
    assert all(w.thickness == 0.3 and w.height == 2.5 for w in outer)
    assert sum(math.dist(w.start, w.end) for w in outer) == pytest.approx(20.0)


def test_walls_where_four_rooms_meet_are_split_at_the_joint() -> None:
    rooms = [rect_space(n, "living", x, y, x + 2, y + 2) for n, x, y in (("a", 0, 0), ("b", 2, 0), ("c", 0, 2), ("d", 2, 2))]
    inside = [w for w in walls_of(rooms, 0.1, 2.5) if w.left and w.right]
    assert sorted((w.start, w.end) for w in inside) == [
        ((0.0, 2.0), (2.0, 2.0)),
        ((2.0, 0.0), (2.0, 2.0)),
        ((2.0, 2.0), (2.0, 4.0)),
        ((2.0, 2.0), (4.0, 2.0)),
    ]


def test_an_outline_goes_counter_clockwise_and_leaves_out_points_on_its_edges() -> None:
    ell = Space("l", "living", (Rect(0.0, 0.0, 4.0, 2.0), Rect(0.0, 2.0, 2.0, 4.0)))
    assert outline(ell) == ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))
    split = Space("s", "living", (Rect(0.0, 0.0, 1.0, 1.0), Rect(1.0, 0.0, 2.0, 1.0)))
    assert outline(split) == ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0))


def test_the_cells_of_an_ell_cover_it() -> None:
    cells = cells_of(((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)))
    assert sum(c.area for c in cells) == pytest.approx(12.0)
    assert not any(c.holds((3.0, 3.0)) for c in cells)


def test_a_face_lies_half_a_wall_inside_the_room_and_looks_into_it() -> None:
    left, right = face_of(BETWEEN, "a"), face_of(BETWEEN, "b")
    assert (left.side, left.start, left.normal, left.length) == (1, (3.95, 0.0), (-1, 0), 3.0)
    assert (right.side, right.start, right.normal) == (-1, (4.05, 0.0), (1, 0))
    assert left.yaw == pytest.approx(math.pi) and right.yaw == 0.0
    assert left.point(1.0, 0.5) == (3.45, 1.0)
    assert left.rect(1.0, 2.0, 0.0, 0.5) == pytest.approx((3.45, 1.0, 3.95, 2.0))
    assert not left.outer and face_of(WALLS[0], WALLS[0].left or WALLS[0].right).outer


def test_a_wall_covers_half_its_thickness_beyond_its_ends() -> None:
    assert wall_rect(BETWEEN) == pytest.approx((3.95, -0.05, 4.05, 3.05))


def test_a_door_keeps_the_sweep_of_its_leaf_free_and_the_way_on_the_other_side() -> None:
    door = Opening("door", 1.5, 0.9, 0.0, 2.0, swing=1)
    (sweep,), (way,) = door_zones(face_of(BETWEEN, "a"), door), door_zones(face_of(BETWEEN, "b"), door)
    assert sweep == pytest.approx((3.95 - LEAF_DEPTH, 1.02, 3.95, 1.98))
    assert way == pytest.approx((4.05, 1.02, 4.05 + PASSAGE_DEPTH, 1.98))


@pytest.mark.parametrize(("hinge", "low", "high"), [("start", 0.02, 1.98), ("end", 1.02, 2.98)])
def test_a_sliding_door_keeps_the_wall_free_that_it_slides_along(hinge: str, low: float, high: float) -> None:
    door = Opening("door", 1.5, 0.9, 0.0, 2.0, 1, hinge, "sliding_door_90")  # type: ignore[arg-type]
    way, rail = door_zones(face_of(BETWEEN, "a"), door)
    assert way.width == pytest.approx(PASSAGE_DEPTH)
    assert rail == pytest.approx((3.95 - SLIDING_DEPTH, low, 3.95, high), abs=0.011)


def test_a_window_keeps_its_width_free() -> None:
    window = Opening("window", 1.0, 0.8, 0.9, 1.2)
    assert window_zone(face_of(BETWEEN, "b"), window) == pytest.approx((4.05, 0.6, 4.05 + WINDOW_DEPTH, 1.4))


def _view(*openings: Opening, blocked: tuple[Rect, ...] = ()) -> object:
    walls = tuple(Wall(w.start, w.end, w.thickness, w.height, w.left, w.right, openings) if w is BETWEEN else w for w in WALLS)
    rooms = tuple(Room(s.name, s.kind, outline(s)) for s in (A, B))
    return room_view(Storey(0.0, 2.5, rooms, walls), rooms[0], blocked)


def test_a_room_sees_its_floor_within_the_walls() -> None:
    view = _view()
    # 4 x 3 m to the middle lines; three outer walls of 0.3 m and one of 0.1 m take half their thickness.
    assert view.area == pytest.approx((4.0 - 0.15 - 0.05) * (3.0 - 0.3))
    assert view.holds(Rect(0.15, 0.15, 3.95, 2.85)) and not view.holds(Rect(0.1, 0.15, 1.0, 1.0))
    assert sorted(round(f.length, 3) for f in view.sides) == [2.7, 2.7, 3.8, 3.8]


def test_doors_lead_to_the_other_room_and_windows_have_a_zone() -> None:
    view = _view(Opening("door", 0.8, 0.8, 0.0, 2.0, 1), Opening("window", 2.2, 0.6, 0.9, 1.2))
    ((gate,), (window,)) = view.gates, view.windows
    assert gate.other_room == "b" and gate.point == pytest.approx((3.95 - 0.42, 0.8))
    assert window.zone == pytest.approx((3.95 - WINDOW_DEPTH, 1.9, 3.95, 2.5))


def test_stairs_are_no_floor_and_end_the_depth_before_a_wall() -> None:
    stair = Rect(0.0, 1.0, 2.0, 2.0)
    view = _view(blocked=(stair,))
    assert view.area == pytest.approx(3.8 * 2.7 - 1.85)
    face = next(f for f in view.faces if f.wall is BETWEEN or f.wall.right == "b")
    assert view.depth_at(face, 0.5) == pytest.approx(3.8)
    assert view.depth_at(face, 1.5) == pytest.approx(1.95)
