"""The file that describes a scene, and the hash by which two scenes are equal."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from gibson_sim.errors import SceneError, SceneNotFoundError
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.load import load_scene, with_robots
from support.scenes import write_room, write_square_obj, write_triangle_glb

WORLD = '<sdf version="1.6"><world name="w"><include><uri>model://ground_plane</uri></include></world></sdf>'


def test_missing_folder_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(SceneNotFoundError, match="nowhere"):
        load_scene(tmp_path / "nowhere")


def test_empty_folder_error_lists_the_accepted_files(tmp_path: Path) -> None:
    with pytest.raises(SceneNotFoundError, match=r"no scene.yaml, SDF world.*\.glb"):
        load_scene(tmp_path)


def test_folder_with_two_worlds_lists_them(tmp_path: Path) -> None:
    (tmp_path / "worlds").mkdir()
    for name in ("day.world", "night.sdf"):
        (tmp_path / "worlds" / name).write_text(WORLD)
    with pytest.raises(SceneNotFoundError, match=r"2 worlds.*worlds/day\.world, worlds/night\.sdf"):
        load_scene(tmp_path)


def test_only_world_of_a_folder_is_used_whatever_meshes_lie_beside(tmp_path: Path) -> None:
    (tmp_path / "day.world").write_text(WORLD)
    write_triangle_glb(tmp_path / "a.glb")
    (tmp_path / "model.sdf").write_text('<sdf version="1.6"><model name="m"/></sdf>')
    assert load_scene(tmp_path).ground_z == 0.0


def test_scene_yaml_takes_precedence(tmp_path: Path) -> None:
    (tmp_path / "day.world").write_text(WORLD)
    assert load_scene(write_room(tmp_path)).name == "tiny_room"


def test_bare_mesh_is_drawn_and_collides(tmp_path: Path) -> None:
    scene = load_scene(write_triangle_glb(tmp_path / "scan.glb"))
    assert [v.name for v in scene.visuals] == ["scan"]
    assert [c.name for c in scene.collisions] == ["scan"]


def test_other_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(SceneNotFoundError, match=r"notes\.txt: is not a scene"):
        load_scene(tmp_path / "notes.txt")


def _scene_with_mesh(folder: Path) -> Path:
    write_square_obj(folder, "gone.png")
    (folder / "scene.yaml").write_text("name: s\nobjects: [{mesh: square.obj}]\n")
    (folder / "notes.txt").write_text("one")
    return folder


def test_hash_changes_with_the_content_of_a_mesh(tmp_path: Path) -> None:
    before = load_scene(_scene_with_mesh(tmp_path)).content_hash
    mesh = tmp_path / "square.obj"
    mesh.write_text(mesh.read_text().replace("v 0 0.5 1", "v 0 0.5 2"))
    assert load_scene(tmp_path).content_hash != before


def test_hash_changes_with_the_material_of_a_mesh(tmp_path: Path) -> None:
    before = load_scene(_scene_with_mesh(tmp_path)).content_hash
    (tmp_path / "square.mtl").write_text("newmtl m\nKd 0 1 0\n")
    assert load_scene(tmp_path).content_hash != before


def test_hash_does_not_change_with_time_or_with_files_that_are_not_used(tmp_path: Path) -> None:
    before = load_scene(_scene_with_mesh(tmp_path)).content_hash
    (tmp_path / "notes.txt").write_text("two")
    (tmp_path / "square.obj").touch()
    assert load_scene(tmp_path).content_hash == before


def test_hash_does_not_depend_on_the_place_of_the_folder(tmp_path: Path) -> None:
    first, second = (load_scene(_scene_with_mesh(tmp_path / name)).content_hash for name in ("a", "b"))
    assert first == second


def test_warnings_name_files_relative_to_the_scene(tmp_path: Path) -> None:
    warnings = load_scene(_scene_with_mesh(tmp_path)).warnings
    assert any("gone.png" in w for w in warnings)


def test_two_robots_of_one_name_are_refused(tmp_path: Path) -> None:
    scene = load_scene(write_room(tmp_path))
    robot = load_robot("gibson_bot")
    with pytest.raises(SceneError, match="used twice"):
        with_robots(scene, [robot, robot])
    assert len(with_robots(scene, [robot, dataclasses.replace(robot, name="other")]).robots) == 2
