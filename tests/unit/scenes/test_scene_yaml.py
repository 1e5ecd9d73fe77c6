"""scene.yaml: objects, poses, start poses, and errors in the file."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.description.shapes import Appearance
from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_meshes import collision_triangles
from gibson_sim.scenes.spec import PointLight, SceneSpec
from support.scenes import write_square_obj, write_triangle_glb


def _load(folder: Path, text: str) -> SceneSpec:
    (folder / "scene.yaml").write_text(text)
    return load_scene(folder)


def _refused(folder: Path, text: str) -> str:
    with pytest.raises(SceneError) as caught:
        _load(folder, text)
    message = str(caught.value)
    assert "\n" not in message
    assert "scene.yaml" in message
    return message


@pytest.mark.parametrize(
    ("text", "wrong", "right"),
    [
        ("grond_z: 0\n", "grond_z", "ground_z"),
        ("objects: [{box: [1, 1, 1], colour: [1, 0, 0]}]\n", "colour", "color"),
        ("objects: [{box: [1, 1, 1], pose: {rpy: [0, 0, 0]}}]\n", "rpy", "rpy_deg"),
        ("starts: [{xy: [0, 0], yaw: 3}]\n", "yaw", "yaw_deg"),
        ("light: {ambiant: 1}\n", "ambiant", "ambient"),
    ],
)
def test_unknown_key_names_the_nearest_known_one(tmp_path: Path, text: str, wrong: str, right: str) -> None:
    message = _refused(tmp_path, text)
    assert f"'{wrong}'" in message
    assert f"did you mean '{right}'" in message


def test_pose_of_a_primitive_is_in_metres_and_degrees(tmp_path: Path) -> None:
    scene = _load(tmp_path, "objects: [{name: b, box: [2, 4, 6], pose: {xyz: [1, 2, 3], rpy_deg: [0, 0, 90]}}]\n")
    (visual,) = scene.visuals
    assert (visual.name, visual.shape.kind, visual.shape.size) == ("b", "box", (2, 4, 6))
    corners, _ = collision_triangles(scene)
    # Rotated by 90 degrees, its 4 m lie along x and its 2 m along y.
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-1, 1, 0], [3, 3, 6]], atol=1e-6)


def test_roll_comes_before_yaw(tmp_path: Path) -> None:
    scene = _load(tmp_path, "objects: [{cylinder: {radius: 1, length: 2}, pose: {rpy_deg: [90, 0, 90]}}]\n")
    # About fixed axes: roll takes z to -y, yaw takes -y to x.
    np.testing.assert_allclose(matrix_from_pose(scene.visuals[0].pose)[:3, 2], [1, 0, 0], atol=1e-9)


def test_equal_names_are_numbered(tmp_path: Path) -> None:
    scene = _load(tmp_path, "objects: [{name: b, sphere: 1}, {name: b, sphere: 1}, {name: b, sphere: 1}]\n")
    assert [v.name for v in scene.visuals] == ["b", "b_2", "b_3"]


def test_equal_names_of_starts_are_refused(tmp_path: Path) -> None:
    message = _refused(tmp_path, "ground_z: 0\nstarts: [{name: a, xy: [0, 0]}, {name: a, xy: [1, 0]}]\n")
    assert "'a' is used twice" in message


def test_starts_stand_on_the_floor_and_look_along_their_yaw(tmp_path: Path) -> None:
    text = "ground_z: 0.5\nstarts: [{name: a, xy: [1, 2], yaw_deg: 90}, {name: b, xyz: [1, 2, 3]}]\n"
    first, second = _load(tmp_path, text).starts
    assert first.name == "a"
    assert tuple(first.pose.position) == (1, 2, 0.5)
    np.testing.assert_allclose(matrix_from_pose(first.pose)[:3, 0], [0, 1, 0], atol=1e-9)
    assert tuple(second.pose.position) == (1, 2, 3)


def test_broken_mesh_is_an_error_that_names_the_object(tmp_path: Path) -> None:
    (tmp_path / "bad.glb").write_bytes(b"glTF")
    message = _refused(tmp_path, "objects: [{name: chair, mesh: bad.glb}]\n")
    assert "chair" in message
    assert "bad.glb" in message


def test_missing_mesh_is_an_error(tmp_path: Path) -> None:
    assert "gone.glb" in _refused(tmp_path, "objects: [{mesh: gone.glb}]\n")


def test_mesh_outside_the_folder_is_refused(tmp_path: Path) -> None:
    write_triangle_glb(tmp_path / "t.glb")
    (tmp_path / "scene").mkdir()
    assert "outside" in _refused(tmp_path / "scene", "objects: [{mesh: ../t.glb}]\n")


def test_collision_is_the_mesh_itself_or_none_or_another_one(tmp_path: Path) -> None:
    write_triangle_glb(tmp_path / "t.glb")
    write_square_obj(tmp_path, "gone.png")
    scene = _load(
        tmp_path,
        "objects:\n  - {name: a, mesh: t.glb}\n  - {name: b, mesh: t.glb, collision: none}\n"
        "  - {name: c, mesh: t.glb, collision: square.obj}\n  - {name: d, mesh: t.glb, collision: same}\n",
    )
    assert [v.name for v in scene.visuals] == ["a", "b", "c", "d"]
    assert [(c.name, Path(c.shape.mesh).name) for c in scene.collisions] == [
        ("a", "t.glb"), ("c", "square.obj"), ("d", "t.glb"),
    ]  # fmt: skip


def test_up_axis_unit_and_scale_of_a_mesh_are_applied(tmp_path: Path) -> None:
    # A square in the y-z plane: y from -0.5 to 0.5, z from 0 to 1.
    write_square_obj(tmp_path, "gone.png")
    scene = _load(tmp_path, "objects: [{mesh: square.obj, up_axis: y, unit_m: 0.1, scale: [1, 2, 3]}]\n")
    corners, _ = collision_triangles(scene)
    # y up: (x, y, z) -> (x, -z, y), in decimetres, then twice as deep and three times as high.
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[0, -0.2, -0.15], [0, 0, 0.15]], atol=1e-6)


def test_name_gravity_light_class_and_colour_are_taken_over(tmp_path: Path) -> None:
    scene = _load(
        tmp_path,
        "name: moon\ngravity: 1.6\nlight: {sun_direction: [0, 0, -1], sun: 0.25, background: [0, 0, 0]}\n"
        "objects: [{sphere: 1, semantic_class: rock, color: [0.1, 0.2, 0.3, 0.4]}]\n",
    )
    assert (scene.name, scene.gravity) == ("moon", (0, 0, -1.6))
    assert (scene.light.sun_direction, scene.light.sun, scene.light.background) == ((0, 0, -1), 0.25, (0, 0, 0))
    assert (scene.visuals[0].semantic_class, scene.visuals[0].color) == ("rock", (0.1, 0.2, 0.3, 0.4))


def test_floor_is_the_ground_unless_it_is_given(tmp_path: Path) -> None:
    assert _load(tmp_path, "ground_z: 0.25\n").floor_z == 0.25
    assert _load(tmp_path, "ground_z: 0.25\nfloor_z: 1.5\n").floor_z == 1.5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("objects: [{name: a}]\n", "no shape"),
        ("objects: [{name: a, box: [1, 1, 1], sphere: 1}]\n", "box, sphere"),
        ("objects: [{name: a, box: [1, 1, 0]}]\n", "from 1e-06"),
        ("objects: [{name: a, box: [1, 1]}]\n", "list of 3 numbers"),
        ("objects: [{name: a, sphere: .nan}]\n", "finite"),
        ("objects: [{name: a, sphere: 1, scale: 2}]\n", "scale is for meshes"),
        ("objects: [{name: a, sphere: 1, color: [255, 0, 0]}]\n", "255"),
        ("objects: {a: 1}\n", "must be a list"),
        ("starts: [{name: a}]\n", "either xy"),
        ("ground_z: yes\n", "must be a finite number"),
        ("- a\n", "must be a mapping"),
        ("a: [\n", "not YAML"),
    ],
)
def test_wrong_value_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    assert said in _refused(tmp_path, text)


def test_scene_with_nothing_in_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no visuals, collision shapes or ground plane"):
        _load(tmp_path, "name: void\n")


def test_yaw_of_45_degrees_is_not_taken_as_radians(tmp_path: Path) -> None:
    scene = _load(tmp_path, "objects: [{sphere: 1, pose: {rpy_deg: [0, 0, 45]}}]\n")
    assert matrix_from_pose(scene.visuals[0].pose)[1, 0] == pytest.approx(math.sqrt(0.5))


def test_all_of_the_light_is_taken_over(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "sky.png"), np.zeros((8, 16, 3), dtype=np.uint8))
    scene = _load(
        tmp_path,
        "objects: [{box: [1, 1, 1]}]\n"
        "light:\n"
        "  sun_color: [1, 0.9, 0.8]\n"
        "  shadows: true\n"
        "  points:\n"
        "  - {position: [1, 2, 3], color: [1, 0, 0], strength: 5, range: 4, attenuation: [1, 0, 0.5]}\n"
        "  - {position: [0, 0, 2], direction: [0, 1, 0], inner_deg: 10, outer_deg: 30}\n"
        "  environment: sky.png\n"
        "  environment_strength: 0.5\n"
        "  environment_yaw_deg: 90\n"
        "  environment_visible: false\n",
    )
    light = scene.light
    assert (light.sun_color, light.shadows) == ((1, 0.9, 0.8), True)
    assert light.points[0] == PointLight((1, 2, 3), (1, 0, 0), 5, 4, (1, 0, 0.5))
    assert light.points[1].direction == (0, 1, 0)
    assert (light.points[1].inner_angle, light.points[1].outer_angle) == pytest.approx((math.radians(10), math.radians(30)))
    assert (light.environment, light.environment_strength) == (str(tmp_path / "sky.png"), 0.5)
    assert light.environment_yaw == pytest.approx(math.pi / 2)
    assert not light.environment_visible
    # The environment is the ambient light.
    assert light.ambient == 0.0


def test_the_image_of_the_surroundings_is_part_of_the_digest(tmp_path: Path) -> None:
    text = "objects: [{box: [1, 1, 1]}]\nlight: {environment: sky.png}\n"
    digests = set()
    for value in (0, 1):
        assert cv2.imwrite(str(tmp_path / "sky.png"), np.full((8, 16, 3), value, dtype=np.uint8))
        digests.add(_load(tmp_path, text).content_hash)
    assert len(digests) == 2


@pytest.mark.parametrize(
    ("light", "words"),
    [
        ("{points: [{color: [1, 1, 1]}]}", "position is None, must be a list of 3 numbers"),
        ("{points: [{position: [0, 0, 1], strenght: 2}]}", "did you mean 'strength'"),
        ("{points: [{position: [0, 0, 1], attenuation: [0, 0, 0]}]}", "one of the three must be above 0"),
        (
            "{points: [{position: [0, 0, 1], inner_deg: 40, outer_deg: 30}]}",
            "inner_deg is 40, must be a finite number, from 0 to 30",
        ),
        ("{shadows: 1}", "shadows is 1, must be true or false"),
        ("{environment: none.hdr}", "none.hdr is missing"),
        ("{environment: ../sky.hdr}", "lies outside the scene's folder"),
        ("{sun_direction: [0, 0, 0]}", "must not be zero"),
    ],
)
def test_a_mistake_in_the_light_is_named(tmp_path: Path, light: str, words: str) -> None:
    (tmp_path / "scene").mkdir()
    assert words in _refused(tmp_path / "scene", f"objects: [{{box: [1, 1, 1]}}]\nlight: {light}\n")


def test_metal_and_roughness_of_an_object_become_its_appearance(tmp_path: Path) -> None:
    first, second = _load(tmp_path, "objects: [{sphere: 1, metallic: 1, roughness: 0.2}, {sphere: 1}]\n").visuals
    assert (first.appearance, second.appearance) == (Appearance(metallic=1.0, roughness=0.2), None)


@pytest.mark.parametrize("name", ["x" * 201, "a\\nb", "a\\e[31m"])
def test_name_of_a_scene_is_one_line(tmp_path: Path, name: str) -> None:
    with pytest.raises(SceneError, match=r"^scene '[^\x00-\x1f]*: its name must be one line of at most 200 characters$"):
        _load(tmp_path, f'name: "{name}"\nground_z: 0\n')
