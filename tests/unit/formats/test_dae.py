"""COLLADA: unit, up axis, node transforms, materials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import load_mesh
from support.gltf import png

EFFECT = "<diffuse><color>0.2 0.4 0.6 1</color></diffuse>"
NODE = '<instance_geometry url="#g"><bind_material><technique_common>' \
    '<instance_material symbol="s" target="#m"/></technique_common></bind_material></instance_geometry>'  # fmt: skip


def _write(
    path: Path, *, unit: str = "1", up: str = "Z_UP", effect: str = EFFECT, node: str = NODE, indices: str = "0 1 2"
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="u" meter="{unit}"/><up_axis>{up}</up_axis></asset>
  <library_images><image id="i"><init_from>../textures/wood.png</init_from></image></library_images>
  <library_effects><effect id="e"><profile_COMMON>
    <newparam sid="surface"><surface type="2D"><init_from>i</init_from></surface></newparam>
    <newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>
    <technique sid="c"><phong>{effect}</phong></technique></profile_COMMON></effect></library_effects>
  <library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="pa" count="9">100 200 300 400 200 300 100 500 300</float_array>
      <technique_common><accessor source="#pa" count="3" stride="3"/></technique_common></source>
    <source id="t"><float_array id="ta" count="6">0 0 1 0.25 0 1</float_array>
      <technique_common><accessor source="#ta" count="3" stride="2"/></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="1" material="s"><input semantic="VERTEX" source="#v" offset="0"/>
      <input semantic="TEXCOORD" source="#t" offset="0" set="0"/><p>{indices}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="vs"><node>{node}</node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#vs"/></scene>
</COLLADA>""")
    return path


def _corners(path: Path) -> list[list[float]]:
    (part,) = load_mesh(path, [path.parent]).parts
    corners: list[list[float]] = part.vertices[part.triangles[0]].round(5).tolist()
    return corners


def test_unit_is_applied(tmp_path: Path) -> None:
    np.testing.assert_allclose(_corners(_write(tmp_path / "a.dae", unit="0.01")), [[1, 2, 3], [4, 2, 3], [1, 5, 3]], atol=1e-6)


@pytest.mark.parametrize(("up", "first"), [("Z_UP", [100, 200, 300]), ("Y_UP", [100, -300, 200]), ("X_UP", [-200, -300, 100])])
def test_up_axis_is_applied(tmp_path: Path, up: str, first: list[float]) -> None:
    assert _corners(_write(tmp_path / "a.dae", up=up))[0] == first


def test_y_up_turns_the_normals_too(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.dae", up="Y_UP")
    (part,) = load_mesh(path, [tmp_path]).parts
    np.testing.assert_allclose(part.normals, [[0, -1, 0]] * 3, atol=1e-6)


def test_nested_transforms_are_composed_in_order(tmp_path: Path) -> None:
    # Outer: move by (1000, 0, 0). Inner, first to last: turn by 90 degrees about z, then (closer to the mesh) scale by 2.
    node = f"<matrix>1 0 0 1000 0 1 0 0 0 0 1 0 0 0 0 1</matrix><node><rotate>0 0 1 90</rotate><scale>2 2 2</scale>{NODE}</node>"
    # (100, 200, 300) -> (200, 400, 600) -> (-400, 200, 600) -> (600, 200, 600).
    np.testing.assert_allclose(_corners(_write(tmp_path / "a.dae", node=node))[0], [600, 200, 600], atol=1e-3)


def test_mirroring_matrix_keeps_winding_and_normals_in_agreement(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.dae", node=f"<scale>1 1 -1</scale>{NODE}")
    (part,) = load_mesh(path, [tmp_path]).parts
    a, b, c = part.vertices[part.triangles[0]]
    assert part.normals[0] @ np.cross(b - a, c - a) > 0


def test_diffuse_colour_is_read(tmp_path: Path) -> None:
    (part,) = load_mesh(_write(tmp_path / "a.dae"), [tmp_path]).parts
    assert part.material.base_color == (0.2, 0.4, 0.6, 1.0)


@pytest.mark.parametrize(
    "trap",
    [
        '<transparent opaque="A_ONE"><color>1 1 1 1</color></transparent><transparency><float>0</float></transparency>',
        '<transparent opaque="RGB_ZERO"><color>1 1 1 1</color></transparent><transparency><float>1</float></transparency>',
        "<transparency><float>0</float></transparency>",
    ],
)
def test_surface_that_would_be_invisible_is_opaque(tmp_path: Path, trap: str) -> None:
    (part,) = load_mesh(_write(tmp_path / "a.dae", effect=EFFECT + trap), [tmp_path]).parts
    assert part.material.base_color[3] == 1.0
    assert part.material.alpha_mode == "opaque"


def test_half_transparent_surface_stays_so(tmp_path: Path) -> None:
    glass = '<transparent opaque="A_ONE"><color>1 1 1 1</color></transparent><transparency><float>0.5</float></transparency>'
    (part,) = load_mesh(_write(tmp_path / "a.dae", effect=EFFECT + glass), [tmp_path]).parts
    assert part.material.base_color[3] == 0.5
    assert part.material.alpha_mode == "blend"


TEXTURED = '<diffuse><texture texture="sampler" texcoord="UVSET0"/></diffuse>'


def test_texture_in_a_folder_beside_is_read_where_the_root_holds_both(tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "wood.png").write_bytes(png((5, 6, 7)))
    mesh = load_mesh(_write(tmp_path / "meshes" / "a.dae", effect=TEXTURED), [tmp_path])
    (part,) = mesh.parts
    assert part.material.texture is not None
    assert part.material.texture.pixels.tolist() == [[[5, 6, 7]]]
    assert part.uvs is not None
    assert part.uvs[part.triangles[0]].tolist() == [[0, 1], [1, 0.75], [0, 0]]
    assert mesh.warnings == ()


def test_texture_outside_the_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "wood.png").write_bytes(png((5, 6, 7)))
    mesh = load_mesh(_write(tmp_path / "mine" / "a.dae", effect=TEXTURED), [tmp_path / "mine"])
    assert mesh.parts[0].material.texture is None
    assert any("wood.png" in w and "outside" in w for w in mesh.warnings)


def test_index_out_of_range_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"a\.dae.* 7"):
        load_mesh(_write(tmp_path / "a.dae", indices="0 1 7"), [tmp_path])


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.95])
def test_cut_file_is_refused_in_one_line(tmp_path: Path, share: float) -> None:
    path = _write(tmp_path / "a.dae")
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(MeshError) as caught:
        load_mesh(path, [tmp_path])
    assert "a.dae" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_xml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.dae").write_text("<sdf/>")
    with pytest.raises(MeshError, match="COLLADA"):
        load_mesh(tmp_path / "a.dae", [tmp_path])


@pytest.mark.parametrize("accessor", ['stride="0"', 'stride="-3"', 'stride="3" offset="10"'])
def test_accessor_that_leads_nowhere_is_refused(tmp_path: Path, accessor: str) -> None:
    path = _write(tmp_path / "meshes" / "a.dae")
    path.write_text(path.read_text().replace('stride="3"', accessor))
    with pytest.raises(MeshError, match="has stride"):
        load_mesh(path, [tmp_path])
