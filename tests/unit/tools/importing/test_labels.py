"""Labelled meshes fall apart into objects; lists of classes in the formats of data sets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.formats.mesh import Material, Mesh, MeshPart
from gibson_sim_tools.importing.labels import (
    LabelledFaces,
    class_name,
    habitat_classes,
    labelled_faces_of_textures,
    replica_classes,
    select_triangles,
    split_objects,
    transfer_labels,
)

RED, GREEN = (255, 0, 0), (0, 255, 0)


def part(*places: float, colors: tuple[tuple[int, int, int], ...] = ()) -> MeshPart:
    """Triangles of 3 cm at these x, each with vertices of its own."""
    corner = np.array([[0.0, 0, 0], [0.03, 0, 0], [0, 0.03, 0]], dtype=np.float32)
    vertices = np.concatenate([corner + np.float32([x, 0, 0]) for x in places])
    triangles = np.arange(3 * len(places), dtype=np.uint32).reshape(-1, 3)
    painted = np.repeat(np.array(colors, dtype=np.uint8), 3, axis=0) if colors else None
    return MeshPart(vertices, np.tile(np.float32([0, 0, 1]), (len(vertices), 1)), None, triangles, Material("m"), painted)


def test_chosen_triangles_keep_their_own_vertices_only() -> None:
    some = select_triangles(part(0.0, 1.0, 2.0), np.array([False, True, False]))
    assert some.triangles.tolist() == [[0, 1, 2]]
    assert some.vertices[0].tolist() == [1.0, 0.0, 0.0] and len(some.vertices) == len(some.normals) == 3


def test_a_mesh_falls_apart_by_numbers_over_all_its_parts() -> None:
    mesh = Mesh((part(0.0, 1.0), part(2.0)))
    chair, rest = split_objects(mesh, [np.array([7, 3]), np.array([7])], {7: "Office chair"})[::-1]
    assert (chair.name, chair.semantic_class) == ("office_chair_7", "office_chair")
    assert [p.vertices[0, 0] for p in chair.shape.parts] == [0.0, 2.0]
    assert (rest.name, rest.semantic_class) == ("unlabelled_3", "")


def test_triangles_take_the_label_of_the_nearest_face_within_ten_centimetres() -> None:
    labelled = LabelledFaces(np.array([[0.01, 0.01, 0.0], [1.06, 0.01, 0.0]]), np.array([4, 9]))
    assert [n.tolist() for n in transfer_labels(Mesh((part(0.0, 1.0, 2.0),)), labelled)] == [[4, 9, -1]]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Dining Table", "dining_table"),
        ("tv-screen#2", "tv_screen_2"),
        ("undefined", ""),
        ("VOID", ""),
        ("", ""),
        ("_wall_", "wall"),
    ],
)
def test_class_names_are_lower_case_words(text: str, name: str) -> None:
    assert class_name(text) == name


def test_classes_of_replica_and_of_scn_files(tmp_path: Path) -> None:
    info, scn = tmp_path / "info_semantic.json", tmp_path / "a.scn"
    info.write_text(json.dumps({"objects": [{"id": 3, "class_name": "chair"}, {"id": 5}]}))
    scn.write_text(json.dumps({"objects": [{"id": "3", "class_": "sofa"}]}))
    assert replica_classes(info) == habitat_classes(info) == {3: "chair", 5: ""}
    assert habitat_classes(scn) == {3: "sofa"}
    scn.write_text("[1, 2]")
    with pytest.raises(SceneError, match="is not a list of objects with id and class_"):
        habitat_classes(scn)
    scn.write_text("{")
    with pytest.raises(SceneError, match="is not JSON"):
        habitat_classes(scn)


def test_classes_of_a_matterport_house(tmp_path: Path) -> None:
    house = tmp_path / "a.house"
    house.write_text("ASCII 1.1\nC 0 1 wall 2 Wall 0\nC 1 1 dining#table\nO 5 0 1 0 0 0\nO 6 0 0 0\nO 7 0 8 0\n")
    assert habitat_classes(house) == {5: "dining table", 6: "Wall", 7: ""}
    house.write_text("C zero 1 wall\n")
    with pytest.raises(SceneError, match="a line cannot be read"):
        habitat_classes(house)


def _hm3d(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "a.semantic.txt"
    path.write_text(text)
    return path


def test_vertex_colours_of_hm3d_are_objects_if_they_nearly_agree(tmp_path: Path) -> None:
    lists = _hm3d(tmp_path, 'HM3D Semantic Annotations\n1,FF0000,"chair",0\n2,00FF00,"floor lamp",0\n')
    mesh = Mesh((part(0.0, 1.0, 2.0, colors=(RED, (1, 254, 0), (0, 0, 255))),))
    faces, classes = labelled_faces_of_textures(mesh, lists)
    assert faces.objects.tolist() == [1, 2] and classes == {1: "chair", 2: "floor lamp"}
    assert faces.centres == pytest.approx(np.array([[0.01, 0.01, 0.0], [1.01, 0.01, 0.0]]), abs=1e-6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1,FF00,chair,0", "not a number, a colour and a class"),
        ("x,FF0000,sofa,0", "not a number, a colour and a class"),
        ("title\n", "lists no objects"),
        ("1,0000FF,chair,0", "none of its 1 colours"),
    ],
)
def test_lists_of_hm3d_that_do_not_fit_are_refused(tmp_path: Path, text: str, why: str) -> None:
    with pytest.raises(SceneError, match=why):
        labelled_faces_of_textures(Mesh((part(0.0, colors=(RED,)),)), _hm3d(tmp_path, text))
