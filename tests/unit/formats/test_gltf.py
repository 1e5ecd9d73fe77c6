"""glTF and GLB: axes, nodes, materials, textures, broken files."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.load_mesh import Material, MeshPart, load_mesh
from support.gltf import CORNERS, Gltf, png

HALF = 0.5**0.5


def test_y_up_becomes_z_up(tmp_path: Path) -> None:
    (part,) = load_mesh(Gltf().triangle().write(tmp_path / "t.glb"), [tmp_path]).parts
    # (x, y, z) of the file is (x, -z, y) with z up.
    assert part.vertices[part.triangles[0]].tolist() == [[1, -3, 2], [4, -3, 2], [1, -3, 5]]
    # It faced +z of the file, towards the viewer, which is -y with z up.
    assert part.normals.tolist() == [[0, -1, 0]] * 3


def test_text_and_binary_forms_are_equal(tmp_path: Path) -> None:
    binary = load_mesh(Gltf().triangle().write(tmp_path / "t.glb"), [tmp_path]).parts[0]
    text = load_mesh(Gltf().triangle().write(tmp_path / "t.gltf"), [tmp_path]).parts[0]
    assert text.vertices.tolist() == binary.vertices.tolist()


def _with_nodes(nodes: list[dict[str, object]]) -> Gltf:
    gltf = Gltf().triangle()
    gltf.document["nodes"] = nodes
    return gltf


def test_nested_nodes_translate_after_they_rotate(tmp_path: Path) -> None:
    # 90 degrees about y of the file takes (x, y, z) to (z, y, -x).
    gltf = _with_nodes([{"translation": [10, 0, 0], "children": [1]}, {"rotation": [0, HALF, 0, HALF], "mesh": 0}])
    (part,) = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    # (1, 2, 3) -> (3, 2, -1) -> (13, 2, -1) -> z up (13, 1, 2).
    np.testing.assert_allclose(part.vertices[part.triangles[0]], [[13, 1, 2], [13, 4, 2], [13, 1, 5]], atol=1e-5)


def _winding_agrees_with_normals(part: MeshPart) -> bool:
    a, b, c = part.vertices[part.triangles[0]]
    return bool(part.normals[part.triangles[0, 0]] @ np.cross(b - a, c - a) > 0)


def test_mirroring_scale_keeps_winding_and_normals_in_agreement(tmp_path: Path) -> None:
    gltf = _with_nodes([{"scale": [-2, 1, 1], "mesh": 0}])
    (part,) = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    assert sorted(part.vertices.tolist()) == [[-8, -3, 2], [-2, -3, 2], [-2, -3, 5]]
    assert part.normals[0].tolist() == [0, -1, 0]
    assert _winding_agrees_with_normals(part)


def test_matrix_of_a_node_is_read_by_columns(tmp_path: Path) -> None:
    gltf = _with_nodes([{"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1], "mesh": 0}])
    (part,) = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    assert part.vertices[part.triangles[0, 0]].tolist() == [8, -12, 10]


def test_unlit_material_is_unlit(tmp_path: Path) -> None:
    gltf = Gltf().triangle(material=0).triangle(material=1)
    gltf.document["materials"] = [{"name": "lit"}, {"name": "baked", "extensions": {"KHR_materials_unlit": {}}}]
    parts = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    assert [(p.material.name, p.material.unlit) for p in parts] == [("lit", False), ("baked", True)]


def test_each_primitive_has_its_own_colour(tmp_path: Path) -> None:
    gltf = Gltf().triangle(material=0).triangle(np.array(CORNERS) + 5, material=1)
    gltf.document["materials"] = [
        {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}},
        {"pbrMetallicRoughness": {"baseColorFactor": [0, 0.2140411, 0, 0.5]}, "alphaMode": "BLEND"},
    ]
    first, second = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    assert first.material.base_color == pytest.approx((1, 0, 0, 1))
    # Linear 0.214 is 0.5 in sRGB.
    assert second.material.base_color == pytest.approx((0, 0.5, 0, 0.5), abs=1e-4)
    assert second.material.alpha_mode == "blend"
    assert second.vertices.min(axis=0).tolist() == [6, -8, 7]


def test_image_in_a_buffer_view_is_decoded(tmp_path: Path) -> None:
    gltf = Gltf()
    material = gltf.image_material({"bufferView": gltf.view(png((10, 20, 30))), "mimeType": "image/png"})
    gltf.triangle(uvs=[[0, 0], [1, 0], [0, 1]], material=material)
    (part,) = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path]).parts
    assert part.material.texture is not None
    assert part.material.texture.pixels.tolist() == [[[10, 20, 30]]]


def test_image_in_a_data_uri_is_decoded(tmp_path: Path) -> None:
    gltf = Gltf()
    material = gltf.image_material({"uri": "data:image/png;base64," + base64.b64encode(png((1, 2, 3))).decode()})
    gltf.triangle(uvs=[[0, 0], [1, 0], [0, 1]], material=material)
    (part,) = load_mesh(gltf.write(tmp_path / "t.gltf"), [tmp_path]).parts
    assert part.material.texture is not None
    assert part.material.texture.pixels.tolist() == [[[1, 2, 3]]]


def _external(tmp_path: Path, uri: str) -> Path:
    gltf = Gltf()
    gltf.triangle(uvs=[[0, 0], [1, 0], [0, 1]], material=gltf.image_material({"uri": uri}))
    return gltf.write(tmp_path / "scene" / "t.glb")


def test_percent_encoded_image_name_is_found_and_listed(tmp_path: Path) -> None:
    path = _external(tmp_path, "my%20wall.png")
    (path.parent / "my wall.png").write_bytes(png((9, 8, 7)))
    mesh = load_mesh(path, [path.parent])
    assert mesh.parts[0].material.texture is not None
    assert mesh.parts[0].material.texture.pixels.tolist() == [[[9, 8, 7]]]
    assert [f.name for f in mesh.files] == ["t.glb", "my wall.png"]
    assert not [warning for warning in mesh.warnings if "wall" in warning]


def test_missing_texture_is_a_warning_that_names_it(tmp_path: Path) -> None:
    path = _external(tmp_path, "gone.png")
    mesh = load_mesh(path, [path.parent])
    warning, _matte = mesh.warnings
    assert "t.glb" in warning
    assert "gone.png" in warning
    assert mesh.parts[0].material.texture is None
    assert mesh.parts[0].material.base_color == (1.0, 1.0, 1.0, 1.0)


def test_texture_outside_the_roots_is_refused(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(png((9, 8, 7)))
    path = _external(tmp_path / "a", "../../secret.png")
    mesh = load_mesh(path, [path.parent])
    warning, _matte = mesh.warnings
    assert "outside" in warning
    assert "secret.png" in warning
    assert mesh.parts[0].material.texture is None
    assert [f.name for f in mesh.files] == ["t.glb"]


def test_buffer_outside_the_roots_is_refused(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    folder = tmp_path / "scene"
    path = gltf.write(folder / "t.gltf")
    uri = gltf.text().split('"uri": "')[1].split('"')[0]
    (tmp_path / "t.bin").write_bytes(gltf.chunk)
    path.write_text(gltf.text().replace(uri, "../t.bin"))
    with pytest.raises(MeshError, match="outside"):
        load_mesh(path, [folder])


def _assert_refused(path: Path) -> None:
    with pytest.raises(MeshError) as caught:
        load_mesh(path, [path.parent])
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.9, 0.99])
def test_cut_glb_is_refused(tmp_path: Path, share: float) -> None:
    data = Gltf().triangle().glb()
    path = tmp_path / "cut.glb"
    path.write_bytes(data[: int(share * len(data))])
    _assert_refused(path)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_random_bytes_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"noise{suffix}"
    path.write_bytes(np.random.default_rng(1).bytes(500))
    _assert_refused(path)


def test_random_bytes_behind_a_good_header_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "noise.glb"
    path.write_bytes(Gltf().triangle().glb()[:20] + np.random.default_rng(1).bytes(2000))
    _assert_refused(path)


def _set_view_length(gltf: Gltf) -> None:
    gltf.document["bufferViews"][0]["byteLength"] = 10**6


def _name_missing_material(gltf: Gltf) -> None:
    gltf.document["meshes"][0]["primitives"][0]["material"] = 3


def _make_a_loop(gltf: Gltf) -> None:
    gltf.document["nodes"] = [{"children": [1], "mesh": 0}, {"children": [0]}]


def _promise_too_many(gltf: Gltf) -> None:
    gltf.document["accessors"][0]["count"] = 2**40


@pytest.mark.parametrize("spoil", [_set_view_length, _name_missing_material, _make_a_loop, _promise_too_many])
def test_document_that_contradicts_itself_is_refused(tmp_path: Path, spoil: Callable[[Gltf], None]) -> None:
    gltf = Gltf().triangle()
    spoil(gltf)
    _assert_refused(gltf.write(tmp_path / "odd.glb"))


def test_index_out_of_range_is_refused(tmp_path: Path) -> None:
    _assert_refused(Gltf().triangle(indices=[0, 1, 3]).write(tmp_path / "odd.glb"))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertex_that_is_no_number_is_refused(tmp_path: Path, value: float) -> None:
    _assert_refused(Gltf().triangle([[value, 0, 0], [1, 0, 0], [0, 1, 0]]).write(tmp_path / "odd.glb"))


def test_mesh_outside_the_roots_is_refused(tmp_path: Path) -> None:
    path = Gltf().triangle().write(tmp_path / "t.glb")
    (tmp_path / "scene").mkdir()
    with pytest.raises(MeshError, match="outside"):
        load_mesh(path, [tmp_path / "scene"])


def test_unknown_required_extension_is_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    gltf.document["extensionsRequired"] = ["KHR_xmp_json_ld_2"]
    with pytest.raises(MeshError, match="KHR_xmp_json_ld_2"):
        load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path])


# Metal and roughness


def _material(tmp_path: Path, source: dict[str, object], images: int = 0) -> Material:
    gltf = Gltf().triangle(uvs=[[0, 0], [1, 0], [0, 1]], material=0)
    gltf.document["materials"] = [source]
    gltf.document["images"] = [{"bufferView": gltf.view(png((k, 20, 30))), "mimeType": "image/png"} for k in range(images)]
    gltf.document["textures"] = [{"source": k} for k in range(images)]
    mesh = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path])
    assert all("drawn matte" in warning for warning in mesh.warnings)
    return mesh.parts[0].material


def test_metal_roughness_and_emission_are_read(tmp_path: Path) -> None:
    material = _material(
        tmp_path,
        {
            "pbrMetallicRoughness": {"metallicFactor": 0.25, "roughnessFactor": 0.5},
            "emissiveFactor": [0.1, 0.2, 0.3],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 10.0}},
        },
    )
    assert (material.metallic, material.roughness) == (0.25, 0.5)
    assert material.emissive == pytest.approx((1.0, 2.0, 3.0))


def test_material_with_one_of_metallic_and_roughness_has_the_standard_default_of_the_other(tmp_path: Path) -> None:
    assert _material(tmp_path, {"pbrMetallicRoughness": {"roughnessFactor": 0.2}}).metallic == 1.0
    assert _material(tmp_path, {"pbrMetallicRoughness": {"metallicFactor": 0.0}}).roughness == 1.0


def test_material_without_metallic_and_roughness_is_matte(tmp_path: Path) -> None:
    material = _material(tmp_path, {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}})
    assert (material.metallic, material.roughness) == (0.0, 1.0)


def test_glossiness_is_one_minus_roughness(tmp_path: Path) -> None:
    source = {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"glossinessFactor": 0.75}}}
    material = _material(tmp_path, source)
    assert (material.metallic, material.roughness) == (0.0, 0.25)


def test_each_texture_finds_its_slot(tmp_path: Path) -> None:
    material = _material(
        tmp_path,
        {
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
            "normalTexture": {"index": 2, "scale": 0.5},
            "occlusionTexture": {"index": 3, "strength": 0.25},
            "emissiveTexture": {"index": 4},
        },
        images=5,
    )
    slots = ("texture", "metallic_roughness_texture", "normal_texture", "occlusion_texture", "emissive_texture")
    # The red of each image is its number.
    assert [getattr(material, slot).pixels[0, 0, 0] for slot in slots] == [0, 1, 2, 3, 4]
    assert (material.normal_scale, material.occlusion_strength) == (0.5, 0.25)
    assert material.has_maps


def test_unlit_materials_have_no_further_textures(tmp_path: Path) -> None:
    source = {"extensions": {"KHR_materials_unlit": {}}, "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}
    material = _material(tmp_path, source, images=1)
    assert material.emissive_texture is None
    assert not material.has_maps


def test_texture_with_another_mapping_is_left_out_with_a_warning(tmp_path: Path) -> None:
    gltf = Gltf()
    gltf.triangle(uvs=[[0, 0], [1, 0], [0, 1]], material=gltf.image_material({"bufferView": 0, "mimeType": "image/png"}))
    gltf.document["images"][0]["bufferView"] = gltf.view(png((1, 2, 3)))
    gltf.document["materials"][0]["normalTexture"] = {"index": 0, "texCoord": 1}
    mesh = load_mesh(gltf.write(tmp_path / "t.glb"), [tmp_path])
    assert mesh.parts[0].material.normal_texture is None
    assert any("normalTexture" in w and "left out" in w for w in mesh.warnings)
