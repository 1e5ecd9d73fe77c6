"""COLLADA 1.4.1 and 1.5.0: one test per rule of the specification."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import Mesh, MeshPart
from support.gltf import png
from support.triangles import corners

FORMAT = "COLLADA"
V = '<input semantic="VERTEX" source="#v" offset="0"/>'
TRIANGLE = f'<triangles count="1" material="s">{V}<p>0 1 2</p></triangles>'
POINTS = "0 0 0 4 0 0 4 4 0 0 4 0 1 1 0 3 1 0 3 3 0 1 3 0"
"""A square of side 4, counter-clockwise, then a square of side 2 in its middle."""
BIND = '<instance_material symbol="s" target="#m">{}</instance_material>'
PLACE = '<instance_geometry url="#g"><bind_material><technique_common>{}</technique_common></bind_material></instance_geometry>'
RED = "<diffuse><color>1 0 0 1</color></diffuse>"
TEXTURED = '<diffuse><texture texture="sampler" texcoord="UV"/></diffuse>'
SURFACE = '<newparam sid="surface"><surface type="2D"><init_from>i</init_from></surface></newparam>'
SAMPLER = f'{SURFACE}<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>'
NAMESPACE = ' xmlns="http://www.collada.org/2005/11/COLLADASchema"'


def _source(name: str, values: str, stride: int, params: str = "") -> str:
    count = len(values.split())
    return (
        f'<source id="{name}"><float_array id="{name}a" count="{count}">{values}</float_array><technique_common>'
        f'<accessor source="#{name}a" count="{count // stride}" stride="{stride}">{params}</accessor></technique_common></source>'
    )


def _text(
    *,
    mesh: str = TRIANGLE,
    sources: str = "",
    points: str = _source("p", POINTS, 3),
    vertices: str = "",
    geometry: str = "",
    node: str = PLACE.format(BIND.format("")),
    effect: str = f"<phong>{RED}</phong>",
    params: str = SAMPLER,
    setparam: str = "",
    image: str = "<init_from>wood.png</init_from>",
    asset: str = "<up_axis>Z_UP</up_axis>",
    libraries: str = "",
    scenes: str = "",
    scene: str = '<scene><instance_visual_scene url="#vs"/></scene>',
    extra: str = "",
    namespace: str = NAMESPACE,
    version: str = "1.4.1",
) -> str:
    geometry = geometry or (
        f'<geometry id="g"><mesh>{points}{sources}<vertices id="v"><input semantic="POSITION" source="#p"/>{vertices}</vertices>'
        f"{mesh}</mesh></geometry>"
    )
    return f"""<?xml version="1.0"?>
