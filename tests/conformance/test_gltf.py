"""glTF 2.0, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, and its extensions."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.errors import MeshError
from gibson_sim.formats.light_maps import EXTENSION as LIGHT_MAP, light_map_png
from gibson_sim.formats.load_mesh import MeshLoader, load_mesh
from gibson_sim.formats.mesh import Material, Mesh, Sampling
from support.gltf import Gltf, png

FORMAT = "glTF"
FLAT = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
"""A triangle, which with z up is (0, 0, 0), (1, 0, 0), (0, 0, 1)."""
UVS = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
HALF = 0.5**0.5
GLOSS = "KHR_materials_pbrSpecularGlossiness"
MATTE = {"metallicFactor": 0.0, "roughnessFactor": 1.0}


def read(gltf: Gltf, tmp_path: Path, name: str = "t.glb") -> Mesh:
    return load_mesh(gltf.write(tmp_path / name), [tmp_path])


def primitive(gltf: Gltf, number: int = 0) -> dict[str, Any]:
    found: dict[str, Any] = gltf.document["meshes"][0]["primitives"][number]
    return found


def material_of(source: dict[str, Any], tmp_path: Path, images: int = 0, **document: Any) -> tuple[Material, tuple[str, ...]]:
    """Returns a material read from a file, and the warnings."""
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.document["materials"] = [source]
    gltf.document["images"] = [{"bufferView": gltf.view(png((k, 0, 0))), "mimeType": "image/png"} for k in range(images)]
    gltf.document["textures"] = [{"source": k} for k in range(images)]
    gltf.document |= document
    mesh = read(gltf, tmp_path)
    return mesh.parts[0].material, mesh.warnings


def points(mesh: Mesh, number: int = 0) -> list[list[float]]:
    """Returns the corners of the triangles of a part, in the axes of the file (y up)."""
    part = mesh.parts[number]
    corners = part.vertices[part.triangles].reshape(-1, 3)
    return [[round(float(c), 5) + 0.0 for c in (x, z, -y)] for x, y, z in corners]


# The document


@rule(FORMAT, "asset.version", "refused", "must be 2.x")
@pytest.mark.parametrize("asset", [{"version": "1.0"}, {}, [], "2.0"])
def test_another_version_is_refused(tmp_path: Path, asset: Any) -> None:
    gltf = Gltf().triangle()
    gltf.document["asset"] = asset
    with pytest.raises(MeshError, match=r"glTF version is .*must be 2"):
        read(gltf, tmp_path)


@rule(FORMAT, "asset.minVersion", "refused", "above 2.0")
def test_a_file_for_a_later_version_is_refused(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["asset"] = {"version": "2.1", "minVersion": "2.0"}
    assert points(read(gltf, tmp_path)) == FLAT
    gltf.document["asset"]["minVersion"] = "2.1"
    with pytest.raises(MeshError, match=r"needs glTF 2\.1, 2\.0 is read"):
        read(gltf, tmp_path)


@rule(FORMAT, "asset.copyright, generator, extras, name", "done", "without influence on the picture")
def test_extras_names_and_custom_attributes_are_ignored(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["asset"] |= {"copyright": "2026", "generator": "by hand", "extras": {"a": [1]}}
    gltf.document["nodes"][0] |= {"name": "n", "extras": 3}
    primitive(gltf)["attributes"]["_HEAT"] = gltf.accessor([1.0, 2.0, 3.0])
    mesh = read(gltf, tmp_path)
    assert points(mesh) == FLAT
    assert not mesh.warnings


@rule(FORMAT, "GLB chunks of other types", "done", "ignored, as specified")
def test_other_chunks_of_a_glb_are_ignored(tmp_path: Path) -> None:
    data = Gltf().triangle(FLAT).glb() + struct.pack("<I4s4s", 4, b"ACME", b"1234")
    (tmp_path / "t.glb").write_bytes(data[:8] + struct.pack("<I", len(data)) + data[12:])
    assert points(load_mesh(tmp_path / "t.glb", [tmp_path])) == FLAT


@rule(
    FORMAT, "GLB header: magic, version, length", "refused", "another magic or version, or a file that is shorter than its length"
)
@pytest.mark.parametrize(
    ("at", "value", "message"),
    [(0, b"glTX", "is not a GLB file"), (4, b"\1\0\0\0", "GLB version is 1, must be 2"), (8, b"\xff\xff\0\0", "is cut after")],
)
def test_a_wrong_header_of_a_glb_is_refused(tmp_path: Path, at: int, value: bytes, message: str) -> None:
    data = Gltf().triangle(FLAT).glb()
    (tmp_path / "t.glb").write_bytes(data[:at] + value + data[at + 4 :])
    with pytest.raises(MeshError, match=message):
        load_mesh(tmp_path / "t.glb", [tmp_path])


@rule(FORMAT, "a value of another JSON type", "refused", "the message names the place, the value and what it must be")
def test_every_value_of_a_wrong_json_type_is_refused_in_one_line(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, [0, 1, 2], uvs=UVS, material=0)
    gltf.document |= {
        "materials": [
            {
                "name": "m", "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": True, "emissiveFactor": [0, 0, 0],
                "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1], "baseColorTexture": {"index": 0, "texCoord": 0}},
            }
        ],
        "textures": [{"source": 0, "sampler": 0}], "samplers": [{"magFilter": 9728, "wrapS": 33071}],
        "images": [{"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"}], "extensionsUsed": ["KHR_materials_unlit"],
        "skins": [{"joints": [0]}], "cameras": [],
    }  # fmt: skip
    gltf.document["nodes"] = [{"mesh": 0, "rotation": [0, 0, 0, 1], "children": [], "weights": [1.0], "extensions": {}}]
    text = gltf.text()

    def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        return [path, *(place for key, item in inner for place in places(item, (*path, key)))]

    untyped = {"cameras", "mimeType", "byteLength"}  # not read, or not needed
    path, tried = tmp_path / "t.gltf", 0
    for place in places(json.loads(text))[1:]:
        wrongs: tuple[Any, ...] = ([], {}, "?", None, 1.5, True)
        for wrong in wrongs:
            document = json.loads(text)
            holder = document
            for key in place[:-1]:
                holder = holder[key]
            if type(holder[place[-1]]) is type(wrong) or place[-1] in untyped:
                continue
            if isinstance(holder[place[-1]], int) and isinstance(wrong, float) and "index" not in str(place[-1]):
                continue  # where any number is allowed
            holder[place[-1]] = wrong
            path.write_text(json.dumps(document))
            tried += 1
            try:
                load_mesh(path, [tmp_path])
            except MeshError as error:
                message = str(error)
                assert "\n" not in message, place
                assert "AttributeError" not in message and "TypeError" not in message and "KeyError" not in message, (
                    place,
                    wrong,
                    message,
                )
    assert tried > 300


@rule(FORMAT, "extensionsRequired", "refused", "of an extension that is not read")
def test_a_required_unknown_extension_is_refused(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    gltf.document["extensionsRequired"] = ["ACME_shape"]
    with pytest.raises(MeshError, match="ACME_shape"):
        read(gltf, tmp_path)


@pytest.mark.parametrize("name", ["KHR_materials_foo", "KHR_texture_foo"])
def test_a_required_unknown_extension_is_refused_whatever_its_name(tmp_path: Path, name: str) -> None:
    gltf = Gltf().triangle()
    gltf.document["extensionsRequired"] = gltf.document["extensionsUsed"] = [name]
    with pytest.raises(MeshError, match=f"needs glTF extension {name}"):
        read(gltf, tmp_path)


def test_a_required_material_extension_that_is_left_out_is_named_by_its_material(tmp_path: Path) -> None:
    name = "KHR_materials_clearcoat"
    source = {"pbrMetallicRoughness": MATTE, "extensions": {name: {"clearcoatFactor": 1.0}}}
    (warning,) = material_of(source, tmp_path, extensionsRequired=[name], extensionsUsed=[name])[1]
    assert name in warning


@rule(FORMAT, "extensionsUsed", "left out", "each extension that is not read is named")
def test_an_unknown_extension_that_is_used_is_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    gltf.document["extensionsUsed"] = ["ACME_shape", "KHR_xmp_json_ld"]
    (warning,) = read(gltf, tmp_path).warnings
    assert "ACME_shape is not read" in warning


@rule(FORMAT, "KHR_lights_punctual", "left out", "only the lights of the scene shine")
@rule(FORMAT, "KHR_materials_variants", "left out", "the default materials are drawn")
@pytest.mark.parametrize("name", ["KHR_lights_punctual", "KHR_materials_variants"])
def test_lights_and_variants_are_named(tmp_path: Path, name: str) -> None:
    gltf = Gltf().triangle()
    gltf.document["extensionsUsed"] = [name]
    (warning,) = read(gltf, tmp_path).warnings
    assert name in warning


@rule(FORMAT, "cameras", "left out", "cameras belong to robots and scenes")
def test_cameras_are_left_out(tmp_path: Path) -> None:
    gltf = Gltf().triangle()
    gltf.document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    (warning,) = read(gltf, tmp_path).warnings
    assert "cameras are left out" in warning


# Scenes and nodes


@rule(FORMAT, "scene", "done", "the default scene; the first one where none is named")
@rule(FORMAT, "scenes", "left out", "scenes other than the default one")
def test_the_default_scene_is_drawn_and_others_are_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document |= {
        "nodes": [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}],
        "scenes": [{"nodes": [0]}, {"nodes": [1]}],
        "scene": 1,
    }
    mesh = read(gltf, tmp_path)
    assert points(mesh)[0] == [5, 0, 0]
    (warning,) = mesh.warnings
    assert "2 scenes; only scene 1" in warning


@rule(FORMAT, "scenes (none)", "done", "all root nodes")
def test_without_scenes_all_roots_are_drawn(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["nodes"] = [{"children": [1]}, {"mesh": 0}, {"mesh": 0}]
    del gltf.document["scenes"], gltf.document["scene"]
    assert len(read(gltf, tmp_path).parts) == 2


@rule(FORMAT, "nodes[].children", "done", "the transform of a node moves its children; a node with two parents is refused")
def test_children_move_with_their_parents(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["nodes"] = [{"children": [1], "rotation": [0, 0, HALF, HALF]}, {"mesh": 0, "translation": [3, 0, 0]}]
    assert points(read(gltf, tmp_path)) == [[0, 3, 0], [0, 4, 0], [-1, 3, 0]]
    gltf.document["nodes"].append({"children": [1]})
    gltf.document["scenes"][0]["nodes"] = [0, 2]
    with pytest.raises(MeshError, match="node 1 has two parents"):
        read(gltf, tmp_path)


@rule(
    FORMAT, "scenes[].nodes", "approximated", "a node that is named twice is drawn once; a root that is also a child is refused"
)
def test_a_root_that_is_named_twice_is_drawn_once(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["scenes"] = [{"nodes": [0, 0]}]
    mesh = read(gltf, tmp_path)
    assert len(mesh.parts) == 1
    assert "its scene names node 0 more than once" in mesh.warnings[0]
    gltf.document["nodes"] = [{"children": [1]}, {"mesh": 0}]
    gltf.document["scenes"] = [{"nodes": [0, 1]}]
    with pytest.raises(MeshError, match="node 1 is a child, but also a root of the scene"):
        read(gltf, tmp_path)


@rule(FORMAT, "nodes[].matrix", "approximated", "beside a translation, rotation or scale, which has no effect")
def test_a_matrix_beside_a_translation_is_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["nodes"] = [{"mesh": 0, "matrix": np.eye(4).ravel().tolist(), "translation": [5, 0, 0]}]
    mesh = read(gltf, tmp_path)
    assert points(mesh) == FLAT
    assert "node 0 has a matrix and a translation, rotation or scale" in mesh.warnings[0]


@rule(FORMAT, "KHR_node_visibility", "done", "an invisible node and its children are not drawn")
def test_invisible_nodes_are_not_drawn(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["extensionsUsed"] = ["KHR_node_visibility"]
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    gltf.document["nodes"] = [{"mesh": 0}, {"children": [2], **hidden}, {"mesh": 0}]
    gltf.document["scenes"] = [{"nodes": [0, 1]}]
    mesh = read(gltf, tmp_path)
    assert len(mesh.parts) == 1
    assert not mesh.warnings


@rule(FORMAT, "nodes[].translation, rotation, scale", "done")
@rule(FORMAT, "nodes[].matrix", "done", "by columns")
@pytest.mark.parametrize(
    "node",
    [
        {"translation": [1, 2, 3], "rotation": [0, 0, HALF, HALF], "scale": [2, 3, 4]},
        {"matrix": [0, 2, 0, 0, -3, 0, 0, 0, 0, 0, 4, 0, 1, 2, 3, 1]},
    ],
)
def test_a_node_scales_then_rotates_then_translates(tmp_path: Path, node: dict[str, Any]) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["nodes"] = [{"mesh": 0, **node}]
    assert points(read(gltf, tmp_path)) == [[1, 2, 3], [1, 4, 3], [-2, 2, 3]]


@rule(FORMAT, "nodes[].scale (negative)", "done", "the winding is reversed, so that fronts stay fronts")
def test_a_mirroring_node_keeps_fronts(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["nodes"] = [{"mesh": 0, "scale": [-1, 1, 1]}]
    (part,) = read(gltf, tmp_path).parts
    a, b, c = part.vertices[part.triangles[0]]
    assert np.cross(b - a, c - a) @ part.normals[0] > 0


@rule(FORMAT, "EXT_mesh_gpu_instancing", "done")
def test_each_instance_is_drawn(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["extensionsRequired"] = gltf.document["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    attributes = {"TRANSLATION": gltf.accessor([[1.0, 0, 0], [2.0, 0, 0]]), "SCALE": gltf.accessor([[1.0, 1, 1], [3.0, 3, 3]])}
    gltf.document["nodes"] = [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}]
    mesh = read(gltf, tmp_path)
    assert points(mesh, 0)[1] == [2, 0, 0]
    assert points(mesh, 1)[1] == [5, 0, 0]


@rule(FORMAT, "attributes.JOINTS_n, WEIGHTS_n", "done", "any number of sets; weights are divided by their sum")
def test_a_second_set_of_joints_counts(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    none, first = gltf.accessor([[0, 0, 0, 0]] * 3, "<u2"), gltf.accessor([[1, 0, 0, 0]] * 3, "<u2")
    weights = gltf.accessor([[0.5, 0, 0, 0]] * 3)
    primitive(gltf)["attributes"] |= {"JOINTS_0": none, "JOINTS_1": first, "WEIGHTS_0": weights, "WEIGHTS_1": weights}
    gltf.document |= {"skins": [{"joints": [1, 2]}], "scenes": [{"nodes": [0, 1, 2]}]}
    gltf.document["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"translation": [4, 0, 0]}]
    assert points(read(gltf, tmp_path))[0] == [2, 0, 0]


@rule(FORMAT, "skins", "done", "in the pose of the joints; the transform of the node itself is ignored")
def test_a_skin_is_in_the_pose_of_its_joints(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    inverse = np.array([np.eye(4), np.eye(4)], dtype="<f4")
    inverse[1, 3, :3] = (-1, 0, 0)  # by columns: the joint was at (1, 0, 0)
    accessor = gltf.accessor(inverse.reshape(2, 16)[:, :4])
    gltf.document["accessors"][accessor] |= {"bufferView": gltf.view(inverse.tobytes()), "type": "MAT4"}
    primitive(gltf)["attributes"] |= {
        "JOINTS_0": gltf.accessor([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0]], "<u2"),
        "WEIGHTS_0": gltf.accessor([[0.5, 0.5, 0, 0], [1.0, 0, 0, 0], [1.0, 0, 0, 0]]),
    }
    gltf.document["skins"] = [{"joints": [1, 2], "inverseBindMatrices": accessor}]
    gltf.document["nodes"] = [{"mesh": 0, "skin": 0, "translation": [100, 0, 0]}, {"children": [2]}, {"translation": [1, 0, 2]}]
    gltf.document["scenes"] = [{"nodes": [0, 1]}]
    assert points(read(gltf, tmp_path)) == [[0, 0, 1], [1, 0, 2], [0, 1, 0]]


# Meshes


@rule(
    FORMAT,
    "meshes[].weights, nodes[].weights",
    "done",
    "of POSITION, NORMAL, TEXCOORD and COLOR; weights of a node replace those of its mesh",
)
@pytest.mark.parametrize(("holder", "weight"), [("meshes", 0.5), ("nodes", 0.25)])
def test_default_weights_move_vertices(tmp_path: Path, holder: str, weight: float) -> None:
    gltf = Gltf().triangle(FLAT)
    primitive(gltf)["targets"] = [
        {"POSITION": gltf.accessor([[0.0, 0, 4]] * 3), "NORMAL": gltf.accessor([[0.0, 4, 0]] * 3)},
        {"POSITION": gltf.accessor([[9.0, 9, 9]] * 3)},
    ]
    gltf.document["meshes"][0]["weights"] = [0.5, 0.0]
    gltf.document[holder][0]["weights"] = [weight, 0.0]
    mesh = read(gltf, tmp_path)
    assert points(mesh)[0] == [0, 0, 4 * weight]
    expected = np.array([0.0, 4 * weight, 1.0]) / np.hypot(4 * weight, 1.0)  # file axes
    np.testing.assert_allclose(mesh.parts[0].normals[0], expected[[0, 2, 1]] * (1, -1, 1), atol=1e-6)


@rule(FORMAT, "primitives[].mode 4, 5, 6", "done")
@pytest.mark.parametrize(("mode", "triangles"), [(4, [0, 1, 2]), (5, [0, 1, 2, 1, 3, 2]), (6, [1, 2, 0, 2, 3, 0])])
def test_triangles_strips_and_fans(tmp_path: Path, mode: int, triangles: list[int]) -> None:
    corners = [[0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0], [1.0, 1, 0]]
    gltf = Gltf().triangle(corners)
    primitive(gltf)["mode"] = mode
    found = points(read(gltf, tmp_path))

    def cycles(flat: list[list[float]]) -> list[list[list[float]]]:
        """Returns triangles that begin at their lowest corner, since any corner may be the first."""
        rows = [flat[k : k + 3] for k in range(0, len(flat), 3)]
        return [row[row.index(min(row)) :] + row[: row.index(min(row))] for row in rows]

    assert cycles(found) == cycles([corners[k] for k in triangles])


@rule(FORMAT, "primitives[] without triangles", "refused", "a file with no triangles at all, with the reason")
def test_a_file_of_lines_says_why_it_has_no_triangles(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    primitive(gltf)["mode"] = 1
    with pytest.raises(MeshError, match=r"has no triangles \(points and lines are not drawn\)"):
        read(gltf, tmp_path)


@rule(FORMAT, "primitives[].mode 0, 1, 2, 3", "left out", "points and lines are not drawn")
@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_points_and_lines_are_named(tmp_path: Path, mode: int) -> None:
    gltf = Gltf().triangle(FLAT).triangle(FLAT)
    primitive(gltf, 1)["mode"] = mode
    mesh = read(gltf, tmp_path)
    assert len(mesh.parts) == 1
    assert "points and lines are not drawn" in mesh.warnings[0]


@rule(FORMAT, "attributes.TEXCOORD_n", "done", "the set that the base colour names")
def test_the_base_colour_may_use_the_second_set(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, material=0)
    gltf.image_material({"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"})
    gltf.document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = 1
    primitive(gltf)["attributes"] |= {"TEXCOORD_0": gltf.accessor([[7.0, 7]] * 3), "TEXCOORD_1": gltf.accessor(UVS)}
    assert read(gltf, tmp_path).parts[0].uvs.tolist() == UVS  # type: ignore[union-attr]


@rule(FORMAT, "attributes.TEXCOORD_n (missing)", "left out", "the textures of a mesh without the set that its material names")
def test_missing_texture_coordinates_are_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, material=0)
    gltf.image_material({"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"})
    assert any("needs TEXCOORD_0" in warning for warning in read(gltf, tmp_path).warnings)
    assert any(
        "needs TEXCOORD_0" in warning for warning in MeshLoader([tmp_path], textures=False).mesh(tmp_path / "t.glb").warnings
    )


@rule(FORMAT, "attributes.TANGENT", "approximated", "normal textures are turned by the texture coordinates")
def test_tangents_are_named(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({"bufferView": gltf.view(png((128, 128, 255))), "mimeType": "image/png"})
    gltf.document["materials"] = [{"pbrMetallicRoughness": MATTE, "normalTexture": {"index": 0}}]
    primitive(gltf)["attributes"]["TANGENT"] = gltf.accessor([[1.0, 0, 0, 1]] * 3)
    (warning,) = read(gltf, tmp_path).warnings
    assert "TANGENT is not read" in warning
    assert MeshLoader([tmp_path], textures=False).mesh(tmp_path / "t.glb").warnings == (warning,)


@rule(FORMAT, "attributes.NORMAL (missing)", "done", "flat normals; unlit meshes, where nothing shows them, keep shared vertices")
def test_without_normals_triangles_are_flat(tmp_path: Path) -> None:
    gltf = Gltf().triangle([[0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0], [0.0, 0, 1]], [0, 1, 2, 0, 2, 3], material=0)
    primitive(gltf)["attributes"].pop("NORMAL")
    gltf.document["materials"] = [{"pbrMetallicRoughness": MATTE}]
    (part,) = read(gltf, tmp_path).parts
    # In the axes of the file the triangles face +z and +x.
    np.testing.assert_allclose(part.normals, [[0, -1, 0]] * 3 + [[1, 0, 0]] * 3, atol=1e-6)
    assert points(Mesh((part,))) == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1]]
    gltf.document["materials"] = [{"extensions": {"KHR_materials_unlit": {}}}]
    assert len(read(gltf, tmp_path).parts[0].vertices) == 4


@rule(FORMAT, "attributes.COLOR_0", "done", "linear; multiplies base colour and texture, its alpha too")
@pytest.mark.parametrize("textured", [False, True])
def test_colours_multiply_and_keep_their_alpha(tmp_path: Path, textured: bool) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"})
    if not textured:
        gltf.document["materials"] = [{"pbrMetallicRoughness": MATTE}]
    primitive(gltf)["attributes"]["COLOR_0"] = gltf.accessor([[1.0, 0.2140411, 0.0, 0.5]] * 3)
    (part,) = read(gltf, tmp_path).parts
    assert part.material.colored
    assert (part.material.texture is not None) == textured
    assert part.colors is not None
    assert part.colors[0].tolist() == [255, 127, 0, 128]  # sRGB of half is 0.5, of alpha itself


@rule(
    FORMAT,
    "materials[].occlusionTexture, normalTexture, ... on other texture coordinates",
    "left out",
    "maps that lie otherwise than the base colour",
)
def test_a_map_with_other_coordinates_is_named(tmp_path: Path) -> None:
    source = {
        "pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}},
        "occlusionTexture": {"index": 0, "texCoord": 1},
    }
    material, (warning,) = material_of(source, tmp_path, images=1)
    assert material.occlusion_texture is None
    assert "occlusionTexture" in warning


LIGHT = {"index": 0, "texCoord": 1, "intensity": 4.0}
LIGHT_UVS = [[0, 0], [65535, 0], [13107, 65535]]


def light_mapped(info: dict[str, Any], image: bytes | None = None) -> Gltf:
    """Returns a triangle with a light map, whose image has a pixel of 16 bits, (65535, 257, 3), unless another is given."""
    gltf = Gltf().triangle(FLAT, material=0)
    data = light_map_png([[[4.0, 4.0 * (257 / 65535) ** 2, 4.0 * (3 / 65535) ** 2]]], 4.0) if image is None else image
    gltf.document |= {
        "materials": [{"name": "wall", "pbrMetallicRoughness": MATTE, "extensions": {"KHR_materials_unlit": {}, LIGHT_MAP: info}}],
        "images": [{"bufferView": gltf.view(data), "mimeType": "image/png"}], "textures": [{"source": 0}], "extensionsUsed": [LIGHT_MAP],
    }  # fmt: skip
    uvs = gltf.accessor(LIGHT_UVS, "<u2")
    gltf.document["accessors"][uvs]["normalized"] = True
    primitive(gltf)["attributes"]["TEXCOORD_1"] = uvs
    return gltf


@rule(FORMAT, "GIBSON_light_map", "done", "16 or 8 bits; multiplies the base colour, [our extension](scenes.md#light-maps)")
def test_a_light_map_has_coordinates_of_its_own(tmp_path: Path) -> None:
    mesh = read(light_mapped(LIGHT), tmp_path)
    (part,) = mesh.parts
    assert not mesh.warnings
    assert part.uvs is None and part.light_uvs is not None and part.material.light_map is not None
    np.testing.assert_allclose(part.light_uvs, [[0, 0], [1, 0], [0.2, 1]], atol=1e-6)
    assert part.material.unlit and part.material.light_intensity == 4.0
    assert part.material.light_map.pixels.tolist() == [[[65535, 257, 3]]]


@rule(FORMAT, "GIBSON_light_map", "done", "16 or 8 bits; multiplies the base colour, [our extension](scenes.md#light-maps)")
def test_a_light_map_of_8_bits_is_widened(tmp_path: Path) -> None:
    (part,) = read(light_mapped(LIGHT, png((255, 1, 0))), tmp_path).parts
    assert part.material.light_map is not None
    assert part.material.light_map.pixels.tolist() == [[[65535, 257, 0]]]


@rule(FORMAT, "GIBSON_light_map (without its coordinates or image)", "left out", "the surface is drawn in its base colour")
def test_a_light_map_without_coordinates_or_image_is_named(tmp_path: Path) -> None:
    gltf = light_mapped(LIGHT)
    del primitive(gltf)["attributes"]["TEXCOORD_1"]
    (warning,) = read(gltf, tmp_path).warnings
    assert "GIBSON_light_map of material 'wall' needs TEXCOORD_1" in warning
    mesh = read(light_mapped(LIGHT, b"no image"), tmp_path, "other.glb")
    (warning,) = mesh.warnings
    assert "image 0 cannot be decoded" in warning and "without its light" in warning
    assert mesh.parts[0].material.light_map is None and mesh.parts[0].material.unlit


@rule(FORMAT, "GIBSON_light_map.intensity", "refused", "negative, or not a number")
@pytest.mark.parametrize("intensity", [-1.0, "4"])
def test_a_negative_intensity_of_a_light_map_is_refused(tmp_path: Path, intensity: Any) -> None:
    with pytest.raises(MeshError, match=r"GIBSON_light_map\.intensity is .*must be a finite number, at least 0"):
        read(light_mapped({**LIGHT, "intensity": intensity}), tmp_path)


# Accessors and buffers


@rule(FORMAT, "accessors[].componentType", "done", "all six")
@pytest.mark.parametrize(("code", "dtype"), [(5121, "u1"), (5123, "<u2"), (5125, "<u4")])
def test_indices_have_three_types(tmp_path: Path, code: int, dtype: str) -> None:
    gltf = Gltf().triangle(FLAT, [0, 1, 2])
    accessor = gltf.document["accessors"][primitive(gltf)["indices"]]
    accessor |= {"bufferView": gltf.view(np.array([2, 0, 1], dtype).tobytes()), "componentType": code}
    assert points(read(gltf, tmp_path)) == [FLAT[2], FLAT[0], FLAT[1]]


@rule(FORMAT, "accessors[].componentType", "done", "all six")
@pytest.mark.parametrize(
    ("code", "dtype", "most"), [(5120, "i1", 127), (5121, "u1", 255), (5122, "<i2", 32767), (5123, "<u2", 65535)]
)
def test_normals_and_colours_have_several_types(tmp_path: Path, code: int, dtype: str, most: int) -> None:
    gltf = Gltf().triangle(FLAT)
    rows = np.zeros((3, 4), dtype)  # the last column pads rows to 4 bytes
    rows[:, 2] = most
    view = gltf.view(rows.tobytes())
    gltf.document["bufferViews"][view]["byteStride"] = rows.strides[0]
    gltf.document["accessors"].append({"bufferView": view, "componentType": code, "normalized": True, "count": 3, "type": "VEC3"})
    primitive(gltf)["attributes"] |= {
        "NORMAL": len(gltf.document["accessors"]) - 1,
        "COLOR_0": len(gltf.document["accessors"]) - 1,
    }
    (part,) = read(gltf, tmp_path).parts
    np.testing.assert_allclose(part.normals, [[0, -1, 0]] * 3, atol=1e-6)
    assert part.colors is not None
    assert part.colors.tolist() == [[0, 0, 255]] * 3


@rule(FORMAT, "accessors[], bufferViews[] beyond their buffer", "refused")
def test_values_beyond_the_buffer_are_refused(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["accessors"][0]["count"] = 30
    with pytest.raises(MeshError, match=r"a buffer has \d+ bytes, but 360 are needed"):
        read(gltf, tmp_path)


@rule(FORMAT, "primitives[].indices", "refused", "of a vertex that does not exist")
def test_an_index_beyond_the_vertices_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="names vertex 3, but there are 3"):
        read(Gltf().triangle(FLAT, [0, 1, 3]), tmp_path)


@rule(FORMAT, "KHR_draco_mesh_compression", "done", "with the decoder DracoPy")
def test_draco_is_decoded(tmp_path: Path) -> None:
    codec = pytest.importorskip("DracoPy", reason="DracoPy is not installed; pip install DracoPy")
    data = codec.encode(np.array(FLAT, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.uint32), quantization_bits=16)
    (item,) = codec.decode(data).attributes
    gltf = Gltf().triangle(FLAT, [0, 1, 2])
    del primitive(gltf)["attributes"]["NORMAL"]
    for accessor in gltf.document["accessors"]:
        del accessor["bufferView"]
    extension = {"bufferView": gltf.view(data), "attributes": {"POSITION": item["unique_id"]}}
    primitive(gltf)["extensions"] = {"KHR_draco_mesh_compression": extension}
    gltf.document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    np.testing.assert_allclose(sorted(points(read(gltf, tmp_path))), sorted(FLAT), atol=1e-4)


@rule(FORMAT, "EXT_meshopt_compression, KHR_meshopt_compression", "done", "all modes and filters, with the decoder meshoptimizer")
@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_meshopt_is_decoded(tmp_path: Path, name: str) -> None:
    codec = pytest.importorskip("meshoptimizer.encoder", reason="meshoptimizer is not installed")
    gltf = Gltf().triangle(FLAT)
    corners = np.array([[5.0, 0, 0], [6.0, 0, 0], [5.0, 1, 0]], dtype=np.float32)
    packed = gltf.document["bufferViews"][gltf.view(bytes(codec.encode_vertex_buffer(corners, 3, 12)))]
    extension = {
        "buffer": 0,
        "byteOffset": packed["byteOffset"],
        "byteLength": packed["byteLength"],
        "byteStride": 12,
        "count": 3,
    }
    gltf.document["bufferViews"][0] = {"buffer": 0, "byteLength": 36, "extensions": {name: {**extension, "mode": "ATTRIBUTES"}}}
    gltf.document["extensionsRequired"] = [name]
    assert points(read(gltf, tmp_path)) == corners.tolist()


@rule(FORMAT, "accessors[].normalized", "done")
def test_normalised_integers_are_fractions(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, material=0, uvs=UVS)
    gltf.image_material({"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"})
    uvs = gltf.accessor([[0, 65535], [13107, 0], [0, 0]], "<u2")
    gltf.document["accessors"][uvs]["normalized"] = True
    primitive(gltf)["attributes"]["TEXCOORD_0"] = uvs
    (part,) = read(gltf, tmp_path).parts
    assert part.uvs is not None
    np.testing.assert_allclose(part.uvs[:2], np.array([[0, 1], [0.2, 0]]), atol=1e-6)


@rule(FORMAT, "accessors[].sparse", "done", "with and without a buffer view below")
@pytest.mark.parametrize("with_base", [True, False])
def test_sparse_values_replace_rows(tmp_path: Path, with_base: bool) -> None:
    gltf = Gltf().triangle(FLAT)
    accessor = gltf.document["accessors"][primitive(gltf)["attributes"]["POSITION"]]
    accessor["sparse"] = {
        "count": 1,
        "indices": {"bufferView": gltf.view(np.array([2], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(np.array([[0, 7, 0]], "<f4").tobytes())},
    }
    if not with_base:
        del accessor["bufferView"]
    expected = [[0, 0, 0], [1, 0, 0], [0, 7, 0]] if with_base else [[0, 0, 0], [0, 0, 0], [0, 7, 0]]
    assert points(read(gltf, tmp_path)) == expected


@rule(FORMAT, "bufferViews[].byteStride", "done")
def test_a_stride_skips_bytes(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    rows = np.hstack([np.array(FLAT), np.full((3, 2), 9.0)]).astype("<f4")
    view = gltf.view(rows.tobytes())
    gltf.document["bufferViews"][view]["byteStride"] = 20
    gltf.document["accessors"][primitive(gltf)["attributes"]["POSITION"]]["bufferView"] = view
    assert points(read(gltf, tmp_path)) == FLAT


@rule(FORMAT, "KHR_mesh_quantization", "done")
def test_positions_may_be_integers(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT)
    gltf.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    primitive(gltf)["attributes"]["POSITION"] = gltf.accessor([[0, 0, 0], [500, 0, 0], [0, 500, 0]], "<u2")
    gltf.document["nodes"] = [{"mesh": 0, "scale": [0.01, 0.01, 0.01]}]
    assert points(read(gltf, tmp_path))[1] == [5, 0, 0]


@rule(FORMAT, "buffers[].uri, images[].uri", "done", "files below the folder of the mesh, and data URIs")
def test_data_uris_are_read(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({"uri": "data:image/png;base64," + base64.b64encode(png((4, 5, 6))).decode()})
    (part,) = read(gltf, tmp_path, "t.gltf").parts
    assert part.material.texture is not None
    assert part.material.texture.pixels.tolist() == [[[4, 5, 6]]]


@rule(FORMAT, "images[].bufferView", "done")
def test_images_in_the_file_are_read(tmp_path: Path) -> None:
    material, _ = material_of({"pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}}, tmp_path, images=2)
    assert material.texture is not None
    assert material.texture.pixels.tolist() == [[[1, 0, 0]]]


@rule(FORMAT, "images[] without data", "refused")
def test_an_image_without_data_is_refused(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({})
    with pytest.raises(MeshError, match="image 0 has neither uri nor bufferView"):
        read(gltf, tmp_path)


# Materials


@rule(FORMAT, "materials[].pbrMetallicRoughness.baseColorFactor", "done", "white where it is missing")
def test_a_material_without_a_colour_is_white(tmp_path: Path) -> None:
    assert material_of({"pbrMetallicRoughness": MATTE}, tmp_path)[0].base_color == (1.0, 1.0, 1.0, 1.0)
    factor = {"baseColorFactor": [0.2140411, 0, 1, 0.5], **MATTE}
    np.testing.assert_allclose(material_of({"pbrMetallicRoughness": factor}, tmp_path)[0].base_color, (0.5, 0, 1, 0.5), atol=1e-6)


@rule(
    FORMAT,
    "primitives[].material (missing)",
    "approximated",
    "white as specified, but matte instead of rough metal; no warning, since no exporter means metal",
)
def test_without_a_material_a_mesh_is_white(tmp_path: Path) -> None:
    mesh = read(Gltf().triangle(FLAT), tmp_path)
    assert mesh.parts[0].material.base_color == (1.0, 1.0, 1.0, 1.0)
    assert (mesh.parts[0].material.metallic, mesh.parts[0].material.roughness) == (0.0, 1.0)


@rule(FORMAT, "metallicFactor, roughnessFactor", "done", "1 where one of them is missing")
def test_metallic_and_roughness_are_1_by_default(tmp_path: Path) -> None:
    assert material_of({"pbrMetallicRoughness": {"roughnessFactor": 0.2}}, tmp_path)[0].metallic == 1.0
    assert material_of({"pbrMetallicRoughness": {"metallicFactor": 0.2}}, tmp_path)[0].roughness == 1.0


@rule(
    FORMAT,
    "metallicFactor, roughnessFactor (both missing)",
    "approximated",
    "matte instead of rough metal, which few exporters mean",
)
def test_a_material_without_metallic_and_roughness_is_matte_with_a_warning(tmp_path: Path) -> None:
    material, (warning,) = material_of({"name": "wall"}, tmp_path)
    assert (material.metallic, material.roughness) == (0.0, 1.0)
    assert "drawn matte" in warning and "rough metal" in warning


@rule(FORMAT, "materials[].alphaMode, alphaCutoff", "done")
@pytest.mark.parametrize(("mode", "expected"), [("OPAQUE", "opaque"), ("MASK", "mask"), ("BLEND", "blend")])
def test_alpha_modes(tmp_path: Path, mode: str, expected: str) -> None:
    material, _ = material_of({"pbrMetallicRoughness": MATTE, "alphaMode": mode, "alphaCutoff": 0.25}, tmp_path)
    assert (material.alpha_mode, material.alpha_cutoff) == (expected, 0.25)


@rule(FORMAT, "materials[].alphaMode (unknown)", "refused")
def test_an_unknown_alpha_mode_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"materials\[0\].alphaMode is 'ADD', must be one of"):
        material_of({"alphaMode": "ADD"}, tmp_path)


@rule(
    FORMAT,
    "materials[].doubleSided",
    "approximated",
    "back faces are drawn in any case, since scans are wound either way; no warning, since most files leave it out",
)
@pytest.mark.parametrize("sides", [True, False])
def test_double_sided_is_read(tmp_path: Path, sides: bool) -> None:
    assert material_of({"pbrMetallicRoughness": MATTE, "doubleSided": sides}, tmp_path)[0].double_sided == sides


@rule(FORMAT, "emissiveFactor, KHR_materials_emissive_strength", "done")
def test_emission_is_scaled(tmp_path: Path) -> None:
    extensions = {"KHR_materials_emissive_strength": {"emissiveStrength": 10.0}}
    source = {"pbrMetallicRoughness": MATTE, "emissiveFactor": [0.1, 0.2, 0.3], "extensions": extensions}
    np.testing.assert_allclose(material_of(source, tmp_path)[0].emissive, (1, 2, 3))


@rule(FORMAT, "normalTexture, occlusionTexture, emissiveTexture, metallicRoughnessTexture", "done")
def test_texture_maps_are_assigned_to_their_slots(tmp_path: Path) -> None:
    source = {
        "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}},
        "normalTexture": {"index": 1, "scale": 0.5}, "occlusionTexture": {"index": 2, "strength": 0.25}, "emissiveTexture": {"index": 3},
    }  # fmt: skip
    m, _ = material_of(source, tmp_path, images=4)
    maps = (m.metallic_roughness_texture, m.normal_texture, m.occlusion_texture, m.emissive_texture)
    assert [None if t is None else int(t.pixels[0, 0, 0]) for t in maps] == [0, 1, 2, 3]
    assert (m.normal_scale, m.occlusion_strength) == (0.5, 0.25)


@rule(FORMAT, "KHR_materials_unlit", "done")
def test_unlit(tmp_path: Path) -> None:
    material, warnings = material_of({"extensions": {"KHR_materials_unlit": {}}}, tmp_path)
    assert material.unlit
    assert not warnings


@rule(
    FORMAT,
    "KHR_materials_pbrSpecularGlossiness",
    "approximated",
    "diffuse colour and glossiness of a non-metal; specular colours are left out",
)
def test_specular_glossiness_is_a_non_metal(tmp_path: Path) -> None:
    gloss = {"diffuseFactor": [1, 0, 0, 1], "specularFactor": [1, 1, 0], "glossinessFactor": 0.75}
    material, (warning,) = material_of({"extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}}, tmp_path)
    assert (material.metallic, material.roughness) == (0.0, 0.25)
    assert "specular colours" in warning


@rule(
    FORMAT,
    "KHR_materials_pbrSpecularGlossiness beside pbrMetallicRoughness",
    "left out",
    "the latter is drawn; the two are not mixed",
)
def test_beside_metal_and_roughness_specular_glossiness_is_named(tmp_path: Path) -> None:
    gloss = {"diffuseFactor": [1, 0, 0, 1], "glossinessFactor": 0.75}
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}, "extensions": {GLOSS: gloss}}
    material, (warning,) = material_of(source, tmp_path, images=1)
    assert material.texture is not None
    assert (material.base_color, material.roughness) == ((1.0, 1.0, 1.0, 1.0), 1.0)
    assert GLOSS in warning


_EFFECTS = {
    "KHR_materials_anisotropy": {"anisotropyStrength": 0.5},
    "KHR_materials_clearcoat": {"clearcoatFactor": 1.0},
    "KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.5},
    "KHR_materials_dispersion": {"dispersion": 0.1},
    "KHR_materials_ior": {"ior": 2.0},
    "KHR_materials_iridescence": {"iridescenceFactor": 1.0},
    "KHR_materials_sheen": {"sheenColorFactor": [1, 1, 1]},
    "KHR_materials_specular": {"specularFactor": 0.5},
    "KHR_materials_transmission": {"transmissionFactor": 0.9},
    "KHR_materials_volume": {"thicknessFactor": 0.1},
}


def _with_rules(test: Callable[..., None]) -> Callable[..., None]:
    for name in _EFFECTS:
        test = rule(FORMAT, name, "left out", "a warning where it changes the appearance")(test)
    return test


@_with_rules
@pytest.mark.parametrize("name", _EFFECTS)
def test_a_material_extension_is_named_where_it_has_an_effect(tmp_path: Path, name: str) -> None:
    _, (warning,) = material_of({"pbrMetallicRoughness": MATTE, "extensions": {name: _EFFECTS[name]}}, tmp_path)
    assert name in warning
    assert not material_of({"pbrMetallicRoughness": MATTE, "extensions": {name: {}}}, tmp_path)[1]


# Textures


@rule(FORMAT, "samplers[].wrapS, wrapT", "done")
@rule(FORMAT, "samplers[].magFilter, minFilter", "done", "linear with mip levels where the file leaves the choice")
def test_samplers_are_read(tmp_path: Path) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}, "emissiveTexture": {"index": 1}}
    textures = [{"source": 0, "sampler": 0}, {"source": 0}]
    samplers = [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9985}]
    material, _ = material_of(source, tmp_path, images=2, textures=textures, samplers=samplers)
    assert material.texture is not None and material.emissive_texture is not None
    assert material.texture.sampling == Sampling("clamp", "mirror", "nearest", "linear", "nearest")
    assert material.emissive_texture.sampling == Sampling()
    assert material.texture.pixels is material.emissive_texture.pixels


@rule(FORMAT, "KHR_texture_transform", "done", "one transform for all textures of a material")
def test_a_transform_scales_then_rotates_then_moves(tmp_path: Path) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({"bufferView": gltf.view(png((1, 2, 3))), "mimeType": "image/png"})
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 3]}
    info = gltf.document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    info["extensions"] = {"KHR_texture_transform": transform}
    # A quarter turn counter-clockwise in the image, whose v points down: (u, v) -> (v, -u).
    expected = [[0.5, 0.25], [0.5, -1.75], [3.5, 0.25]]
    (part,) = read(gltf, tmp_path).parts
    assert part.uvs is not None
    np.testing.assert_allclose(part.uvs, np.array(expected), atol=1e-6)


@pytest.mark.parametrize("transform", [{}, {"offset": [0, 0], "scale": [1.0, 1.0]}, {"rotation": 0.0}])
def test_an_identity_texture_transform_keeps_the_mapping(tmp_path: Path, transform: dict[str, Any]) -> None:
    emissive = {"index": 1, "extensions": {"KHR_texture_transform": transform}}
    source = {
        "pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}, "emissiveTexture": emissive, "emissiveFactor": [1, 1, 1],
    }  # fmt: skip
    material, warnings = material_of(source, tmp_path, images=2)
    assert material.emissive_texture is not None
    assert not warnings


@pytest.mark.parametrize(
    "without_effect",
    [
        {"emissiveTexture": {"index": 1, "texCoord": 1}},
        {"emissiveTexture": {"index": 1, "texCoord": 1}, "emissiveFactor": [0, 0, 0]},
        {"occlusionTexture": {"index": 1, "texCoord": 1, "strength": 0}},
    ],
)
def test_other_coordinates_of_a_texture_without_effect_are_not_named(tmp_path: Path, without_effect: dict[str, Any]) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}, **without_effect}
    assert material_of(source, tmp_path, images=2)[1] == ()


@rule(FORMAT, "KHR_texture_basisu", "left out", "KTX2 images are not read; the fallback image is used where there is one")
def test_ktx2_is_named_and_its_fallback_is_used(tmp_path: Path) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}}
    basis = {"extensions": {"KHR_texture_basisu": {"source": 1}}}
    material, (warning,) = material_of(source, tmp_path, images=2, textures=[basis])
    assert material.texture is None
    assert "KTX2" in warning
    material, warnings = material_of(source, tmp_path, images=2, textures=[{"source": 0, **basis}])
    assert material.texture is not None
    assert not warnings


@rule(
    FORMAT,
    "EXT_texture_avif, MSFT_texture_dds",
    "left out",
    "the extension is named; the fallback image is used where there is one",
)
@pytest.mark.parametrize("name", ["EXT_texture_avif", "MSFT_texture_dds"])
def test_other_image_formats_are_named(tmp_path: Path, name: str) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}}
    texture = {"extensions": {name: {"source": 0}}}
    material, warnings = material_of(source, tmp_path, images=1, textures=[texture], extensionsUsed=[name])
    assert material.texture is None
    assert any(name in warning for warning in warnings) and any("cannot be read" in warning for warning in warnings)
    material, _ = material_of(source, tmp_path, images=1, textures=[{"source": 0, **texture}], extensionsUsed=[name])
    assert material.texture is not None


@rule(
    FORMAT,
    "images[].mimeType",
    "done",
    "the bytes decide: PNG, JPEG, WebP and what else OpenCV decodes; others are left out with a warning",
)
def test_image_format_is_detected_from_its_bytes(tmp_path: Path) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}}
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.document |= {"materials": [source], "textures": [{"source": 0}], "images": [{"mimeType": "image/jpeg"}]}
    gltf.document["images"][0]["bufferView"] = gltf.view(png((1, 2, 3)))
    assert read(gltf, tmp_path).parts[0].material.texture is not None
    gltf.document["images"][0]["bufferView"] = gltf.view(b"not an image")
    mesh = read(gltf, tmp_path)
    assert mesh.parts[0].material.texture is None
    assert "cannot be decoded" in mesh.warnings[0]


@rule(FORMAT, "EXT_texture_webp", "done")
def test_webp_is_preferred(tmp_path: Path) -> None:
    source = {"pbrMetallicRoughness": {**MATTE, "baseColorTexture": {"index": 0}}}
    textures = [{"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}]
    material, _ = material_of(source, tmp_path, images=2, textures=textures)
    assert material.texture is not None
    assert int(material.texture.pixels[0, 0, 0]) == 1


@rule(FORMAT, "EXT_texture_webp", "approximated", "an image that cannot be read: the texture's own `source` is drawn")
@pytest.mark.parametrize("image", [{"uri": "missing.webp"}, {"uri": "data:image/webp;base64,AAAA"}])
def test_a_webp_that_cannot_be_read_has_a_fallback(tmp_path: Path, image: dict[str, Any]) -> None:
    gltf = Gltf().triangle(FLAT, uvs=UVS, material=0)
    gltf.image_material({"bufferView": gltf.view(png((7, 0, 0))), "mimeType": "image/png"})
    gltf.document["materials"][0]["pbrMetallicRoughness"] |= MATTE
    gltf.document["images"].append(image)
    gltf.document["textures"][0]["extensions"] = {"EXT_texture_webp": {"source": 1}}
    mesh = read(gltf, tmp_path)
    texture = mesh.parts[0].material.texture
    assert texture is not None and int(texture.pixels[0, 0, 0]) == 7
    (warning,) = mesh.warnings
    assert "the WebP image of texture 0 cannot be read; its fallback image is drawn" in warning


# Animations


@rule(FORMAT, "animations", "left out", "a warning where they change the pose")
@pytest.mark.parametrize(("end", "moves"), [(0.0, False), (1.0, True)])
def test_an_animation_is_named_where_it_moves_something(tmp_path: Path, end: float, moves: bool) -> None:
    gltf = Gltf().triangle(FLAT)
    samplers = [{"input": gltf.accessor([0.0, 1.0]), "output": gltf.accessor([[0.0, 0, 0], [end, 0, 0]])}]
    gltf.document["animations"] = [
        {"channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}], "samplers": samplers}
    ]
    assert any("animations are left out" in warning for warning in read(gltf, tmp_path).warnings) == moves
