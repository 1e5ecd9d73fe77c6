"""Wavefront OBJ and MTL: one test per rule of the specification, and of what programs write beside it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import LIGHT_GREY, Mesh, MeshPart
from support.gltf import png
from support.triangles import CONCAVE_L, area, corners

FORMAT = "OBJ/MTL"
SQUARE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
L = "".join(f"v {x} {y} 0\n" for x, y in CONCAVE_L)


def _load(folder: Path, text: str, mtl: str = "", images: tuple[str, ...] = ("wood.png",)) -> Mesh:
    for name in images:
        (folder / name).write_bytes(png((5, 6, 7)))
    (folder / "a.mtl").write_text(mtl)
    (folder / "a.obj").write_text(f"mtllib a.mtl\n{text}" if mtl else text)
    return load_mesh(folder / "a.obj", [folder])


def _part(folder: Path, text: str, mtl: str = "", images: tuple[str, ...] = ("wood.png",)) -> MeshPart:
    mesh = _load(folder, text, mtl, images)
    assert mesh.warnings == ()
    (part,) = mesh.parts
    return part


def _warned(folder: Path, text: str, *words: str, mtl: str = "") -> MeshPart:
    mesh = _load(folder, text, mtl)
    assert any(all(word in warning for word in words) for warning in mesh.warnings), mesh.warnings
    assert not any("\n" in warning for warning in mesh.warnings)
    return mesh.parts[0]


def _material(folder: Path, mtl: str) -> MeshPart:
    return _part(folder, f"{SQUARE}{UVS}usemtl m\nf 1/1 2/2 3/3 4/4\n", f"newmtl m\n{mtl}\n")


# Lines


@rule(FORMAT, "#", "done")
def test_comments_are_skipped(tmp_path: Path) -> None:
    assert area(_part(tmp_path, f"# made by hand\n{SQUARE}f 1 2 3 4 # the floor\n")) == 4.0


@rule(FORMAT, "line continuation (\\)", "done")
def test_lines_may_be_continued(tmp_path: Path) -> None:
    assert area(_part(tmp_path, f"{SQUARE}f 1 2 \\\n 3 4\n")) == 4.0


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@rule(FORMAT, "white space", "done", "tabs and spaces between words; LF, CRLF or CR after lines")
def test_words_may_be_separated_by_tabs(tmp_path: Path, end: str) -> None:
    text = f"{SQUARE}f 1 2 3 4\n".replace(" ", "\t").replace("v\t0", "v \t  0").replace("\n", end)
    assert area(_part(tmp_path, text)) == 4.0


# Geometry


@rule(FORMAT, "v x y z [w]", "done", "the weight has no meaning for polygons")
def test_vertices(tmp_path: Path) -> None:
    assert corners(_part(tmp_path, "v 1 2 3 1.0\nv 4 5 6\nv 7 8 -9e0\nf 1 2 3\n")) == [[[1, 2, 3], [4, 5, 6], [7, 8, -9]]]


@rule(FORMAT, "v x y z r g b", "done", "colours of vertices, 0 to 1 or 0 to 255, as scanners write them; without light")
def test_colours_of_vertices(tmp_path: Path) -> None:
    part = _part(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0.2\nf 1 2 3\n")
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 0, 0], [0, 255, 0], [0, 0, 51]]
    assert part.material.unlit


@rule(FORMAT, "vt u [v [w]]", "done", "v is 0 where it is missing")
def test_texture_coordinates(tmp_path: Path) -> None:
    part = _part(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5\nvt 0.25 0.75\nvt 1 1 0\nf 1/1 2/2 3/3\n")
    assert part.uvs is not None
    # v is counted downwards here.
    assert part.uvs[part.triangles[0]].tolist() == [[0.5, 1.0], [0.25, 0.25], [1.0, 0.0]]


@rule(FORMAT, "vn x y z", "done", "normalised")
def test_normals(tmp_path: Path) -> None:
    part = _part(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 6 8\nf 1//1 2//1 3//1\n")
    np.testing.assert_allclose(part.normals, [[0, 0.6, 0.8]] * 3, atol=1e-6)


@rule(FORMAT, "faces without vn", "done", "smooth normals, weighted by area")
def test_missing_normals_are_smooth(tmp_path: Path) -> None:
    part = _part(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\n")
    edge = part.normals[(part.vertices == [1, 0, 0]).all(axis=1)]
    np.testing.assert_allclose(edge, [[0, np.sqrt(0.5), np.sqrt(0.5)]], atol=1e-6)


@pytest.mark.parametrize("face", ["1 2 3 4", "1/1 2/2 3/3 4/4", "1//1 2//1 3//1 4//1", "1/1/1 2/2/1 3/3/1 4/4/1"])
@rule(FORMAT, "f v, v/vt, v//vn, v/vt/vn", "done")
def test_forms_of_corners(tmp_path: Path, face: str) -> None:
    assert area(_part(tmp_path, f"{SQUARE}{UVS}vn 0 0 1\nf {face}\n")) == 4.0


@pytest.mark.parametrize("face", ["1/1 2 3 4", "1 2//1 3/3/1 4/4", "1/1/ 2/2/ 3/3/ 4/4/"])
@rule(FORMAT, "f with corners of different forms", "done", "programs write them; what a corner lacks is computed")
def test_corners_of_one_face_may_differ_in_form(tmp_path: Path, face: str) -> None:
    part = _part(tmp_path, f"{SQUARE}{UVS}vn 0 0 1\nf {face}\n")
    assert area(part) == 4.0
    np.testing.assert_allclose(part.normals, [[0, 0, 1]] * len(part.normals))


@rule(FORMAT, "negative indices", "done", "count back from the line of the face")
def test_negative_indices(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    assert [triangle[0] for triangle in corners(_part(tmp_path, text))] == [[0, 0, 0], [5, 0, 0]]


@rule(FORMAT, "convex polygons", "done", "a fan around the first corner")
def test_convex_polygon_is_a_fan(tmp_path: Path) -> None:
    assert corners(_part(tmp_path, f"{SQUARE}f 2 3 4 1\n")) == [
        [[2, 0, 0], [2, 2, 0], [0, 2, 0]],
        [[2, 0, 0], [0, 2, 0], [0, 0, 0]],
    ]


@pytest.mark.parametrize("axes", ["xyz", "zxy", "yzx"])
@pytest.mark.parametrize("flipped", [False, True])
@rule(FORMAT, "concave polygons", "done", "cut by ear clipping in their best plane")
def test_concave_polygon_keeps_its_shape_and_side(tmp_path: Path, axes: str, flipped: bool) -> None:
    points = [dict(zip(axes, (x, y, 0.25), strict=True)) for x, y in CONCAVE_L]
    text = "".join(f"v {p['x']} {p['y']} {p['z']}\n" for p in points)
    part = _part(tmp_path, text + ("f 6 5 4 3 2 1\n" if flipped else "f 1 2 3 4 5 6\n"))
    assert area(part) == pytest.approx(3.0)
    assert len(part.triangles) == 4
    # The axes are permuted cyclically, which keeps the orientation.
    up = [(-1.0 if flipped else 1.0) * (axis == axes[2]) for axis in "xyz"]
    np.testing.assert_allclose(part.normals, [up] * 6, atol=1e-6)


@rule(FORMAT, "vertices, texture coordinates or normals out of range", "refused")
def test_index_out_of_range_is_refused_in_one_line(tmp_path: Path) -> None:
    for face, what in (
        ("1 2 5", "vertex 5, but there are 4"), ("1 2 0", "vertex 0"), ("1 2 -5", "vertex -5"),
        ("1/1 2/1 3/7", "texture coordinate 7, but there are 1"), ("1//1 2//1 3//2", "normal 2, but there are 1"),
    ):  # fmt: skip
        with pytest.raises(MeshError, match=what) as caught:
            _load(tmp_path, f"{SQUARE}vt 0 0\nvn 0 0 1\nf {face}\n")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("line", ["p 1 2", "l 1 2 3"])
@rule(FORMAT, "p, l", "left out", "points and lines have no surface")
def test_points_and_lines_are_named(tmp_path: Path, line: str) -> None:
    _warned(tmp_path, f"{SQUARE}f 1 2 3 4\n{line}\n", f"1 line(s) '{line[0]}' are left out", "no surface")


@pytest.mark.parametrize("line", ["curv 0 1 1 2 3", "surf 0 1 0 1 1 2 3", "cstype bezier", "deg 3 3", "vp 0 1"])
@rule(
    FORMAT,
    "vp, cstype, deg, curv, curv2, surf, parm, trim, hole, scrv, sp, end, con",
    "left out",
    "free-form curves and surfaces",
)
def test_free_form_surfaces_are_named(tmp_path: Path, line: str) -> None:
    _warned(tmp_path, f"{SQUARE}f 1 2 3 4\n{line}\n", f"'{line.split()[0]}'", "free-form", "export polygons")


@rule(FORMAT, "g, o, s, mg, lod, bevel, c_interp, d_interp", "done", "names and hints: they change no triangle")
def test_groups_change_nothing(tmp_path: Path) -> None:
    text = f"{SQUARE}o floor\ng a b\ns off\nmg 1 2\nlod 3\nbevel on\nc_interp on\nd_interp off\nf 1 2 3 4\n"
    assert area(_part(tmp_path, text)) == 4.0


@pytest.mark.parametrize("line", ["usemap wood", "maplib a.map"])
@rule(FORMAT, "usemap, maplib", "left out", "surfaces keep the textures of their materials")
def test_map_libraries_are_named(tmp_path: Path, line: str) -> None:
    _warned(tmp_path, f"{SQUARE}{line}\nf 1 2 3 4\n", "left out", "textures of their materials")


# Materials


@rule(FORMAT, "mtllib, usemtl, newmtl", "done", "names may have spaces; faces before the first usemtl are light grey")
def test_materials(tmp_path: Path) -> None:
    mesh = _load(tmp_path, f"{SQUARE}f 1 2 3\nusemtl my red\nf 1 3 4\n", "newmtl my red\nKd 1 0 0\n")
    assert [part.material.base_color for part in mesh.parts] == [LIGHT_GREY, (1, 0, 0, 1)]


@rule(FORMAT, "several mtllib", "done", "on one line or on several")
def test_several_libraries(tmp_path: Path) -> None:
    (tmp_path / "b.mtl").write_text("newmtl b\nKd 0 1 0\n")
    (tmp_path / "c.mtl").write_text("newmtl c\nKd 0 0 1\n")
    (tmp_path / "a.obj").write_text(f"mtllib b.mtl c.mtl\n{SQUARE}usemtl b\nf 1 2 3\nusemtl c\nf 1 3 4\n")
    mesh = load_mesh(tmp_path / "a.obj", [tmp_path])
    assert [part.material.base_color for part in mesh.parts] == [(0, 1, 0, 1), (0, 0, 1, 1)]


@rule(FORMAT, "missing mtllib or material", "left out", "the surface is light grey")
def test_missing_materials_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(f"mtllib gone.mtl\n{SQUARE}usemtl m\nf 1 2 3\n")
    mesh = load_mesh(tmp_path / "a.obj", [tmp_path])
    assert mesh.parts[0].material.base_color == LIGHT_GREY
    assert ["gone.mtl" in mesh.warnings[0], "'m'" in mesh.warnings[1]] == [True, True]


@pytest.mark.parametrize("separator", [" ", "\t", "   "])
@rule(FORMAT, "Kd r g b", "done")
def test_diffuse_colour(tmp_path: Path, separator: str) -> None:
    assert _material(tmp_path, f"\tKd{separator}1{separator}0.5{separator}0").material.base_color == (1, 0.5, 0, 1)


@rule(FORMAT, "Kd spectral, Kd xyz", "left out", "the surface is light grey")
def test_spectral_colours_are_named(tmp_path: Path) -> None:
    part = _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", "spectral", mtl="newmtl m\nKd spectral a.rfl 1\n")
    assert part.material.base_color == LIGHT_GREY


@rule(FORMAT, "d", "done", "1 = opaque")
def test_opacity(tmp_path: Path) -> None:
    part = _material(tmp_path, "Kd 1 0 0\nd 0.25")
    assert part.material.alpha_mode == "blend"
    assert part.material.base_color == (1, 0, 0, 0.25)


@rule(FORMAT, "d -halo", "approximated", "the opacity is that of all directions")
def test_halo_is_read_as_opacity(tmp_path: Path) -> None:
    part = _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", "-halo", mtl="newmtl m\nKd 1 0 0\nd -halo 0.25\n")
    assert part.material.base_color[3] == 0.25


@rule(FORMAT, "Tr without d", "left out", "programs disagree on its meaning; the surface is opaque")
def test_tr_alone_is_named(tmp_path: Path) -> None:
    mtl = "newmtl m\nKd 1 0 0\nTr {}\n"
    part = _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", "Tr", "opaque", mtl=mtl.format(0.5))
    assert part.material.base_color[3] == 1.0
    for value in (0, 1):
        assert _part(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", mtl.format(value)).material.base_color[3] == 1.0


@rule(FORMAT, "Ke", "done")
def test_emission(tmp_path: Path) -> None:
    assert _material(tmp_path, "Kd 0 0 0\nKe 0.1 0.2 0.3").material.emissive == (0.1, 0.2, 0.3)


@rule(FORMAT, "Pr, Pm", "done", "roughness and metalness of the PBR extension")
def test_roughness_and_metalness(tmp_path: Path) -> None:
    material = _material(tmp_path, "Kd 1 1 1\nPr 0.25\nPm 0.5").material
    assert (material.roughness, material.metallic) == (0.25, 0.5)


@rule(FORMAT, "map_Kd", "done", "replaces Kd, as most programs do; names may have spaces")
def test_texture(tmp_path: Path) -> None:
    (tmp_path / "my wood.png").write_bytes(png((1, 2, 3)))
    material = _material(tmp_path, "Kd 0.5 0.5 0.5\nmap_Kd my wood.png").material
    assert material.texture is not None
    assert material.texture.pixels.tolist() == [[[1, 2, 3]]]
    assert material.base_color == (1, 1, 1, 1)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("-s 2 3 1 ", (2.0, 1.0 - 3.0)), ("-s 2 ", (2.0, 0.0)), ("-o 0.25 0.5 ", (1.25, -0.5)), ("-o 0.25 -s 2 2 2 ", (2.25, -1.0)),
        ("-blendu on -texres 512 ", (1.0, 0.0)),
    ],
)  # fmt: skip
@rule(FORMAT, "map_Kd -s, -o", "done", "scale and offset of the texture coordinates: uv * s + o")
def test_scale_and_offset_of_a_texture(tmp_path: Path, options: str, expected: tuple[float, float]) -> None:
    part = _material(tmp_path, f"map_Kd {options}wood.png")
    assert part.material.texture is not None
    assert part.uvs is not None
    # Corner 3 has the texture coordinates (1, 1), counted upwards; v is counted downwards here.
    np.testing.assert_allclose(part.uvs[part.triangles[0, 2]], expected)


@rule(FORMAT, "map_Kd -clamp", "done", "off, the default, repeats the image")
def test_clamped_texture(tmp_path: Path) -> None:
    for options, wrap in (("-clamp on ", "clamp"), ("-clamp off ", "repeat"), ("", "repeat")):
        texture = _material(tmp_path, f"map_Kd {options}wood.png").material.texture
        assert texture is not None
        assert (texture.sampling.wrap_u, texture.sampling.wrap_v) == (wrap, wrap)


@pytest.mark.parametrize("option", ["-bm 0.5", "-boost 2", "-cc on", "-imfchan l", "-mm 0 2", "-t 1 1 1", "-type sphere"])
@rule(FORMAT, "map_Kd -bm, -boost, -cc, -imfchan, -mm, -t, -type", "left out", "the image is drawn as it is")
def test_other_options_of_a_texture_are_named(tmp_path: Path, option: str) -> None:
    text, mtl = f"{SQUARE}{UVS}usemtl m\nf 1/1 2/2 3/3\n", f"newmtl m\nmap_Kd {option} wood.png\n"
    part = _warned(tmp_path, text, f"option {option.split()[0]} of map_Kd is left out", mtl=mtl)
    assert part.material.texture is not None


@rule(FORMAT, "map_d", "approximated", "the alpha channel of map_Kd, as a mask, stands for it")
def test_map_of_opacity_is_named(tmp_path: Path) -> None:
    _warned(
        tmp_path, f"{SQUARE}{UVS}usemtl m\nf 1/1 2/2 3/3\n", "map_d is left out", mtl="newmtl m\nmap_Kd wood.png\nmap_d d.png\n"
    )
    (tmp_path / "wood.png").write_bytes(cv2.imencode(".png", np.full((1, 1, 4), 100, np.uint8))[1].tobytes())
    text, mtl = f"{SQUARE}{UVS}usemtl m\nf 1/1 2/2 3/3\n", "newmtl m\nmap_Kd wood.png\nmap_d wood.png\n"
    assert _part(tmp_path, text, mtl, images=()).material.alpha_mode == "mask"


@pytest.mark.parametrize(
    "line",
    ["map_Ks k.png", "map_Ns k.png", "map_Ke k.png", "map_bump k.png", "bump k.png", "norm k.png", "disp k.png", "decal k.png",
     "refl -type sphere k.png", "map_Pr k.png", "map_Pm k.png", "Pc 0.5", "Pcr 0.5", "Ps 0.5"],
)  # fmt: skip
@rule(
    FORMAT,
    "map_Ks, map_Ns, map_Ke, map_bump, bump, norm, disp, decal, refl, map_Pr, map_Pm, Pc, Pcr, Ps",
    "left out",
    "the surface is even and smooth",
)
def test_other_maps_are_named(tmp_path: Path, line: str) -> None:
    mtl = f"newmtl m\nKd 1 0 0\n{line}\n"
    _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", f"{line.split()[0].lower()} is left out", mtl=mtl)


@rule(FORMAT, "Ka, Ks, Ns, Ni, Tf, illum, sharpness, map_Ka, map_aat, aniso, anisor", "done", "no effect: surfaces are matte")
def test_terms_of_the_phong_model_have_no_effect(tmp_path: Path) -> None:
    lines = "Ka 0.2 0.2 0.2\nKs 0.5 0.5 0.5\nNs 100\nNi 1.45\nTf 1 1 1\nillum 2\nsharpness 60\nmap_Ka wood.png\nmap_aat on\naniso 0\nanisor 0"
    assert _material(tmp_path, f"Kd 1 0 0\n{lines}").material.base_color == (1, 0, 0, 1)


@rule(FORMAT, "other lines of a material", "left out", "each is named")
def test_unknown_lines_of_a_material_are_named(tmp_path: Path) -> None:
    _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", "'fancy' is unknown", mtl="newmtl m\nKd 1 0 0\nfancy 3\n")


# What programs write beside it


@rule(FORMAT, "byte order mark", "done", "skipped, in OBJ and MTL")
def test_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("\ufeffnewmtl m\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text("\ufeffv 0 0 0\nv 2 0 0\nv 2 2 0\nmtllib a.mtl\nusemtl m\nf 1 2 3\n")
    mesh = load_mesh(tmp_path / "a.obj", [tmp_path])
    assert mesh.warnings == ()
    assert area(mesh.parts[0]) == 2.0
    assert mesh.parts[0].material.base_color == (1, 0, 0, 1)


@rule(FORMAT, "# after white space", "done", "a comment; names with one, such as Material #25, are searched first")
def test_comments_at_the_end_of_lines(tmp_path: Path) -> None:
    text = "v 0 0 0 # a\nv 2 0 0 #b\nv 2 2 0\t# c\nvt 0 0 # d\nvn 0 0 1 # e\nusemtl m # f\nf 1/1/1 2/1/1 3/1/1 # g\n"
    part = _part(tmp_path, text, "newmtl m # red\nKd 1 0 0 # red\nd 1 # opaque\nKe 0 0 0 # dark\n")
    assert part.material.base_color == (1.0, 0.0, 0.0, 1.0)
    assert _material(tmp_path, "map_Kd wood.png # brown").material.texture is not None
    numbered = "newmtl Material #25\nKd 1 0 0\nnewmtl Material #26\nKd 0 1 0\n"
    mesh = _load(tmp_path, f"{SQUARE}usemtl Material #25\nf 1 2 3\nusemtl Material #26\nf 1 3 4\n", numbered)
    assert [part.material.base_color for part in mesh.parts] == [(1, 0, 0, 1), (0, 1, 0, 1)]
    assert mesh.warnings == ()


@rule(FORMAT, "Kd r, Ke r", "done", "g and b are r where they are missing")
def test_colour_of_one_number(tmp_path: Path) -> None:
    material = _material(tmp_path, "Kd 0.5\nKe 0.25").material
    assert (material.base_color, material.emissive) == ((0.5, 0.5, 0.5, 1), (0.25, 0.25, 0.25))


@pytest.mark.parametrize("color", ["xyz .2 .3 .4", "1 0", "1 0 nan", "1 0 0 1"])
@rule(FORMAT, "Kd xyz, Kd of other forms", "left out", "the surface is light grey")
def test_colours_of_other_forms_are_named(tmp_path: Path, color: str) -> None:
    part = _warned(tmp_path, f"{SQUARE}usemtl m\nf 1 2 3\n", f"kd '{color}' is left out", mtl=f"newmtl m\nKd {color}\n")
    assert part.material.base_color == LIGHT_GREY


@rule(FORMAT, "Ke above 1", "done", "emitted light may exceed 1")
def test_strong_emission(tmp_path: Path) -> None:
    assert _material(tmp_path, "Kd 0 0 0\nKe 5 0.5 -1").material.emissive == (5, 0.5, 0)


@rule(FORMAT, "line continuation, tabs in MTL", "done")
def test_continuation_and_tabs_in_materials(tmp_path: Path) -> None:
    assert _material(tmp_path, "Kd 1 \\\n 0.5 0").material.base_color == (1, 0.5, 0, 1)
    for line in ("map_Kd -s 2 2 1\twood.png", "map_Kd -clamp\ton\twood.png", "map_Kd\t-s\t2  wood.png"):
        assert _material(tmp_path, line).material.texture is not None


@rule(FORMAT, "colours of some vertices", "approximated", "the others are white")
def test_colours_of_some_vertices(tmp_path: Path) -> None:
    part = _warned(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 0 0 0.2\nf 1 2 3\n", "1 of 3 vertices have no colour")
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 0, 0], [255, 255, 255], [0, 0, 51]]


@rule(FORMAT, "f of fewer than three corners", "left out", "it has no surface")
def test_faces_of_two_corners_are_named(tmp_path: Path) -> None:
    assert (
        area(_warned(tmp_path, f"{SQUARE}f 1 2 3 4\nf 1 2\nf 1/1 3\n".replace("f 1/1 3", "f 3"), "2 face(s)", "no surface"))
        == 4.0
    )


@rule(FORMAT, "v x y z r g b above 1", "done", "up to 2 they are fractions, clipped to 1; above, white is 255")
def test_fractions_may_exceed_white(tmp_path: Path) -> None:
    part = _part(tmp_path, "v 0 0 0 1.02 0 0\nv 1 0 0 0 0.2 0\nv 0 1 0 0 0 1\nf 1 2 3\n")
    assert part.colors is not None
    assert part.colors.tolist() == [[255, 0, 0], [0, 51, 0], [0, 0, 255]]
