"""Rooms that a scene names: their outlines, and errors in the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.maps.named_poses import named_poses
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.spec import SceneSpec
from support.scenes import write_room

L_SHAPE = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 3.0), (0.0, 3.0))
KITCHEN = "{name: kitchen, class: kitchen, polygon: [[0, 0], [3, 0], [3, 2], [0, 2]]}"


def _load(folder: Path, rooms: str, floors: str = "") -> SceneSpec:
    (folder / "scene.yaml").write_text(f"ground_z: 0\n{floors}rooms: [{rooms}]\n")
    return load_scene(folder)


def test_a_room_knows_its_area_and_what_lies_in_it() -> None:
    room = RoomSpec("kitchen", "kitchen", 0, L_SHAPE)
    assert room.area == 10.0
    assert RoomSpec("kitchen", "kitchen", 0, L_SHAPE[::-1]).area == 10.0
    assert room.contains([(1.0, 1.0), (3.0, 2.5), (1.0, 2.5), (5.0, 1.0)]).tolist() == [True, False, True, False]


def test_places_on_the_wall_between_two_rooms_lie_in_just_one() -> None:
    left = RoomSpec("a", "hall", 0, ((0, 0), (1, 0), (1, 1), (0, 1)))
    right = RoomSpec("b", "hall", 0, ((1, 0), (2, 0), (2, 1), (1, 1)))
    wall = np.column_stack([np.ones(9), np.linspace(0.0, 0.99, 9)])
    assert (left.contains(wall) ^ right.contains(wall)).all()


def test_a_scene_returns_the_room_at_a_place(tmp_path: Path) -> None:
    upper = "{name: bedroom, class: bedroom, floor: 1, polygon: [[0, 0], [2, 0], [2, 2]]}"
    scene = _load(tmp_path, f"{KITCHEN}, {upper}", "floors: [0.0, 2.8]\n")
    assert [(room.name, room.room_class, room.floor) for room in scene.rooms] == [
        ("kitchen", "kitchen", 0),
        ("bedroom", "bedroom", 1),
    ]
    found = [scene.room_at(x, y, floor) for x, y, floor in ((2.5, 0.5, 0), (1.5, 0.5, 1), (0.5, 1.5, 1), (9.0, 9.0, 0))]
    assert [room.name if room else None for room in found] == ["kitchen", "bedroom", None, None]


@pytest.mark.parametrize(
    ("rooms", "words"),
    [
        ("{name: a, class: b, poligon: []}", "did you mean 'polygon'"),
        ("{class: kitchen, polygon: [[0, 0], [1, 0], [1, 1]]}", "has no name"),
        ("{name: a, polygon: [[0, 0], [1, 0], [1, 1]]}", "has no class"),
        ("{name: a, class: b}", "polygon has 0 corners, must have 3 to 1000"),
        ("{name: a, class: b, polygon: [[0, 0], [1, 0], [1, .nan]]}", r"polygon\[2\].*must be a finite number"),
        ("{name: a, class: b, polygon: [[0, 0], [1, 0], 1]}", r"polygon\[2\].*must be a list of 2 numbers"),
        ("{name: a, class: b, polygon: [[0, 0], [1, 0], [2, 0]]}", "area of 0 m"),
        (
            "{name: a, class: b, polygon: [[0, 0], [3, 2], [3, 0], [0, 1]]}",
            "edge between corners 0 and 1 .* intersects .* 2 and 3",
        ),
        ("{name: a, class: b, floor: 1, polygon: [[0, 0], [1, 0], [1, 1]]}", "floor is 1, must be 0, the scene has one floor"),
        ("{name: a, class: b, floor: true, polygon: [[0, 0], [1, 0], [1, 1]]}", "floor is True"),
        (f"{KITCHEN}, {KITCHEN}", "'kitchen' is used twice"),
    ],
)
def test_an_invalid_room_is_refused_in_one_line(tmp_path: Path, rooms: str, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        _load(tmp_path, rooms)
    assert "scene.yaml: rooms[" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_named_poses_of_rooms_have_the_names_in_the_scene(tmp_path: Path) -> None:
    folder = write_room(
        tmp_path / "room", "rooms: [{name: den, class: living_room, polygon: [[-2, -2], [2, -2], [2, 2], [-2, 2]]}]\n"
    )
    (room,) = (pose for pose in named_poses(load_scene(folder)) if "room" in pose.tags)
    assert room.name == "floor_0/den"
    assert room.description.endswith("m^2: den")
    assert room.tags == ("room", "floor_0", "living_room")
