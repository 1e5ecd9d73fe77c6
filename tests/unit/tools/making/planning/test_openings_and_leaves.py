"""Doors, passages and windows in walls, and the leaves of doors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim_tools.making.building import Body, Opening, Storey, Wall
from gibson_sim_tools.making.planning.layout import Level, SpaceLink, rect_space
from gibson_sim_tools.making.planning.objects import body_box, door_body, door_model, is_door, leaf_corners, leaf_rect
from gibson_sim_tools.making.planning.rectangles import Rect
from gibson_sim_tools.making.planning.walls import hang_doors, walls_of, with_doors, with_windows

SPACES = (rect_space("a", "living", 0, 0, 4, 3), rect_space("b", "bedroom", 4, 0, 8, 3))
WALLS = walls_of(SPACES, 0.1, 2.5)


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _openings(walls: tuple[Wall, ...], left: str, right: str) -> list[Opening]:
    return [o for w in walls if {w.left, w.right} == {left, right} for o in w.openings]


def test_a_link_becomes_a_door_into_its_second_room_near_a_corner() -> None:
    walls = with_doors(WALLS, (SpaceLink("a", "b"),), _rng())
    assert walls is not None
    (door,) = _openings(walls, "a", "b")
    # The wall's left is a: a door into b opens to the right. 0.24 m and half the door from either end.
    assert (door.kind, door.swing, door.width) == ("door", -1, 0.9)
    assert min(door.middle, 3.0 - door.middle) == pytest.approx(0.69)
    assert door.hinge == ("start" if door.middle < 1.5 else "end")
    assert door.body == door_model(0.9, -1, door.hinge)


def test_a_passage_has_no_leaf_and_lies_near_its_point() -> None:
    walls = with_doors(WALLS, (SpaceLink("a", "b", "passage", 1.2, near=(4.0, 1.5)),), _rng())
    assert walls is not None
    (passage,) = _openings(walls, "a", "b")
    assert (passage.kind, passage.swing, passage.body) == ("passage", 0, "")
    assert passage.middle == pytest.approx(1.5, abs=0.1)


def test_a_door_wider_than_its_wall_finds_no_place() -> None:
    assert with_doors(WALLS, (SpaceLink("a", "b", "passage", 2.6),), _rng()) is None
    assert with_doors(WALLS, (SpaceLink("a", "c"),), _rng()) is None


def test_windows_are_in_outside_walls_within_the_limits_of_their_room() -> None:
    walls = with_windows(WALLS, Level(2.5, SPACES, ()), (), Rect(0, 0, 0, 0), _rng())
    assert not _openings(walls, "a", "b")
    windows = [o for w in walls for o in w.openings]
    assert windows and all(o.kind == "window" for o in windows)
    living = _openings(walls, "a", "")
    assert living and all((o.sill, o.height) == (0.9, 1.35) and 0.98 <= o.width <= 2.1 for o in living)


def test_rooms_without_windows_and_walls_beside_stairs_stay_closed() -> None:
    level = Level(2.5, SPACES, (), windowless=("a",))
    assert not _openings(with_windows(WALLS, level, (), Rect(0, 0, 0, 0), _rng()), "a", "")
    everywhere = (Rect(-1.0, -1.0, 9.0, 9.0),)
    walls = with_windows(WALLS, Level(2.5, SPACES, ()), everywhere, Rect(0, 0, 0, 0), _rng())
    assert not any(w.openings for w in walls)


@pytest.mark.parametrize(
    ("swing", "hinge", "hand"), [(1, "start", "left"), (1, "end", "right"), (-1, "start", "right"), (-1, "end", "left")]
)
def test_the_hand_of_a_door_follows_from_side_and_hinge(swing: int, hinge: str, hand: str) -> None:
    assert door_model(0.8, swing, hinge) == f"door_80_{hand}"


WALL = Wall((0.0, 0.0), (4.0, 0.0), 0.1, 2.5, "a", "b")


def test_a_closed_leaf_lies_in_its_opening_and_an_open_one_stands_across() -> None:
    opening = Opening("door", 2.0, 0.9, 0.0, 2.0, 1, "start", "door_90_left")
    closed = door_body("d", WALL, opening, 1.5, 0.0)
    assert closed.position[2] == 1.5 and closed.yaw == 0.0 and is_door(closed)
    # The hinge is 22 mm inside the opening, which goes from 1.55 to 2.45 m.
    assert leaf_rect(closed) == pytest.approx((1.552, 0.005, 2.446, 0.045), abs=1e-6)
    opened = leaf_rect(door_body("d", WALL, opening, 0.0, math.pi / 2))
    assert opened.depth == pytest.approx(0.894) and opened.y1 > 0.85 and opened.x1 < 1.6
    assert body_box(closed).z1 == pytest.approx(1.5 + 2.1)


def test_a_leaf_on_the_right_opens_to_the_right() -> None:
    opening = Opening("door", 2.0, 0.9, 0.0, 2.0, -1, "start", "door_90_right")
    opened = leaf_rect(door_body("d", WALL, opening, 0.0, math.pi / 2))
    assert opened.y0 < -0.85 and opened.x1 < 1.6


def test_a_sliding_leaf_moves_along_the_wall_and_stops_at_its_end() -> None:
    opening = Opening("door", 2.0, 0.9, 0.0, 2.0, 1, "end", "sliding_door_90")
    closed, opened = (leaf_rect(door_body("d", WALL, opening, 0.0, joint)) for joint in (0.0, 5.0))
    assert closed.x0 == pytest.approx(1.53) and closed.width == pytest.approx(0.94)
    assert opened.x0 - closed.x0 == pytest.approx(0.88)
    assert closed.y0 == pytest.approx(opened.y0) and closed.y0 > 0.05


def test_other_bodies_have_the_box_of_their_model() -> None:
    box = body_box(Body("b", "box_cardboard", (1.0, 2.0, 0.5), math.pi / 2))
    assert box.rect == pytest.approx((0.8, 1.85, 1.2, 2.15)) and (box.z0, box.z1) == (0.5, 0.78)
    assert len(leaf_corners(door_body("d", WALL, Opening("door", 2.0, 0.8, 0.0, 2.0, 1, "start", "door_80_left"), 0, 0))) == 4


def _storey(walls: list[Wall]) -> Storey:
    return Storey(0.0, 2.5, (), tuple(walls))


def _door(left: str, right: str, number: int) -> Wall:
    door = Opening("door", 2.0, 0.9, 0.0, 2.0, 1, "start", "door_90_left")
    return Wall((0.0, float(number)), (4.0, float(number)), 0.1, 2.5, left, right, (door,))


def test_the_front_door_is_closed_and_the_only_door_of_a_room_is_not() -> None:
    walls = [_door("", "hall", 0), _door("hall", "bedroom", 1), Wall((0.0, 2.0), (4.0, 2.0), 0.3, 2.5, "", "bedroom")]
    for seed in range(10):
        bodies = {b.name: b for b in hang_doors([_storey(walls)], np.random.default_rng(seed))}
        assert bodies["front_door"].joints == {"hinge": 0.0}
        assert bodies["hall_door"].joints["hinge"] >= 1.15


def test_a_door_with_a_detour_may_be_closed_and_at_most_one_is() -> None:
    walls = [_door("a", "b", 0), _door("b", "c", 1), _door("c", "a", 2)]
    closed = []
    for seed in range(20):
        bodies = hang_doors([_storey(walls)], np.random.default_rng(seed))
        closed.append(sum(b.joints["hinge"] == 0.0 for b in bodies))
        assert len({b.name for b in bodies}) == 3
        assert all(("closed" in b.name) == (b.joints["hinge"] == 0.0) for b in bodies)
    assert set(closed) == {0, 1}
