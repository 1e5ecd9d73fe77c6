"""Parts of what Blender bakes, as far as NumPy makes them; meshes of robots; pictures that are drawn."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim_tools.making.blender.assembly import shadow_caster
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface, facing_sides, pose_matrix
from gibson_sim_tools.making.blender.shell import door_frame, slab_edges, stair, window
from gibson_sim_tools.making.building import Body, Building, Opening, Room, Stair, Start, Storey, Wall
from gibson_sim_tools.making.objects.catalogue import LOOSE, OBJECTS
from gibson_sim_tools.making.pictures import best_start, eye_camera
from gibson_sim_tools.making.planning.objects import SIZES
from gibson_sim_tools.making.robots.surfaces import Finish, box, write_solids
from gibson_sim_tools.making.scene_folder import BakedMaterial, Patch, outside_panorama, write_boxes, write_glb

WALL = Wall((0.0, 0.0), (4.0, 0.0), 0.3, 2.5, "room", "")


def _builder() -> ObjectBuilder:
    return ObjectBuilder(np.random.default_rng(0))


def _bounds(builder: ObjectBuilder) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([p.vertices[p.triangles].reshape(-1, 3) for p in builder.parts])
    return points.min(axis=0), points.max(axis=0)


def test_large_bodies_cast_a_shadow_where_they_stand_and_small_ones_none() -> None:
    assert shadow_caster(Body("m", "mug", (0.0, 0.0, 0.0))) is None
    fridge = shadow_caster(Body("f", "fridge_body", (2.0, 1.0, 0.0), math.pi / 2))
    assert fridge is not None
    low, high = _bounds(fridge)
    # x from -0.34 to 0.31 of the fridge is y, from 0.66 to 1.31.
    assert low == pytest.approx([1.7, 0.66, 0.02]) and high == pytest.approx([2.3, 1.31, 1.78])


def test_a_window_fills_its_opening_and_its_frame_stands_outside() -> None:
    s = _builder()
    window(s, WALL, Opening("window", 2.0, 1.0, 0.9, 1.2), 0.0)
    low, high = _bounds(s)
    # The room is on the left, +y: the sill reaches 3.5 cm into it and 4 cm beyond the opening.
    assert low[0] == pytest.approx(1.46) and high[0] == pytest.approx(2.54)
    assert low[1] == pytest.approx(-0.15) and high[1] == pytest.approx(0.185)
    assert high[2] == pytest.approx(2.1)
    ((a, b),) = s.boxes
    assert a == pytest.approx([1.5, -0.04, 0.9]) and b == pytest.approx([2.5, 0.04, 2.1])


def test_a_door_frame_leaves_the_opening_and_a_passage_has_no_boards() -> None:
    door, passage = _builder(), _builder()
    door_frame(door, WALL, Opening("door", 2.0, 0.9, 0.0, 2.0, 1), 1.0)
    door_frame(passage, WALL, Opening("passage", 2.0, 0.9, 0.0, 2.1), 1.0)
    low, high = _bounds(door)
    assert (low[0], high[0], high[2]) == pytest.approx((1.49, 2.51, 3.06))
    boards = [p for p in door.parts if len(p.vertices) > 4]
    assert all(
        ((p.vertices[:, 0] <= 1.55 + 1e-9) | (p.vertices[:, 0] >= 2.45 - 1e-9) | (p.vertices[:, 2] >= 3.0 - 1e-9)).all()
        for p in boards
    )
    assert len(passage.parts) == 3


def test_steps_rise_evenly_to_the_floor_above() -> None:
    s = _builder()
    flight = Stair(0, (1.0, 2.0), math.pi / 2, 0.9, 0.25, 5, ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
    stair(s, flight, 0.0, 1.0)
    # Five rises of 0.2 m, four treads, turned by 90 degrees: x of the flight is y.
    assert [box_[1][2] for box_ in s.boxes] == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert [(box_[0][1], box_[1][1]) for box_ in s.boxes] == [pytest.approx((2.0 + 0.25 * k, 2.25 + 0.25 * k)) for k in range(4)]
    assert s.boxes[0][0][0] == pytest.approx(0.55) and s.boxes[0][1][0] == pytest.approx(1.45)
    edges = _builder()
    slab_edges(edges, flight, 2.5, 2.8)
    normals = [np.cross(p.vertices[1] - p.vertices[0], p.vertices[2] - p.vertices[0]) for p in edges.parts]
    towards = [np.array([0.5, 0.5, 2.65]) - p.vertices.mean(axis=0) for p in edges.parts]
    assert len(normals) == 4 and all(n @ t > 0 for n, t in zip(normals, towards, strict=True)), "they face into the hole"


def test_a_turned_box_is_where_it_was_put() -> None:
    s = _builder()
    s.box((0, 0, 0), (2, 1, 1), Surface("wood_oak"), bevel=0.0)
    s.transform(0, pose_matrix((10.0, 0.0, 0.0), yaw=math.pi / 2))
    low, high = _bounds(s)
    assert low == pytest.approx([9.0, 0.0, 0.0]) and high == pytest.approx([10.0, 2.0, 1.0])


def test_sides_are_numbered_by_axis_and_sign() -> None:
    up = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], dtype=float)
    assert facing_sides(np.concatenate([up, up[:, ::-1], up[:, :, [1, 2, 0]]])).tolist() == [4, 5, 2]


def test_quantised_positions_are_exact_to_a_65535th(tmp_path: Path) -> None:
    corners = np.random.default_rng(0).uniform(-3.0, 5.0, (40, 3, 3))
    write_glb(tmp_path / "a.glb", [Patch(BakedMaterial(color=(0.5, 0.5, 0.5, 0.25)), corners)])
    (part,) = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    found = part.vertices[part.triangles]
    assert np.abs(np.sort(found.reshape(-1, 3), axis=0) - np.sort(corners.reshape(-1, 3), axis=0)).max() < 8.0 / 65535
    assert part.material.alpha_mode == "blend" and part.material.base_color == pytest.approx((0.5, 0.5, 0.5, 0.25), abs=1e-6)


def test_boxes_face_outwards_and_share_no_triangle(tmp_path: Path) -> None:
    write_boxes(tmp_path / "a.glb", [[(0, 0, 0), (1, 2, 3)], [(5, 0, 0), (6, 1, 1)]])
    (part,) = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    a, b, c = (part.vertices[part.triangles[:, k]].astype(float) for k in range(3))
    assert len(part.triangles) == 24
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0 == pytest.approx(7.0, rel=1e-3)


def test_solids_of_one_finish_become_one_part(tmp_path: Path) -> None:
    solids = [box((x, 0.0, 0.0), (x + 1.0, 1.0, 1.0), finish, 0.05, 0.02) for x, finish in ((0.0, "a"), (2.0, "b"), (4.0, "a"))]
    write_solids(
        tmp_path / "a.glb",
        solids,
        {"a": Finish((0.2, 0.4, 0.6), 0.7, 0.5), "b": Finish((1.0, 1.0, 1.0), emissive=(0.5, 0.0, 0.0))},
    )
    first, second = load_mesh(tmp_path / "a.glb", [tmp_path]).parts
    assert (first.material.name, second.material.name) == ("a", "b")
    assert first.material.base_color == pytest.approx((0.2, 0.4, 0.6, 1.0), abs=1e-4)
    assert (first.material.metallic, first.material.roughness) == (0.5, 0.7) and second.material.emissive == (0.5, 0.0, 0.0)
    assert len(first.triangles) == 2 * len(second.triangles)
    assert np.abs(np.linalg.norm(first.normals, axis=1) - 1.0).max() < 0.02


def _room(name: str, width: float, depth: float) -> Room:
    return Room(name, "living", ((0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)))


def test_the_thumbnail_shows_the_largest_room_with_a_start() -> None:
    rooms = (_room("small", 2, 2), _room("large", 5, 4), _room("medium", 3, 3))
    starts = tuple(Start(name, (0.0, 0.0, 0.0), 0.0) for name in ("small", "medium"))
    building = Building("b", "flat", 0, (Storey(0.0, 2.5, rooms, ()),), (), (), (), starts)
    assert best_start(building).name == "medium"


def test_an_eye_looks_along_its_yaw_and_a_little_down() -> None:
    camera = eye_camera((1.0, 2.0, 3.0), math.pi / 2, 0.1)
    x, y, z, w = camera.pose.quat_xyzw
    forward = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    assert camera.pose.position == (1.0, 2.0, 3.0)
    assert forward == pytest.approx((0.0, math.cos(0.1), -math.sin(0.1)), abs=1e-9)


def test_outside_is_a_bright_sky_over_a_meadow_without_a_seam() -> None:
    picture = outside_panorama(1)
    assert picture.shape == (1024, 2048, 3)
    sky, meadow = picture[:200].mean(axis=(0, 1)), picture[700:].mean(axis=(0, 1))
    assert sky[2] > sky[0] and meadow[1] > meadow[2] and sky.min() > 180
    # The left edge continues at the right one.
    assert np.abs(picture[:, 0].astype(float) - picture[:, -1]).mean() < 2.0


@pytest.mark.parametrize("model", LOOSE, ids=lambda m: m.name)
def test_loose_objects_fit_into_the_size_that_plans_keep_for_them(model: object) -> None:
    assert model is OBJECTS[model.name]  # type: ignore[attr-defined]
    # Plans keep a box about the origin; objects may be smaller.
    assert all(own <= kept + 0.021 for own, kept in zip(model.size, SIZES[model.name], strict=True))  # type: ignore[attr-defined]
