"""PLY files, and colours of vertices in other formats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import Mesh
from gibson_sim.formats.ply import read_ply_tables
from support.gltf import Gltf
from support.plys import COLORS, CORNERS, ply


def _read(folder: Path, data: bytes, name: str = "mesh.ply") -> Mesh:
    (folder / name).write_bytes(data)
    return load_mesh(folder / name, [folder])


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_a_coloured_quad_becomes_two_triangles_in_every_format(tmp_path: Path, order: str) -> None:
    (part,) = _read(tmp_path, ply(order=order)).parts
    np.testing.assert_array_equal(part.vertices, np.float32(CORNERS))
    np.testing.assert_array_equal(part.colors, COLORS)
    assert part.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert part.material.unlit and part.material.colored
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 4)


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_triangles_and_quads_may_be_mixed(tmp_path: Path, order: str) -> None:
    (part,) = _read(tmp_path, ply(faces=[[0, 1, 2], [0, 1, 2, 3]], order=order)).parts
    assert part.triangles.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]


def test_a_plain_ply_has_no_colours_and_is_lit(tmp_path: Path) -> None:
    (part,) = _read(tmp_path, ply(colors=None)).parts
    assert part.colors is None and not part.material.unlit and not part.material.colored


def test_a_point_cloud_is_refused_and_the_message_says_what_makes_a_mesh_of_it(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"point cloud.*MeshLab.*4 points"):
        _read(tmp_path, ply(faces=[]))


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("kept", [0.3, 0.6, 0.95])
def test_a_file_that_is_cut_is_refused(tmp_path: Path, order: str, kept: float) -> None:
    data = ply(faces=[[0, 1, 2, 3], [0, 1, 2]], order=order)
    with pytest.raises(MeshError, match=r"cut|broken"):
        _read(tmp_path, data[: int(kept * len(data))])


def test_a_property_without_a_type_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="unknown type"):
        _read(tmp_path, ply().replace(b"property float x", b"property"))


def test_a_property_that_comes_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="has property 'x' twice"):
        _read(tmp_path, ply().replace(b"property float y", b"property float x"))


def test_a_count_larger_than_the_file_takes_no_memory(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="do not fit"):
        _read(tmp_path, ply().replace(b"element vertex 4", b"element vertex 4000000000"))


def test_a_face_that_names_a_missing_vertex_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="names vertex 9, but there are 4"):
        _read(tmp_path, ply(faces=[[0, 1, 9]]))


@pytest.mark.parametrize("scale", [1.0, 1.0 / 255.0])
def test_an_obj_may_have_colours_of_vertices(tmp_path: Path, scale: float) -> None:
    lines = [f"v {x} {y} {z} {r * scale} {g * scale} {b * scale}" for (x, y, z), (r, g, b) in zip(CORNERS, COLORS, strict=True)]
    (part,) = _read(tmp_path, "\n".join([*lines, "f 1 2 3 4"]).encode(), "mesh.obj").parts
    np.testing.assert_array_equal(part.colors, COLORS)
    assert part.material.unlit


def test_the_colours_of_a_gltf_are_linear(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    attributes = gltf.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = gltf.accessor([[1.0, 0.0, 0.0], [0.0, 0.214, 0.0], [0.0, 0.0, 0.0]])
    (part,) = _read(tmp_path, gltf.glb(), "mesh.glb").parts
    np.testing.assert_allclose(part.colors, [[255, 0, 0], [0, 127, 0], [0, 0, 0]], atol=1)


@pytest.mark.parametrize(("alpha", "columns"), [(1.0, 3), (0.5, 4)])
def test_colours_have_alpha_only_if_it_is_below_one_somewhere(tmp_path: Path, alpha: float, columns: int) -> None:
    gltf = Gltf().triangle()
    attributes = gltf.document["meshes"][0]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = gltf.accessor([[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, alpha], [0.0, 0.0, 0.0, 1.0]])
    (part,) = _read(tmp_path, gltf.glb(), "mesh.glb").parts
    assert part.colors is not None
    assert part.colors.shape == (3, columns)


def test_colours_survive_a_transform(tmp_path: Path) -> None:
    mesh = _read(tmp_path, ply()).transformed(np.diag([2.0, 2.0, 2.0, 1.0]))
    np.testing.assert_array_equal(mesh.parts[0].colors, COLORS)


@pytest.mark.parametrize("value", ["300", "-1", "nan", "1e300"])
def test_a_number_that_its_type_does_not_hold_is_refused(tmp_path: Path, value: str) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n"
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    text = header + faces + f"0 0 0 {value}\n1 0 0 1\n0 1 0 1\n3 0 1 2\n"
    with pytest.raises(MeshError, match=r"'red' is .*, must be 0 to 255"):
        _read(tmp_path, text.encode())


@pytest.mark.parametrize(
    ("rows", "message"), [("1 abc", "x has a value that is not a number"), ("many 1", "the length of 'x' is 'many', not a whole")]
)
def test_a_word_that_is_no_number_is_refused_in_one_line(rows: str, message: str) -> None:
    text = f"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar float x\nend_header\n{rows}\n"
    with pytest.raises(MeshError, match=message):
        read_ply_tables(Path("a.ply"), text.encode())


def test_an_empty_file_and_a_text_are_named(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="is empty: it has no vertices"):
        _read(tmp_path, ply(faces=[]).replace(b"element vertex 4", b"element vertex 0"))
    with pytest.raises(MeshError, match=r"it begins with 'hello', must begin with 'ply'"):
        _read(tmp_path, b"hello")
