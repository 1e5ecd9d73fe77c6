"""STL: one test per rule of the format (https://www.fabbers.com/tech/STL_Format), and of what programs write beside it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import LIGHT_GREY, Mesh, MeshPart
from support.triangles import corners

FORMAT = "STL"
TRIANGLE = [[0.0, 0.0, 0.5], [2.0, 0.0, 0.5], [0.0, 2.0, 0.5]]
FACET = "facet normal 0 0 1\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in TRIANGLE) + "endloop\nendfacet\n"


def _binary(
    *, header: bytes = b"", count: int = 1, attribute: int = 0, normal: tuple[float, ...] = (0, 0, 1), rest: bytes = b""
) -> bytes:
    facet = struct.pack("<12fH", *normal, *(value for corner in TRIANGLE for value in corner), attribute)
    return header.ljust(80, b"\0") + struct.pack("<I", count) + facet * count + rest


def _load(folder: Path, data: bytes) -> Mesh:
    (folder / "a.stl").write_bytes(data)
    return load_mesh(folder / "a.stl", [folder])


def _part(folder: Path, data: bytes) -> MeshPart:
    mesh = _load(folder, data)
    assert mesh.warnings == ()
    (part,) = mesh.parts
    return part


@pytest.mark.parametrize("header", [b"", b"solid binary all the same"])
@rule(FORMAT, "binary", "done", "also where the header begins with 'solid'")
def test_binary(tmp_path: Path, header: bytes) -> None:
    part = _part(tmp_path, _binary(header=header))
    assert corners(part) == [TRIANGLE]
    assert part.material.base_color == LIGHT_GREY


@pytest.mark.parametrize("change", [str, str.upper, lambda text: text.replace("\n", "\r\n\t")])
@rule(FORMAT, "ASCII", "done", "any white space, lower or upper case, with or without a name")
def test_ascii(tmp_path: Path, change: object) -> None:
    assert callable(change)
    for name in ("", " a part"):
        assert corners(_part(tmp_path, change(f"solid{name}\n{FACET}endsolid{name}\n").encode())) == [TRIANGLE]


@rule(FORMAT, "ASCII, several solid", "done", "all are read, as one part")
def test_several_solids(tmp_path: Path) -> None:
    data = f"solid a\n{FACET}endsolid a\nsolid b\n{FACET}endsolid b\n".encode()
    assert corners(_part(tmp_path, data)) == [TRIANGLE, TRIANGLE]


@pytest.mark.parametrize("normal", [(0, 0, 0), (0, 0, -1), (1, 0, 0)])
@rule(FORMAT, "facet normal", "done", "computed by the right-hand rule, which it has to obey")
def test_normals_follow_the_order_of_corners(tmp_path: Path, normal: tuple[float, ...]) -> None:
    np.testing.assert_allclose(_part(tmp_path, _binary(normal=normal)).normals, [[0, 0, 1]] * 3)


@pytest.mark.parametrize("options", [{"attribute": 0x801F}, {"header": b"COLOR=\xff\0\0\xff"}])
@rule(FORMAT, "binary: attributes as colours, COLOR= in the header", "left out", "the surface is light grey")
def test_colours_are_named(tmp_path: Path, options: dict[str, object]) -> None:
    (warning,) = _load(tmp_path, _binary(**options)).warnings  # type: ignore[arg-type]
    assert "colours of its triangles are left out" in warning


@rule(FORMAT, "binary: other attributes", "done", "no colours without the highest bit; their meaning is their program's")
def test_attribute_bytes_without_the_colour_bit_are_ignored(tmp_path: Path) -> None:
    assert corners(_part(tmp_path, _binary(attribute=0x5EF7))) == [TRIANGLE]


@rule(FORMAT, "binary: bytes after the last triangle", "left out", "the number in the header counts")
def test_bytes_at_the_end_are_named(tmp_path: Path) -> None:
    mesh = _load(tmp_path, _binary(rest=b"made by"))
    assert corners(mesh.parts[0]) == [TRIANGLE]
    assert "7 bytes after its 1 triangles" in mesh.warnings[0]


@rule(FORMAT, "cut files, facets of other than three corners", "refused")
def test_broken_files_are_refused_in_one_line(tmp_path: Path) -> None:
    quad = FACET.replace("endloop", "vertex 2 2 0.5\nendloop")
    for data, word in (
        (_binary(count=3)[:-50], "cut"),
        (f"solid\n{FACET}{FACET[:-30]}".encode(), "cut"),
        (f"solid\n{quad}endsolid\n".encode(), "4 corners"),
        (f"solid\n{FACET.replace('2.0', 'two', 1)}endsolid\n".encode(), "broken"),
        (b"hello", "not an STL"),
    ):
        with pytest.raises(MeshError, match=word) as caught:
            _load(tmp_path, data)
        assert "\n" not in str(caught.value)


@rule(FORMAT, "no triangles", "refused")
def test_empty_file_is_refused(tmp_path: Path) -> None:
    for data in (_binary(count=0), b"solid a\nendsolid a\n"):
        with pytest.raises(MeshError, match="no triangles"):
            _load(tmp_path, data)


@rule(FORMAT, "ASCII without endsolid", "refused", "it is cut, wherever that happened")
def test_cut_text_is_refused(tmp_path: Path) -> None:
    whole = f"solid a\n{FACET}"
    for text in (whole, f"{whole}{FACET[:25]}", f"{whole}endsolid a\n{whole}", whole[: whole.index("facet")]):
        with pytest.raises(MeshError, match="cut"):
            _load(tmp_path, text.encode())
    for text in (f"{whole}facet normal 0 0 1\nendfacet\nendsolid\n", f"{whole}{FACET[:-20]}\nendsolid\n"):
        with pytest.raises(MeshError, match="in 2 facets"):
            _load(tmp_path, text.encode())


@rule(FORMAT, "binary: header begins with 'solid', bytes after the last triangle", "done", "binary, if no text has a facet")
def test_binary_that_begins_with_solid(tmp_path: Path) -> None:
    mesh = _load(tmp_path, _binary(header=b"solid part", rest=b"made by"))
    assert corners(mesh.parts[0]) == [TRIANGLE]
    assert "7 bytes after its 1 triangles" in mesh.warnings[0]
    with pytest.raises(MeshError, match="an STL of 3 triangles has 234 bytes, this file has 184; it is cut"):
        _load(tmp_path, _binary(header=b"solid part", count=3)[:-50])


@pytest.mark.parametrize("name", ["vertex 1 2 3", "facet", "outer loop", "my solid", "endsolid", "_part"])
@rule(FORMAT, "ASCII: name of a solid", "done", "any text to the end of the line; a byte order mark is skipped")
def test_keywords_in_the_name_of_a_solid_are_not_read_as_geometry(tmp_path: Path, name: str) -> None:
    data = f"\ufeffsolid {name}\n{FACET}endsolid {name}\n"
    assert corners(_part(tmp_path, data.encode())) == [TRIANGLE]
    # White space of any kind separates words, so that a file may be one line.
    assert corners(_part(tmp_path, f"solid a\n{FACET}endsolid a\n".replace("\n", " ").encode())) == [TRIANGLE]
    assert corners(_part(tmp_path, f"solid{name}\n{FACET}endsolid{name}\n".encode())) == [TRIANGLE]
