"""glTF compressed with Draco or meshoptimizer: decoded exactly, or refused in one line, whatever it contains."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.formats import gltf_compression as compression
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.formats.mesh import Mesh
from support.gltf import Gltf

SIDE = 12


def sheet() -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]:
    """Returns vertices (V, 3), triangles (F, 3) and texture coordinates (V, 2) of a bumpy sheet, in the axes of glTF."""
    u, v = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE), indexing="ij")
    vertices = np.stack([u, 0.1 * np.sin(6 * u), v], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))]).astype(np.uint32)
    return vertices, triangles, np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)


def plain() -> Gltf:
    vertices, triangles, uvs = sheet()
    gltf = Gltf()
    attributes = {"POSITION": gltf.accessor(vertices), "TEXCOORD_0": gltf.accessor(uvs)}
    indices = gltf.accessor(triangles.reshape(-1), "<u4")
    gltf.document["meshes"][0]["primitives"] = [{"attributes": attributes, "indices": indices}]
    return gltf


def draco() -> Gltf:
    encoder = pytest.importorskip("DracoPy", reason="DracoPy is not installed; pip install DracoPy")
    vertices, triangles, uvs = sheet()
    data = encoder.encode(vertices, triangles, quantization_bits=16, tex_coord=uvs.astype(np.float64))
    mesh = encoder.decode(data)
    ids = {{0: "POSITION", 3: "TEXCOORD_0"}[int(item["attribute_type"])]: item["unique_id"] for item in mesh.attributes}
    gltf = plain()
    for accessor in gltf.document["accessors"]:
        del accessor["bufferView"]
        accessor["count"] = len(mesh.points)
    gltf.document["accessors"][2]["count"] = mesh.faces.size
    gltf.chunk, gltf.document["bufferViews"] = b"", []
    (primitive,) = gltf.document["meshes"][0]["primitives"]
    primitive["extensions"] = {compression.DRACO: {"bufferView": gltf.view(data), "attributes": ids}}
    gltf.document["extensionsRequired"] = gltf.document["extensionsUsed"] = [compression.DRACO]
    return gltf


def meshopt() -> Gltf:
    encoder = pytest.importorskip("meshoptimizer.encoder", reason="meshoptimizer is not installed")
    vertices, triangles, uvs = sheet()
    gltf = plain()
    packed = [
        ("ATTRIBUTES", vertices, 12, encoder.encode_vertex_buffer(vertices, len(vertices), 12)),
        ("ATTRIBUTES", uvs, 8, encoder.encode_vertex_buffer(uvs, len(uvs), 8)),
        (
            "TRIANGLES",
            triangles.reshape(-1),
            4,
            encoder.encode_index_buffer(triangles.reshape(-1), triangles.size, len(vertices)),
        ),
    ]
    views, gltf.chunk, gltf.document["bufferViews"] = gltf.document["bufferViews"], b"", []
    for view, (mode, values, stride, data) in zip(views, packed, strict=True):
        where = gltf.document["bufferViews"][gltf.view(bytes(data))]
        extension = {"buffer": 0, "byteOffset": where["byteOffset"], "byteLength": where["byteLength"]}
        extension |= {"byteStride": stride, "count": len(values), "mode": mode}
        # The uncompressed buffer is not in the file.
        where.update(buffer=1, byteOffset=view["byteOffset"], byteLength=view["byteLength"])
        where["extensions"] = {compression.MESHOPT[0]: extension}
    gltf.document["extensionsRequired"] = [compression.MESHOPT[0]]
    return gltf


def in_order(mesh: Mesh) -> NDArray[np.float64]:
    """Returns the corners of all triangles, (F, 9), sorted."""
    vertices, triangles = mesh.merged()
    corners = np.round(vertices[triangles], 3)
    first = np.array([np.roll(t, -int(np.lexsort(t.T[::-1])[0]), axis=0) for t in corners]).reshape(len(corners), -1)
    return first[np.lexsort(first.T[::-1])]


@pytest.mark.parametrize("make", [draco, meshopt])
def test_compressed_mesh_equals_the_original(tmp_path: Path, make: Any) -> None:
    expected = load_mesh(plain().write(tmp_path / "plain.glb"), [tmp_path])
    found = load_mesh(make().write(tmp_path / "packed.glb"), [tmp_path])
    np.testing.assert_allclose(in_order(found), in_order(expected), atol=2e-3)
    assert not found.warnings
    uvs = found.parts[0].uvs
    assert uvs is not None
    # u is the x of the file, which is x here.
    np.testing.assert_allclose(uvs[:, 0], found.parts[0].vertices[:, 0], atol=2e-3)


def test_a_plain_copy_beside_the_compressed_one_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "find_spec", lambda name: None)
    gltf = plain()
    (primitive,) = gltf.document["meshes"][0]["primitives"]
    primitive["extensions"] = {compression.DRACO: {"bufferView": 0, "attributes": {"POSITION": 0}}}
    assert load_mesh(gltf.write(tmp_path / "both.glb"), [tmp_path]).triangle_count == 2 * (SIDE - 1) ** 2


def test_missing_decoder_error_has_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = draco().write(tmp_path / "a.glb")
    monkeypatch.setattr(compression, "find_spec", lambda name: None)
    with pytest.raises(MeshError, match=r"pip install DracoPy.*gltf-transform/cli copy in.glb"):
        load_mesh(path, [tmp_path])


def refused(path: Path) -> bool:
    """Returns whether a mesh is refused, in one line; another exception fails the test."""
    said = ""
    try:
        load_mesh(path, [path.parent])
    except MeshError as error:
        said = str(error)
    assert "\n" not in said and len(said) < 600
    return bool(said)


def test_broken_draco_is_refused_without_a_crash(tmp_path: Path) -> None:
    good, rng = draco(), np.random.default_rng(3)
    half = Gltf()
    half.document, half.chunk = json.loads(json.dumps(good.document)), good.chunk[: len(good.chunk) // 2]
    half.document["bufferViews"][0]["byteLength"] = len(half.chunk)
    assert refused(half.write(tmp_path / "half.glb"))
    # The counts at the start request more memory than there is.
    huge = Gltf()
    huge.document, huge.chunk = good.document, good.chunk[:11] + b"\xff\xff\xff\xff\x0f" + good.chunk[12:]
    assert refused(huge.write(tmp_path / "huge.glb"))
    for i in range(3):
        bent = Gltf()
        bent.document, data = good.document, bytearray(good.chunk)
        for at in rng.integers(5, len(data), 6):
            data[at] = rng.integers(256)
        bent.chunk = bytes(data)
        refused(bent.write(tmp_path / f"bent_{i}.glb"))


def test_a_wrong_count_of_a_draco_mesh_is_named_and_not_used(tmp_path: Path) -> None:
    right, wrong = draco(), draco()
    for accessor in wrong.document["accessors"][:2]:
        accessor["count"] -= 3  # as in files whose encoder split vertices
    expected, found = (load_mesh(g.write(tmp_path / f"{k}.glb"), [tmp_path]) for k, g in enumerate((right, wrong)))
    np.testing.assert_array_equal(in_order(found), in_order(expected))
    assert "its Draco mesh has" in found.warnings[0] and not expected.warnings


@pytest.mark.parametrize(
    ("dtype", "stored", "expected"),
    [
        # By hand: K = 8, the 1 of alpha is bit 7. y + co - cg, y + cg, y - co - cg; alpha 0b1111111 -> 0b11111111.
        ("i1", [100, 20, 10, -1], [110, 110, 70, 255]),
        # K = 4: all numbers are fifteenths; alpha 0b010 -> 0b0100, the last bit twice.
        ("i1", [7, 2, 1, 0b1010], [136, 136, 68, 68]),
        ("<i2", [100, -20, 10, 0b1000_0001], [70 * 257, 110 * 257, 110 * 257, 3 * 257]),
    ],
)
def test_the_filter_of_colours_is_undone(dtype: str, stored: list[int], expected: list[int]) -> None:
    encoder = pytest.importorskip("meshoptimizer.encoder", reason="meshoptimizer is not installed")
    rows = np.array([stored], dtype=dtype)
    extension = {"count": 1, "byteStride": rows.nbytes, "mode": "ATTRIBUTES", "filter": "COLOR"}
    data = bytes(encoder.encode_vertex_buffer(rows.view(np.uint8), 1, rows.nbytes))
    found = np.frombuffer(compression.decode_meshopt("here", extension, data), dtype=dtype.replace("i", "u"))
    assert found.tolist() == expected


def test_broken_meshopt_is_refused(tmp_path: Path) -> None:
    good, rng = meshopt(), np.random.default_rng(4)
    numbers = {
        "count": (-1, 0, 10**6, 10**12), "byteStride": (0, 3, 16, 260, -4), "byteOffset": (-1, 10**9), "byteLength": (0, 7, 10**9),
        "mode": ("NONE", "INDICES", 3), "filter": ("OCTAHEDRAL", "QUATERNION", "SHARP"),
    }  # fmt: skip
    for key, values in numbers.items():
        for value in values:
            bent = Gltf()
            bent.document, bent.chunk = json.loads(json.dumps(good.document)), good.chunk
            bent.document["bufferViews"][0]["extensions"][compression.MESHOPT[0]][key] = value
            assert refused(bent.write(tmp_path / "odd.glb")), (key, value)
    for _ in range(200):
        bent = Gltf()
        bent.document, data = good.document, bytearray(good.chunk)
        for at in rng.integers(0, len(data), 8):
            data[at] = rng.integers(256)
        bent.chunk = bytes(data)
        refused(bent.write(tmp_path / "bent.glb"))


def test_ktx2_textures_name_what_converts_them(tmp_path: Path) -> None:
    gltf = plain()
    gltf.document |= {
        "textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}],
        "images": [{"uri": "a.ktx2", "mimeType": "image/ktx2"}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}}],
        "extensionsRequired": ["KHR_texture_basisu"],
    }
    gltf.document["meshes"][0]["primitives"][0]["material"] = 0
    (warning,) = load_mesh(gltf.write(tmp_path / "a.glb"), [tmp_path]).warnings
    assert "KTX2" in warning and "ktxdecompress" in warning