<COLLADA{namespace} version="{version}"><asset>{asset}</asset>
<library_images><image id="i">{image}</image></library_images>
<library_effects><effect id="e"><profile_COMMON>{params}<technique sid="c">{effect}</technique>{extra}</profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e">{setparam}</instance_effect></material></library_materials>
<library_geometries>{geometry}</library_geometries>{libraries}
<library_visual_scenes>{scenes}<visual_scene id="vs"><node id="top">{node}</node></visual_scene></library_visual_scenes>
{scene}</COLLADA>"""


def _load(folder: Path, text: str | bytes) -> Mesh:
    (folder / "wood.png").write_bytes(png((5, 6, 7)))
    (folder / "a.dae").write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_mesh(folder / "a.dae", [folder])


def _part(folder: Path, text: str | bytes) -> MeshPart:
    mesh = _load(folder, text)
    assert mesh.warnings == ()
    (part,) = mesh.parts
    return part


def _warned(folder: Path, text: str, *words: str) -> MeshPart:
    mesh = _load(folder, text)
    assert any(all(word in warning for word in words) for warning in mesh.warnings), mesh.warnings
    assert not any("\n" in warning for warning in mesh.warnings)
    return mesh.parts[0]


def _area(part: MeshPart) -> float:
    a, b, c = (part.vertices[part.triangles[:, k]].astype(float) for k in range(3))
    return float(np.cross(b - a, c - a)[:, 2].sum() / 2)


# Document


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
@rule(FORMAT, "<?xml encoding?>", "done", "UTF-8, UTF-16 and others, with and without a byte order mark")
def test_all_encodings_of_xml_are_read(tmp_path: Path, encoding: str) -> None:
    mark = b"\xff\xfe" if encoding == "utf-16-le" else b"\xfe\xff" if encoding == "utf-16-be" else b""
    text = _text().replace('version="1.0"', f'version="1.0" encoding="{"utf-16" if "16" in encoding else "utf-8"}"', 1)
    assert _area(_part(tmp_path, mark + text.encode(encoding))) == 8.0


@pytest.mark.parametrize("namespace", ["", NAMESPACE, ' xmlns="http://www.collada.org/2008/03/COLLADASchema"'])
@rule(FORMAT, "<COLLADA xmlns>", "done", "those of 1.4 and 1.5, or none")
def test_namespaces_of_all_versions_are_read(tmp_path: Path, namespace: str) -> None:
    assert _area(_part(tmp_path, _text(namespace=namespace))) == 8.0


@rule(FORMAT, "ZAE", "refused", "a ZIP archive; unpack it")
def test_zae_is_refused(tmp_path: Path) -> None:
    for name in ("a.zae", "b.dae"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("a.dae", _text())
        with pytest.raises(MeshError, match="unpack") as caught:
            load_mesh(tmp_path / name, [tmp_path])
        assert "\n" not in str(caught.value)


@rule(FORMAT, "decimal commas", "approximated", "not allowed; read as decimal points, with one warning")
def test_decimal_commas_are_read_with_a_warning(tmp_path: Path) -> None:
    text = _text(points=_source("p", POINTS.replace("4", "4,5"), 3), asset='<unit meter="0,1"/><up_axis>Z_UP</up_axis>')
    mesh = _load(tmp_path, text)
    assert len(mesh.warnings) == 1
    assert "decimal comma" in mesh.warnings[0]
    assert _area(mesh.parts[0]) == pytest.approx(0.45**2 / 2)


@rule(FORMAT, "<asset><unit>", "done")
def test_unit_is_applied(tmp_path: Path) -> None:
    assert _area(_part(tmp_path, _text(asset='<unit meter="0.5"/><up_axis>Z_UP</up_axis>'))) == 2.0


@pytest.mark.parametrize(("up", "second"), [("Z_UP", [4, 0, 0]), ("Y_UP", [4, 0, 0]), ("X_UP", [0, 0, 4])])
@rule(FORMAT, "<asset><up_axis>", "done", "X_UP, Y_UP and Z_UP; Y_UP where it is missing")
def test_up_axis_is_applied(tmp_path: Path, up: str, second: list[float]) -> None:
    assert corners(_part(tmp_path, _text(asset=f"<up_axis>{up}</up_axis>")))[0][1] == second


@rule(FORMAT, "<up_axis> of another value", "approximated", "Y_UP is used")
def test_unknown_up_axis_is_named(tmp_path: Path) -> None:
    _warned(tmp_path, _text(asset="<up_axis>W_UP</up_axis>"), "W_UP", "Y_UP is used")


@rule(FORMAT, "<asset> of an element", "left out", "unit and up axis of the file are used")
def test_asset_of_a_part_is_named(tmp_path: Path) -> None:
    node = '<asset><unit meter="0.01"/></asset>' + PLACE.format(BIND.format(""))
    assert _area(_warned(tmp_path, _text(node=node), "<asset> of <node>", "those of the file")) == 8.0


# Geometry


@rule(FORMAT, "<triangles>", "done")
def test_triangles(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(mesh=f'<triangles count="2" material="s">{V}<p>0 1 2 0 2 3</p></triangles>'))
    assert (len(part.triangles), _area(part)) == (2, 16.0)


@rule(FORMAT, "<trifans>", "done", "one fan per <p>")
def test_trifans(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(mesh=f'<trifans count="2" material="s">{V}<p>0 1 2 3</p><p>4 5 6 7</p></trifans>'))
    assert (len(part.triangles), _area(part)) == (4, 20.0)


@rule(FORMAT, "<tristrips>", "done", "one strip per <p>; each second triangle is turned")
def test_tristrips(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(mesh=f'<tristrips count="2" material="s">{V}<p>0 1 3 2</p><p>4 5 7 6</p></tristrips>'))
    assert (len(part.triangles), _area(part)) == (4, 20.0)


@rule(FORMAT, "<polylist>", "done", "concave polygons too")
def test_concave_polygon_of_a_polylist_keeps_its_shape(tmp_path: Path) -> None:
    # An arrow: the corner (3, 1) of the inner square dents the outer; a fan from its first corner would cover more.
    part = _part(tmp_path, _text(mesh=f'<polylist count="1" material="s">{V}<vcount>4</vcount><p>1 2 3 6</p></polylist>'))
    # 8 of the half square less the triangle (4, 0), (3, 3), (0, 4), of area 4.
    assert _area(part) == pytest.approx(4.0)
    assert all(np.cross(b - a, c - a)[2] > 0 for a, b, c in part.vertices[part.triangles].astype(float))


@rule(FORMAT, "<polygons>", "done", "one polygon per <p>; concave ones too")
def test_polygons(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(mesh=f'<polygons count="2" material="s">{V}<p>0 1 2 3</p><p>4 5 6 7</p></polygons>'))
    assert _area(part) == 20.0


@pytest.mark.parametrize("hole", ["4 5 6 7", "7 6 5 4"])
@rule(FORMAT, "<polygons><ph><h>", "done", "holes in either orientation stay open")
def test_holes_of_polygons_stay_open(tmp_path: Path, hole: str) -> None:
    mesh = f'<polygons count="2" material="s">{V}<p>0 1 2</p><ph><p>0 1 2 3</p><h>{hole}</h></ph></polygons>'
    part = _part(tmp_path, _text(mesh=mesh))
    assert _area(part) == pytest.approx(8.0 + 12.0)
    centres = part.vertices[part.triangles[1:]].mean(axis=1)
    assert not ((np.abs(centres[:, :2] - 2) < 1).all(axis=1)).any()


@pytest.mark.parametrize("tag", ["lines", "linestrips"])
@rule(FORMAT, "<lines>, <linestrips>", "left out", "lines are not drawn")
def test_lines_are_named(tmp_path: Path, tag: str) -> None:
    _warned(tmp_path, _text(mesh=f'{TRIANGLE}<{tag} count="1">{V}<p>0 1</p></{tag}>'), "lines are not drawn")


@rule(FORMAT, "polygons of fewer than three corners", "left out", "they have no area")
def test_polygons_of_two_corners_are_named(tmp_path: Path) -> None:
    mesh = f'<polylist count="2" material="s">{V}<vcount>2 3</vcount><p>0 1 0 1 2</p></polylist>'
    assert _area(_warned(tmp_path, _text(mesh=mesh), "fewer than 3 corners")) == 8.0


@pytest.mark.parametrize("tag", ["spline", "brep"])
@rule(FORMAT, "<spline>, <brep>", "left out", "export them as triangles")
def test_curves_are_named(tmp_path: Path, tag: str) -> None:
    text = _text(libraries=f'<library_geometries><geometry id="c"><{tag}/></geometry></library_geometries>')
    text = text.replace('<node id="top">', '<node id="top"><instance_geometry url="#c"/>')
    _warned(tmp_path, text, "geometry 'c'", "not drawn")


@rule(FORMAT, "<convex_mesh>", "done", "with its own polygons")
def test_convex_mesh_with_polygons_is_read(tmp_path: Path) -> None:
    text = _text().replace("<mesh>", "<convex_mesh>").replace("</mesh>", "</convex_mesh>")
    assert _area(_part(tmp_path, text)) == 8.0


@rule(FORMAT, "<convex_mesh convex_hull_of>", "left out", "the hull is not computed")
def test_convex_hull_is_named(tmp_path: Path) -> None:
    hull = '<library_geometries><geometry id="h"><convex_mesh convex_hull_of="#g"/></geometry></library_geometries>'
    text = _text(libraries=hull).replace('<node id="top">', '<node id="top"><instance_geometry url="#h"/>')
    _warned(tmp_path, text, "convex hull")


# Inputs and sources


@rule(FORMAT, "<input offset>", "done", "each corner has an index per offset")
def test_inputs_have_their_own_indices(tmp_path: Path) -> None:
    normal = '<input semantic="NORMAL" source="#n" offset="2"/>'
    mesh = f'<triangles count="1" material="s">{V}{normal}<p>0 9 1 1 9 1 2 9 0</p></triangles>'
    part = _part(tmp_path, _text(mesh=mesh, sources=_source("n", "1 0 0 0 0 1", 3)))
    assert part.normals[part.triangles[0]].tolist() == [[0, 0, 1], [0, 0, 1], [1, 0, 0]]


@rule(FORMAT, "<vertices><input>", "done", "POSITION, NORMAL, TEXCOORD and COLOR")
def test_inputs_of_vertices_are_read(tmp_path: Path) -> None:
    vertices = '<input semantic="NORMAL" source="#n"/><input semantic="TEXCOORD" source="#t"/>'
    sources = _source("n", "1 0 0 " * 8, 3) + _source("t", "0.25 0 " * 8, 2)
    part = _part(tmp_path, _text(sources=sources, vertices=vertices))
    assert part.uvs is not None
    assert (part.normals[0].tolist(), part.uvs[0].tolist()) == ([1, 0, 0], [0.25, 1])


@rule(FORMAT, "<accessor stride offset>", "done")
def test_stride_and_offset_of_an_accessor(tmp_path: Path) -> None:
    points = _source("p", "9 9 0 0 0 7 4 0 0 7 4 4 0 7", 4).replace('count="3" stride', 'count="3" offset="2" stride')
    assert _area(_part(tmp_path, _text(points=points))) == 8.0


@rule(FORMAT, "<accessor><param>", "done", "parameters without a name are skipped; all are read where none has a name")
def test_parameters_without_a_name_are_skipped(tmp_path: Path) -> None:
    x, y, z = (f'<param name="{name}" type="float"/>' for name in "XYZ")
    points = _source("p", "7 0 0 0 7 4 0 0 7 4 4 0", 4, f'<param type="float"/>{x}{y}{z}')
    assert _area(_part(tmp_path, _text(points=points))) == 8.0
    assert _area(_part(tmp_path, _text(points=_source("p", POINTS, 3, '<param type="float"/>' * 3)))) == 8.0


@rule(FORMAT, "COLOR", "done", "multiplies the colour of the material")
def test_vertex_colours_are_read(tmp_path: Path) -> None:
    color = '<input semantic="COLOR" source="#c" offset="1" set="0"/>'
    sources = _source("c", "1 0.2 0 0 0 1", 3)
    for material in ('material="s"', ""):
        part = _part(
            tmp_path, _text(mesh=f'<triangles count="1" {material}>{V}{color}<p>0 0 1 0 2 1</p></triangles>', sources=sources)
        )
        assert part.colors is not None
        assert part.material.colored
        assert part.colors[part.triangles[0]].tolist() == [[255, 51, 0], [255, 51, 0], [0, 0, 255]]
        assert part.material.base_color == ((1, 0, 0, 1) if material else (1, 1, 1, 1))


@rule(FORMAT, "COLOR with alpha", "left out", "vertices are opaque")
def test_alpha_of_vertex_colours_is_named(tmp_path: Path) -> None:
    text = _text(vertices='<input semantic="COLOR" source="#c"/>', sources=_source("c", "1 1 1 0.5 " * 8, 4))
    _warned(tmp_path, text, "alpha of its vertex colours")


TWO_SETS = (
    f'<triangles count="1" material="s">{V}<input semantic="TEXCOORD" source="#t" offset="0" set="0"/>'
    '<input semantic="TEXCOORD" source="#u" offset="0" set="1"/><p>0 1 2</p></triangles>'
)
SETS = _source("t", "0 0 " * 8, 2) + _source("u", "0.5 0.75 " * 8, 2)


@rule(FORMAT, "<bind_vertex_input>", "done", "binds a set of texture coordinates")
def test_bound_set_of_texture_coordinates_is_used(tmp_path: Path) -> None:
    bind = '<bind_vertex_input semantic="UV" input_semantic="TEXCOORD" input_set="1"/>'
    text = _text(mesh=TWO_SETS, sources=SETS, effect=f"<phong>{TEXTURED}</phong>", node=PLACE.format(BIND.format(bind)))
    part = _part(tmp_path, text)
    assert part.uvs is not None
    assert part.uvs.tolist() == [[0.5, 0.25]] * 3


@rule(FORMAT, "several sets of texture coordinates, none bound", "approximated", "the lowest set is used")
def test_unbound_sets_of_texture_coordinates_are_named(tmp_path: Path) -> None:
    text = _text(mesh=TWO_SETS, sources=SETS, effect=f"<phong>{TEXTURED}</phong>")
    part = _warned(tmp_path, text, "sets 0, 1", "set 0 is used")
    assert part.uvs is not None
    assert part.uvs.tolist() == [[0, 1]] * 3


@rule(FORMAT, "<bind_vertex_input> of other semantics", "left out", "only texture coordinates can be bound")
def test_other_bound_inputs_are_named(tmp_path: Path) -> None:
    bind = '<bind_vertex_input semantic="X" input_semantic="COLOR" input_set="1"/>'
    _warned(tmp_path, _text(node=PLACE.format(BIND.format(bind))), "<bind_vertex_input>", "COLOR")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<p>0 1 2</p>", "<p>0 1 -5</p>", "position -5"),
        ("<p>0 1 2</p>", "<p>0 1 x</p>", "'x'"),
        ('offset="0"', 'offset="-1"', "offset=-1"),
        ('stride="3"', 'stride="2"', "has 2 numbers per POSITION"),
        ("4 4 0", "4 four 0", "'four'"),
    ],
)
@rule(FORMAT, "broken numbers", "refused", "the value is named")
def test_broken_numbers_are_refused_in_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(MeshError) as caught:
        _load(tmp_path, _text().replace(old, new, 1))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


# Scene


@pytest.mark.parametrize(
    ("transform", "second"),
    [
        ("<matrix>1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1</matrix>", [9, 6, 7]),
        ("<translate>5 6 7</translate>", [9, 6, 7]),
        ("<rotate>0 0 1 90</rotate>", [0, 4, 0]),
        ("<rotate>0 0 0 0</rotate>", [4, 0, 0]),
        ("<scale>2 3 4</scale>", [8, 0, 0]),
        # Along x (second axis) by the tangent of 45 degrees times y (first axis): (4, 4, 0) -> (8, 4, 0); (4, 0, 0) stays.
        ("<skew>45 0 1 0 1 0 0</skew>", [4, 0, 0]),
        ("<skew>45 1 0 0 0 1 0</skew>", [4, 4, 0]),
        # From (0, 0, 9) towards +x with z up: -z points to +x, x to -y.
        ("<lookat>0 0 9 5 0 9 0 0 1</lookat>", [0, -4, 9]),
        ("<translate>1 0 0</translate><rotate>0 0 1 90</rotate>", [1, 4, 0]),
        ("<rotate>0 0 1 90</rotate><translate>1 0 0</translate>", [0, 5, 0]),
    ],
)
@rule(FORMAT, "<matrix>, <translate>, <rotate>, <scale>, <skew>, <lookat>", "done", "composed in the order of the file")
def test_transforms_of_nodes(tmp_path: Path, transform: str, second: list[float]) -> None:
    part = _part(tmp_path, _text(node=transform + PLACE.format(BIND.format(""))))
    np.testing.assert_allclose(corners(part)[0][1], second, atol=1e-4)


@rule(FORMAT, "transform of another length", "refused")
def test_transform_with_too_few_numbers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="<translate> has 2 numbers, must have 3"):
        _load(tmp_path, _text(node="<translate>1 2</translate>" + PLACE.format(BIND.format(""))))


@rule(FORMAT, "<instance_node>, <library_nodes>", "done")
def test_instances_of_nodes(tmp_path: Path) -> None:
    library = f'<library_nodes><node id="n"><translate>0 0 1</translate>{PLACE.format(BIND.format(""))}</node></library_nodes>'
    node = '<translate>0 0 5</translate><instance_node url="#n"/>'
    assert corners(_part(tmp_path, _text(libraries=library, node=node)))[0][0] == [0, 0, 6]


@rule(FORMAT, "references into other files", "left out", "put everything into one file")
def test_reference_into_another_file_is_named(tmp_path: Path) -> None:
    node = '<instance_node url="other.dae#n"/><instance_geometry url="other.dae#g"/>' + PLACE.format(BIND.format(""))
    _warned(tmp_path, _text(node=node), "other.dae#n", "not in the file")
    _warned(tmp_path, _text(node=node), "other.dae#g", "not in the file")


@rule(FORMAT, "percent-encoded references", "done")
def test_reference_may_be_percent_encoded(tmp_path: Path) -> None:
    text = _text().replace('geometry id="g"', 'geometry id="my g"').replace('url="#g"', 'url="#my%20g"')
    assert _area(_part(tmp_path, text)) == 8.0


OTHER_SCENE = '<visual_scene id="other"><node><translate>0 0 3</translate><instance_geometry url="#g"/></node></visual_scene>'


@rule(FORMAT, "<scene><instance_visual_scene>", "done")
def test_scene_names_its_visual_scene(tmp_path: Path) -> None:
    assert corners(_part(tmp_path, _text(scenes=OTHER_SCENE)))[0][0] == [0, 0, 0]


@rule(FORMAT, "several scenes, none named", "approximated", "the first is used")
def test_first_scene_is_used_with_a_warning(tmp_path: Path) -> None:
    text = _text(scenes=OTHER_SCENE, scene="").replace('material="s"', "")
    assert corners(_warned(tmp_path, text, "2 visual scenes", "'other' is used"))[0][0] == [0, 0, 3]


@rule(FORMAT, "no visual scene", "approximated", "every geometry is drawn at the origin")
def test_file_without_a_scene_is_drawn_with_a_warning(tmp_path: Path) -> None:
    text = _text(scene="")
    start, end = text.index("<library_visual_scenes>"), text.index("</library_visual_scenes>")
    text = (text[:start] + text[end + len("</library_visual_scenes>") :]).replace('material="s"', "")
    assert _area(_warned(tmp_path, text, "no visual scene")) == 8.0


SKIN = '<instance_controller url="#k"/>'


@rule(FORMAT, "<skin>", "approximated", "drawn in the bind pose; <bind_shape_matrix> is applied")
def test_skin_is_drawn_in_its_bind_pose(tmp_path: Path) -> None:
    bind = "<bind_shape_matrix>2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1</bind_shape_matrix>"
    library = f'<library_controllers><controller id="k"><skin source="#g">{bind}</skin></controller></library_controllers>'
    text = _text(libraries=library, node=SKIN).replace('material="s"', "")
    assert _area(_warned(tmp_path, text, "skin 'k'", "bind pose")) == 32.0


@rule(FORMAT, "<morph>", "approximated", "drawn in the base shape")
def test_morph_is_drawn_in_its_base_shape(tmp_path: Path) -> None:
    library = '<library_controllers><controller id="k"><morph source="#g"/></controller></library_controllers>'
    text = _text(libraries=library, node=SKIN).replace('material="s"', "")
    assert _area(_warned(tmp_path, text, "morph 'k'", "base shape")) == 8.0


@pytest.mark.parametrize(
    ("libraries", "node", "scene", "word"),
    [
        ('<library_animations><animation id="a"/></library_animations>', "", "", "animations"),
        ("", '<instance_light url="#l"/>', "", "lights"),
        ("", '<instance_camera url="#c"/>', "", "cameras"),
        ("", "", '<instance_physics_scene url="#p"/>', "physics"),
        ("", "", '<instance_kinematics_scene url="#k"/>', "kinematics"),
        ("<library_force_fields><force_field/></library_force_fields>", "", "", "force fields"),
    ],
)
@rule(
    FORMAT,
    "<animation>, <light>, <camera>, <physics_scene>, <kinematics_scene>, <force_field>",
    "left out",
    "geometry alone is read",
)
def test_elements_other_than_geometry_are_named(tmp_path: Path, libraries: str, node: str, scene: str, word: str) -> None:
    text = _text(
        libraries=libraries,
        node=node + PLACE.format(BIND.format("")),
        scene=f'<scene>{scene}<instance_visual_scene url="#vs"/></scene>',
    )
    _warned(tmp_path, text, word, "left out")


# Effects


@pytest.mark.parametrize("shader", ["phong", "blinn", "lambert"])
@rule(FORMAT, "<phong>, <blinn>, <lambert>", "done", "diffuse and emitted light")
def test_diffuse_colour(tmp_path: Path, shader: str) -> None:
    assert _part(tmp_path, _text(effect=f"<{shader}>{RED}</{shader}>")).material.base_color == (1, 0, 0, 1)


@rule(FORMAT, "<constant>", "done", "its emission, without light")
def test_constant_shader_shows_its_emission(tmp_path: Path) -> None:
    material = _part(tmp_path, _text(effect="<constant><emission><color>0 1 0 1</color></emission></constant>")).material
    assert material.unlit
    assert material.base_color == (0, 1, 0, 1)


@rule(FORMAT, "<emission> above 1", "done", "the strength of the light: its colour at 1, times it")
def test_strong_emission(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(effect=f"<phong><emission><color>5 2.5 0 1</color></emission>{RED}</phong>"))
    # 5 times the colour 1 0.5 0: ((0.5 + 0.055) / 1.055) ** 2.4 = 0.2140.
    np.testing.assert_allclose(part.material.emissive, (5, 5 * 0.2140, 0), rtol=1e-3)


@rule(FORMAT, "<emission>", "done")
def test_emission(tmp_path: Path) -> None:
    part = _part(tmp_path, _text(effect=f"<phong><emission><color>1 0 0 1</color></emission>{RED}</phong>"))
    assert list(part.material.emissive) == [1, 0, 0]
    texture = '<emission><texture texture="sampler" texcoord="UV"/></emission>'
    assert _part(tmp_path, _text(effect=f"<phong>{texture}{RED}</phong>")).material.emissive_texture is not None


@rule(FORMAT, "<param ref>", "done", "of colours and numbers; <setparam> of a material has precedence over <newparam>")
def test_parameters_of_effects(tmp_path: Path) -> None:
    params = '<newparam sid="c"><float4>0 0 1 1</float4></newparam><newparam sid="t"><float>0.5</float></newparam>'
    effect = '<phong><diffuse><param ref="c"/></diffuse><transparency><param ref="t"/></transparency></phong>'
    assert _part(tmp_path, _text(effect=effect, params=params)).material.base_color == (0, 0, 1, 0.5)
    setparam = '<setparam ref="c"><float3>0 1 0</float3></setparam>'
    assert _part(tmp_path, _text(effect=effect, params=params, setparam=setparam)).material.base_color == (0, 1, 0, 0.5)


@rule(FORMAT, "<param ref> of no parameter", "left out", "the surface is light grey")
def test_undefined_parameter_is_named(tmp_path: Path) -> None:
    _warned(tmp_path, _text(effect='<phong><diffuse><param ref="gone"/></diffuse></phong>'), "'gone'", "not define")


@pytest.mark.parametrize(
    ("transparent", "alpha"),
    [
        ('opaque="A_ONE"><color>1 1 1 0.5</color>', 0.25),
        ('opaque="A_ZERO"><color>1 1 1 0.5</color>', 0.75),
        ('opaque="RGB_ZERO"><color>0.5 0.5 0.5 1</color>', 0.75),
        ('opaque="RGB_ONE"><color>0.5 0.5 0.5 1</color>', 0.25),
    ],
)
@rule(FORMAT, "<transparent opaque>, <transparency>", "done", "all four modes")
def test_transparency(tmp_path: Path, transparent: str, alpha: float) -> None:
    effect = f"<phong>{RED}<transparent {transparent}</transparent><transparency><float>0.5</float></transparency></phong>"
    material = _part(tmp_path, _text(effect=effect)).material
    assert material.base_color[3] == pytest.approx(alpha)
    assert material.alpha_mode == "blend"


@rule(FORMAT, "<color> that cannot be read", "left out", "the mesh is drawn without it")
def test_broken_colour_is_named(tmp_path: Path) -> None:
    for color in ("1 0 0.01.0", "1 0"):
        effect = f"<phong><emission><color>{color}</color></emission>{RED}</phong>"
        assert _warned(tmp_path, _text(effect=effect), color, "<emission>", "left out").material.base_color == (1, 0, 0, 1)


@rule(FORMAT, "invisible surfaces", "approximated", "drawn opaque: exporters write them by mistake")
def test_invisible_surface_is_drawn_opaque(tmp_path: Path) -> None:
    effect = f"<phong>{RED}<transparency><float>0</float></transparency></phong>"
    assert _warned(tmp_path, _text(effect=effect), "invisible", "drawn opaque").material.alpha_mode == "opaque"


@rule(FORMAT, "<transparent> with unequal colours", "approximated", "their mean opacity")
def test_coloured_transparency_is_named(tmp_path: Path) -> None:
    effect = f'<phong>{RED}<transparent opaque="RGB_ZERO"><color>0.9 0 0 1</color></transparent></phong>'
    _warned(tmp_path, _text(effect=effect), "mean opacity")


@rule(FORMAT, "<transparent><texture>", "left out", "unless it is the alpha of the diffuse image, then a mask")
def test_texture_of_opacity_is_named(tmp_path: Path) -> None:
    effect = f'<phong>{RED}<transparent><texture texture="sampler" texcoord="UV"/></transparent></phong>'
    _warned(tmp_path, _text(effect=effect), "texture of its opacity")


@pytest.mark.parametrize("slot", ["specular", "reflective"])
@rule(FORMAT, "<specular>, <shininess>, <reflective>, <reflectivity>", "left out", "surfaces are matte")
def test_highlights_are_named(tmp_path: Path, slot: str) -> None:
    _warned(tmp_path, _text(effect=f"<phong>{RED}<{slot}><color>1 1 1 1</color></{slot}></phong>"), slot, "matte")


@rule(FORMAT, "<ambient><texture>", "left out", "its colour is that of the diffuse light")
def test_ambient_texture_is_named(tmp_path: Path) -> None:
    _warned(tmp_path, _text(effect=f'<phong><ambient><texture texture="sampler"/></ambient>{RED}</phong>'), "ambient light")


@rule(FORMAT, "<profile_CG>, <profile_GLSL>, <profile_GLES>", "left out", "<profile_COMMON> alone is read")
def test_other_profiles_are_named(tmp_path: Path) -> None:
    _warned(tmp_path, _text(effect="<pass/>").replace("profile_COMMON", "profile_GLSL"), "<profile_COMMON>", "light grey")


@pytest.mark.parametrize("tag", ["bump", "normal"])
@rule(FORMAT, "<extra> with <bump>, <normal>", "left out", "the surface is smooth")
def test_bump_maps_are_named(tmp_path: Path, tag: str) -> None:
    extra = f'<extra><technique profile="FCOLLADA"><{tag}><texture texture="sampler"/></{tag}></technique></extra>'
    _warned(tmp_path, _text(extra=extra), f"{tag} map")


@rule(FORMAT, "<extra> with <double_sided>1", "done", "all surfaces are drawn from both sides")
def test_surfaces_are_double_sided(tmp_path: Path) -> None:
    extra = '<extra><technique profile="GOOGLEEARTH"><double_sided>1</double_sided></technique></extra>'
    assert _part(tmp_path, _text(extra=extra)).material.double_sided


@rule(FORMAT, "<extra> with <double_sided>0", "approximated", "back faces are drawn too")
def test_single_sided_surfaces_are_named(tmp_path: Path) -> None:
    extra = '<extra><technique profile="MAX3D"><double_sided>0</double_sided></technique></extra>'
    assert _warned(tmp_path, _text(extra=extra), "back faces").material.double_sided


# Images


@pytest.mark.parametrize(
    "image",
    [
        "<init_from>wood.png</init_from>",
        "<init_from>./w%6Fod.png</init_from>",
        "<init_from>file://{folder}/wood.png</init_from>",
        "<init_from><ref>wood.png</ref></init_from>",
        "<create_2d><init_from><ref>wood.png</ref></init_from></create_2d>",
        "<data>{hex}</data>",
        '<init_from><hex format="PNG">{hex}</hex></init_from>',
    ],
)
@rule(FORMAT, "<image>", "done", "<init_from> as a URI, in <ref> (1.5) and <create_2d>, and hexadecimal data")
def test_images_are_found(tmp_path: Path, image: str) -> None:
    image = image.format(folder=tmp_path, hex=png((5, 6, 7)).hex())
    texture = _part(tmp_path, _text(effect=f"<phong>{TEXTURED}</phong>", image=image)).material.texture
    assert texture is not None
    assert texture.pixels.tolist() == [[[5, 6, 7]]]


@pytest.mark.parametrize(
    "params",
    [
        SAMPLER,
        '<newparam sid="sampler"><sampler2D><instance_image url="#i"/></sampler2D></newparam>',
    ],
)
@rule(FORMAT, "<newparam>: <sampler2D>, <surface>", "done", "1.4 by way of a surface, 1.5 by <instance_image>")
def test_samplers_lead_to_images(tmp_path: Path, params: str) -> None:
    assert _part(tmp_path, _text(effect=f"<phong>{TEXTURED}</phong>", params=params)).material.texture is not None


@rule(
    FORMAT, "<sampler2D>: <wrap_s>, <wrap_t>, <minfilter>, <magfilter>, <mipfilter>", "done", "WRAP, MIRROR, CLAMP; all filters"
)
def test_sampling(tmp_path: Path) -> None:
    modes = (
        "<wrap_s>MIRROR</wrap_s><wrap_t>CLAMP</wrap_t><minfilter>NEAREST_MIPMAP_LINEAR</minfilter><magfilter>NEAREST</magfilter>"
    )
    params = SAMPLER.replace("</sampler2D>", modes + "</sampler2D>")
    texture = _part(tmp_path, _text(effect=f"<phong>{TEXTURED}</phong>", params=params)).material.texture
    assert texture is not None
    read = texture.sampling
    assert (read.wrap_u, read.wrap_v, read.minified, read.between_levels, read.magnified) == (
        "mirror", "clamp", "nearest", "linear", "nearest",
    )  # fmt: skip


@pytest.mark.parametrize("mode", ["BORDER", "NONE", "MIRROR_ONCE"])
@rule(FORMAT, "<wrap_s>BORDER, NONE, MIRROR_ONCE", "approximated", "CLAMP or MIRROR")
def test_other_wrap_modes_are_named(tmp_path: Path, mode: str) -> None:
    params = SAMPLER.replace("</sampler2D>", f"<wrap_s>{mode}</wrap_s></sampler2D>")
    _warned(tmp_path, _text(effect=f"<phong>{TEXTURED}</phong>", params=params), mode)


@rule(FORMAT, "<texture><extra> that scales, moves or turns it", "left out", "the texture lies as its coordinates say")
def test_placement_of_textures_is_named(tmp_path: Path) -> None:
    extra = '<extra><technique profile="MAYA"><repeatU>2</repeatU><repeatV>1</repeatV></technique></extra>'
    effect = f'<phong><diffuse><texture texture="sampler" texcoord="UV">{extra}</texture></diffuse></phong>'
    _warned(tmp_path, _text(effect=effect), "<repeatU>2")


@rule(FORMAT, "missing materials, images, geometries", "left out", "each is named")
def test_missing_things_are_named(tmp_path: Path) -> None:
    _warned(tmp_path, _text().replace('material id="m"', 'material id="x"'), "material 'm'", "light grey")
    _warned(tmp_path, _text(effect=f"<phong>{TEXTURED}</phong>").replace('image id="i"', 'image id="x"'), "image 'i'")
    _warned(tmp_path, _text(node='<instance_geometry url="#gone"/>' + PLACE.format(BIND.format(""))), "geometry 'gone'")
