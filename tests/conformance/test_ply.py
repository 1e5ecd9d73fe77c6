"""PLY: one test per rule of the format (http://paulbourke.net/dataformats/ply/), and of what programs write beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import LIGHT_GREY, Mesh, MeshPart
from support.gltf import png
from support.plys import ply
from support.triangles import CONCAVE_L, area, corners

FORMAT = "PLY"
VERTICES = ["0 0 0", "2 0 0", "2 2 0", "0 2 0"]
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACE = "property list uchar int vertex_indices\n"


def _text(
    vertices: list[str] = VERTICES,
    faces: tuple[str, ...] = ("4 0 1 2 3",),
    *,
    vertex: str = "",
    face: str = FACE,
    comments: str = "",
    elements: str = "",
    rows: str = "",
    format: str = "ascii",
) -> bytes:
    head = f"ply\nformat {format} 1.0\n{comments}element vertex {len(vertices)}\n{XYZ}{vertex}"
    head += f"element face {len(faces)}\n{face}" if faces else ""
    return (f"{head}{elements}end_header\n" + "\n".join([*vertices, *faces]) + f"\n{rows}").encode()


def _load(folder: Path, data: bytes) -> Mesh:
    (folder / "wood.png").write_bytes(png((5, 6, 7)))
    (folder / "a.ply").write_bytes(data)
    return load_mesh(folder / "a.ply", [folder])


def _part(folder: Path, data: bytes) -> MeshPart:
    mesh = _load(folder, data)
    assert mesh.warnings == ()
    (part,) = mesh.parts
    return part


def _warned(folder: Path, data: bytes, *words: str) -> MeshPart:
    mesh = _load(folder, data)
    assert any(all(word in warning for word in words) for warning in mesh.warnings), mesh.warnings
    assert not any("\n" in warning for warning in mesh.warnings)
    return mesh.parts[0]


# Header


@pytest.mark.parametrize("order", ["", "<", ">"])
@rule(FORMAT, "format ascii, binary_little_endian, binary_big_endian", "done")
def test_formats(tmp_path: Path, order: str) -> None:
    assert area(_part(tmp_path, ply(order=order))) == 1.0


@rule(FORMAT, "another format", "refused")
def test_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"format .* unknown; known: ascii") as caught:
        _load(tmp_path, _text(format="middle_endian"))
    assert "\n" not in str(caught.value)


@rule(FORMAT, "comment, obj_info", "done", "skipped; lines end with LF, CRLF or CR")
def test_comments_are_skipped(tmp_path: Path) -> None:
    data = _text(comments="comment made by hand\nobj_info scanned\ncomment before end_header there is more\n")
    for end in (b"\n", b"\r\n", b"\r"):
        assert area(_part(tmp_path, data.replace(b"\n", end))) == 4.0


@rule(FORMAT, "byte order mark", "done", "skipped")
def test_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    assert area(_part(tmp_path, b"\xef\xbb\xbf" + _text())) == 4.0


@rule(FORMAT, "format of another version than 1.0, elements twice, broken lines of elements", "refused")
def test_broken_headers_are_refused(tmp_path: Path) -> None:
    twice = _text(elements=f"element face 1\n{FACE}", rows="3 0 1 2\n")
    for data, words in (
        (_text().replace(b"ascii 1.0", b"ascii 2.0"), "has version '2.0' of PLY, must be 1.0"),
        (twice, "has element 'face' twice"),
        (_text().replace(b"element face 1", b"element face"), "'element face' must be"),
    ):
        with pytest.raises(MeshError, match=words):
            _load(tmp_path, data)


@pytest.mark.parametrize(
    "kind",
    [
        "char",
        "uchar",
        "short",
        "ushort",
        "int",
        "uint",
        "float",
        "double",
        "int8",
        "uint8",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "float32",
        "float64",
    ],
)
@rule(FORMAT, "char to double, int8 to float64", "done", "all types, by both names")
def test_types(tmp_path: Path, kind: str) -> None:
    assert area(_part(tmp_path, _text().replace(b"property float", f"property {kind}".encode()))) == 4.0


@rule(FORMAT, "unknown types", "refused")
def test_unknown_type_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="unknown type"):
        _load(tmp_path, _text().replace(b"property float x", b"property quad x"))


# Vertices


@rule(FORMAT, "vertex: x, y, z", "done", "in any order, with further properties between them")
def test_further_properties_of_vertices_are_skipped(tmp_path: Path) -> None:
    head = b"property float z\nproperty float quality\nproperty float y\nproperty float x\n"
    data = _text(["9 0.5 0 0", "9 0.5 0 2", "9 0.5 2 2"], ("3 0 1 2",)).replace(XYZ.encode(), head)
    assert corners(_part(tmp_path, data)) == [[[0, 0, 9], [2, 0, 9], [2, 2, 9]]]


@rule(FORMAT, "vertex: nx, ny, nz", "done", "normalised; smooth normals where they are missing")
def test_normals(tmp_path: Path) -> None:
    normals = "property float nx\nproperty float ny\nproperty float nz\n"
    part = _part(tmp_path, _text([f"{v} 0 6 8" for v in VERTICES], vertex=normals))
    np.testing.assert_allclose(part.normals, [[0, 0.6, 0.8]] * 4, atol=1e-6)
    np.testing.assert_allclose(_part(tmp_path, _text()).normals, [[0, 0, 1]] * 4, atol=1e-6)


@pytest.mark.parametrize("names", ["red green blue", "r g b", "diffuse_red diffuse_green diffuse_blue"])
@pytest.mark.parametrize(("kind", "values"), [("uchar", "255 51 0"), ("ushort", "65535 13107 0"), ("float", "1 0.2 0")])
@rule(
    FORMAT,
    "vertex: red, green, blue",
    "done",
    "also r, g, b and diffuse_red ...; 8 or 16 bits or 0 to 1; without light, as scans have it",
)
def test_colours_of_vertices(tmp_path: Path, names: str, kind: str, values: str) -> None:
    vertex = "".join(f"property {kind} {name}\n" for name in names.split())
    part = _part(tmp_path, _text([f"{v} {values}" for v in VERTICES], vertex=vertex))
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 51, 0]] * 4
    assert part.material.unlit


@rule(FORMAT, "vertex, face: alpha", "left out", "the surface is opaque")
def test_opacity_is_named(tmp_path: Path) -> None:
    vertex = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue", "alpha"))
    _warned(tmp_path, _text([f"{v} 1 2 3 128" for v in VERTICES], vertex=vertex), "opacity", "opaque")
    _part(tmp_path, _text([f"{v} 1 2 3 255" for v in VERTICES], vertex=vertex))


@pytest.mark.parametrize("names", ["s t", "u v", "texture_u texture_v"])
@rule(FORMAT, "vertex: s, t; comment TextureFile", "done", "also u, v and texture_u, texture_v; as MeshLab writes them")
def test_texture_of_vertices(tmp_path: Path, names: str) -> None:
    vertex = "".join(f"property float {name}\n" for name in names.split())
    part = _part(tmp_path, _text([f"{v} 0.25 0.75" for v in VERTICES], vertex=vertex, comments="comment TextureFile wood.png\n"))
    assert part.material.texture is not None
    assert part.uvs is not None
    assert part.uvs[0].tolist() == [0.25, 0.25]


@rule(FORMAT, "several comment TextureFile, face: texnumber", "approximated", "the first texture is used for all faces")
def test_several_textures_are_named(tmp_path: Path) -> None:
    vertex = "property float s\nproperty float t\n"
    comments = "comment TextureFile wood.png\ncomment TextureFile stone.png\n"
    part = _warned(tmp_path, _text([f"{v} 0 0" for v in VERTICES], vertex=vertex, comments=comments), "2 textures", "the first")
    assert part.material.texture is not None


# Faces


@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index"])
@rule(FORMAT, "face: vertex_indices, vertex_index", "done")
def test_names_of_the_list_of_corners(tmp_path: Path, name: str) -> None:
    assert area(_part(tmp_path, _text().replace(b"vertex_indices", name.encode()))) == 4.0


@pytest.mark.parametrize("order", ["", "<", ">"])
@rule(FORMAT, "concave polygons", "done", "cut by ear clipping in their best plane")
def test_concave_polygon_keeps_its_shape(tmp_path: Path, order: str) -> None:
    points = [(x, y, 0.0) for x, y in CONCAVE_L]
    part = _part(tmp_path, ply(points, [[0, 1, 2, 3, 4, 5], [0, 1, 5]], None, order=order))
    # The L and the triangle (2, 0), (2, 1), (0, 0).
    assert area(part) == pytest.approx(3.0 + 1.0)
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * 6, atol=1e-6)


@rule(FORMAT, "face: red, green, blue", "done", "where the vertices have no colours")
def test_colours_of_faces(tmp_path: Path) -> None:
    face = FACE + "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    part = _part(tmp_path, _text(faces=("3 0 1 2 255 0 0", "3 0 2 3 0 0 255"), face=face))
    assert part.colors is not None
    assert part.colors[part.triangles].tolist() == [[[255, 0, 0]] * 3, [[0, 0, 255]] * 3]
    assert part.material.unlit
    vertex = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    both = _text([f"{v} 1 2 3" for v in VERTICES], ("3 0 1 2 255 0 0",), vertex=vertex, face=face)
    assert _warned(tmp_path, both, "colours of its faces").colors is not None


@rule(FORMAT, "face: texcoord", "done", "texture coordinates of each corner, as MeshLab writes them")
def test_texture_coordinates_of_corners(tmp_path: Path) -> None:
    face = FACE + "property list uchar float texcoord\n"
    faces = ("3 0 1 2 6 0 0 1 0 1 1", "3 0 2 3 6 0.5 0.5 1 1 0 1")
    part = _part(tmp_path, _text(faces=faces, face=face, comments="comment TextureFile wood.png\n"))
    assert part.uvs is not None
    assert part.uvs[part.triangles].tolist() == [[[0, 1], [1, 1], [1, 0]], [[0.5, 0.5], [1, 0], [0, 0]]]


@rule(FORMAT, "tristrips", "done", "-1 ends a strip; each second triangle is turned")
def test_triangle_strips(tmp_path: Path) -> None:
    elements = "element tristrips 2\nproperty list int int vertex_indices\n"
    part = _part(tmp_path, _text(faces=(), elements=elements, rows="8 0 1 3 2 -1 0 1 2\n3 0 2 3\n"))
    assert corners(part) == [
        [[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[2, 0, 0], [2, 2, 0], [0, 2, 0]],
        [[0, 0, 0], [2, 0, 0], [2, 2, 0]], [[0, 0, 0], [2, 2, 0], [0, 2, 0]],
    ]  # fmt: skip


@rule(FORMAT, "edge, material, multi_texture_vertex, elements of other programs", "left out", "each is named")
def test_other_elements_are_named(tmp_path: Path) -> None:
    for name in ("edge", "material", "fancy"):
        data = _text(elements=f"element {name} 1\nproperty int a\nproperty int b\n", rows="0 1\n")
        assert area(_warned(tmp_path, data, f"element '{name}' is left out")) == 4.0


@rule(FORMAT, "no colours, no texture", "done", "light grey")
def test_plain_surface_is_light_grey(tmp_path: Path) -> None:
    assert _part(tmp_path, _text()).material.base_color == LIGHT_GREY


@rule(FORMAT, "point clouds", "refused", "the message names programs that make a mesh of them")
def test_point_cloud_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="point cloud") as caught:
        _load(tmp_path, _text(faces=()))
    assert "\n" not in str(caught.value)


@rule(FORMAT, "indices out of range, cut files", "refused")
def test_broken_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="names vertex 9, but there are 4"):
        _load(tmp_path, _text(faces=("3 0 1 9",)))
    with pytest.raises(MeshError, match="cut"):
        _load(tmp_path, _text()[:-6])


@rule(FORMAT, "indices that are no whole numbers", "refused")
def test_fractions_of_indices_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"is 2\.7, must be a whole number"):
        _load(tmp_path, _text(faces=("3 0 1 2.7",)))
    as_floats = FACE.replace("int", "float")
    with pytest.raises(MeshError, match=r"is 2\.7, must be a whole number"):
        _load(tmp_path, _text(faces=("3 0 1 2.7",), face=as_floats))
    assert area(_part(tmp_path, _text(faces=("3 0 1 2.0",), face=as_floats))) == 2.0


@pytest.mark.parametrize("kind", ["float", "double", "short", "ushort", "int"])
@rule(FORMAT, "red, green, blue of 0 to 255 in wider types", "done", "floats above 1, and whole numbers up to 255")
def test_colours_of_0_to_255_in_wider_types(tmp_path: Path, kind: str) -> None:
    vertex = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue", "alpha"))
    part = _part(tmp_path, _text([f"{v} 255 128 0 255" for v in VERTICES], vertex=vertex))
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 128, 0]] * 4


@rule(FORMAT, "colours beside a texture", "left out", "the texture is drawn")
def test_colours_beside_a_texture_are_named(tmp_path: Path) -> None:
    vertex = "property float s\nproperty float t\n" + "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    data = _text([f"{v} 0 0 1 2 3" for v in VERTICES], vertex=vertex, comments="comment TextureFile wood.png\n")
    part = _warned(tmp_path, data, "colours are left out", "texture is drawn")
    assert part.material.texture is not None


@rule(FORMAT, "colours as fractions above 1", "done", "up to 2 they are fractions, clipped to 1; above, white is 255")
def test_fractions_may_exceed_white(tmp_path: Path) -> None:
    vertex = "".join(f"property float {name}\n" for name in ("red", "green", "blue"))
    part = _load(tmp_path, _text([f"{v} 1.02 0.2 0" for v in VERTICES], vertex=vertex)).parts[0]
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 51, 0]] * 4
