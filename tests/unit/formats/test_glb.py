"""The container of binary glTF files, and the builder of their content."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.errors import MeshError
from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder, glb_bytes
from gibson_sim.formats.light_maps import light_map_png, radiance_of
from gibson_sim.formats.load_mesh import load_mesh
from support.gltf import png

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]


def parsed(glb: bytes) -> tuple[dict[str, Any], bytes]:
    """Returns the document and the content of the BIN chunk."""
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length]), glb[28 + length :]


def test_chunks_are_padded_to_four_bytes() -> None:
    # Magic, version 2, 12 + (8 + 8) + (8 + 8) bytes.
    head = b"glTF\x02\x00\x00\x00\x2c\x00\x00\x00"
    text = b'\x08\x00\x00\x00JSON{"a":1} '
    data = b"\x08\x00\x00\x00BIN\x00\x01\x02\x03\x04\x05\x00\x00\x00"
    assert glb_bytes({"a": 1}, b"\x01\x02\x03\x04\x05") == head + text + data


def test_without_data_there_is_no_chunk_for_it() -> None:
    assert glb_bytes({}, b"") == b"glTF\x02\x00\x00\x00\x18\x00\x00\x00\x04\x00\x00\x00JSON{}  "


def test_a_triangle_is_laid_out_as_computed_by_hand() -> None:
    builder = GlbBuilder()
    position = builder.attribute(TRIANGLE, bounds=True)
    indices = builder.indices([[0, 1, 2]], "u2")
    builder.primitive({"POSITION": position}, indices, builder.material({"name": "grey"}))
    document, binary = parsed(builder.to_bytes("thing"))
    # Nine floats; three 16-bit indices and two bytes of padding.
    assert binary == struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 2, 0) + b"\x00\x00\x01\x00\x02\x00\x00\x00"
    assert document == {
        "asset": {"version": "2.0", "generator": "gibson_sim"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "thing"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "grey"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0.0, 0.0, 0.0], "max": [1.0, 2.0, 0.0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36, "target": 34962},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6, "target": 34963},
        ],
        "buffers": [{"byteLength": 44}],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("dtype", "values", "stride", "stored"),
    [
        ("i1", [[1, -2, 3]], 4, b"\x01\xfe\x03\x00"),
        ("u2", [[1, 2, 256]], 8, b"\x01\x00\x02\x00\x00\x01\x00\x00"),
        ("u2", [[1, 2]], 4, b"\x01\x00\x02\x00"),
        ("u1", [[1, 2, 3, 4]], 4, b"\x01\x02\x03\x04"),
    ],
)
def test_vertices_of_small_numbers_start_at_multiples_of_four_bytes(
    dtype: str, values: list[list[int]], stride: int, stored: bytes
) -> None:
    builder = GlbBuilder()
    builder.attribute(values * 2, dtype, normalized=True)
    document, binary = parsed(builder.to_bytes(""))
    assert document["bufferViews"] == [
        {"buffer": 0, "byteOffset": 0, "byteLength": 2 * stride, "target": 34962, "byteStride": stride}
    ]
    assert document["accessors"][0]["normalized"] is True and "min" not in document["accessors"][0]
    assert binary == stored * 2


def test_data_after_an_odd_number_of_bytes_is_aligned() -> None:
    builder = GlbBuilder()
    builder.indices([[0, 1, 2]], "u1")
    builder.attribute(TRIANGLE)
    document, _ = parsed(builder.to_bytes(""))
    assert [view["byteOffset"] for view in document["bufferViews"]] == [0, 4]


def test_image_files_are_named_once_and_image_data_goes_into_the_file() -> None:
    builder = GlbBuilder()
    assert [builder.texture_file(uri) for uri in ("a.jpg", "b.jpg", "a.jpg")] == [0, 1, 0]
    data = png((9, 8, 7))
    assert builder.texture_data(data) == 2 and builder.texture_data(b"\xff\xd8\xff\xe0") == 3
    document, binary = parsed(builder.to_bytes(""))
    assert document["images"] == [
        {"uri": "a.jpg"}, {"uri": "b.jpg"}, {"bufferView": 0, "mimeType": "image/png"}, {"bufferView": 1, "mimeType": "image/jpeg"},
    ]  # fmt: skip
    assert document["textures"] == [{"source": 0}, {"source": 1}, {"source": 2}, {"source": 3}]
    assert binary.startswith(data) and "target" not in document["bufferViews"][0]


def test_extensions_are_declared_in_order_of_the_alphabet() -> None:
    builder = GlbBuilder()
    builder.require("KHR_mesh_quantization")
    builder.material({"extensions": {"KHR_materials_unlit": {}}})
    document, _ = parsed(builder.to_bytes(""))
    assert document["extensionsUsed"] == ["KHR_materials_unlit", "KHR_mesh_quantization"]
    assert document["extensionsRequired"] == ["KHR_mesh_quantization"]


def test_the_matrix_of_the_node_is_written_by_columns() -> None:
    document, _ = parsed(GlbBuilder().to_bytes("", Z_UP_TO_Y_UP))
    assert document["nodes"][0]["matrix"] == [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]


def test_a_file_of_the_builder_is_read_back(tmp_path: Path) -> None:
    """Quantised positions in our own axes, packed normals, 16-bit texture coordinates and a texture inside."""
    builder = GlbBuilder()
    builder.require("KHR_mesh_quantization")
    attributes = {
        "POSITION": builder.attribute([[0, 0, 100], [200, 0, 100], [0, 400, 100]], "u2", bounds=True),
        "NORMAL": builder.attribute([[0, 0, 127]] * 3, "i1", normalized=True),
        "TEXCOORD_0": builder.attribute([[0, 65535], [65535, 65535], [0, 0]], "u2", normalized=True),
    }
    surface = {"baseColorTexture": {"index": builder.texture_data(png((200, 100, 50)))}}
    material = builder.material({"name": "wood", "pbrMetallicRoughness": surface})
    builder.primitive(attributes, builder.indices([[0, 1, 2]], "u1"), material)
    path = tmp_path / "thing.glb"
    path.write_bytes(builder.to_bytes("thing", Z_UP_TO_Y_UP @ np.diag([0.01, 0.01, 0.01, 1.0])))

    (part,) = load_mesh(path, [tmp_path]).parts
    assert part.vertices == pytest.approx(np.array([[0, 0, 1], [2, 0, 1], [0, 4, 1]]), abs=1e-6)
    assert part.normals == pytest.approx(np.array([[0, 0, 1]] * 3), abs=1e-6)
    assert part.uvs == pytest.approx(np.array([[0, 1], [1, 1], [0, 0]]), abs=1e-6)
    assert part.triangles.tolist() == [[0, 1, 2]]
    assert part.material.name == "wood" and part.material.texture is not None
    assert part.material.texture.pixels[0, 0, :3].tolist() == [200, 100, 50]


def test_a_light_map_is_read_as_written(tmp_path: Path) -> None:
    builder = GlbBuilder()
    light = np.linspace(0.0, 3.0, 24).reshape(2, 4, 3)
    surface = {"pbrMetallicRoughness": {"baseColorTexture": {"index": builder.texture_data(png((200, 100, 50)))}}}
    material = builder.light_mapped_material(surface, builder.texture_data(light_map_png(light, 3.0)), 3.0)
    attributes = {
        "POSITION": builder.attribute(TRIANGLE, bounds=True), "TEXCOORD_0": builder.attribute([[0, 5], [5, 5], [0, 0]]),
        "TEXCOORD_1": builder.attribute([[0, 0], [65535, 0], [0, 65535]], "u2", normalized=True),
    }  # fmt: skip
    builder.primitive(attributes, builder.indices([[0, 1, 2]]), material)
    content = builder.to_bytes("wall")
    document, _ = parsed(content)
    assert document["extensionsUsed"] == ["GIBSON_light_map", "KHR_materials_unlit"] and "extensionsRequired" not in document
    (tmp_path / "wall.glb").write_bytes(content)
    (part,) = load_mesh(tmp_path / "wall.glb", [tmp_path]).parts
    assert part.uvs is not None and part.light_uvs is not None and part.material.light_map is not None
    assert part.uvs.tolist() == [[0, 5], [5, 5], [0, 0]] and part.light_uvs.tolist() == [[0, 0], [1, 0], [0, 1]]
    assert part.material.unlit and part.material.light_intensity == 3.0
    radiance = radiance_of(part.material.light_map.pixels, 3.0)
    np.testing.assert_allclose(radiance, light, atol=3.0 / 65535)


def test_a_light_map_needs_an_intensity_above_0() -> None:
    with pytest.raises(MeshError, match=r"intensity of a light map is 0\.0, must be above 0"):
        light_map_png(np.ones((1, 1, 3)), 0.0)
