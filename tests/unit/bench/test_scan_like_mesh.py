"""Scan-like meshes: the requested number of triangles, no cracks, one texture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.description.shapes import Shape
from gibson_sim.errors import SceneError
from gibson_sim.formats.glb import Z_UP_TO_Y_UP, GlbBuilder
from gibson_sim.formats.light_maps import light_map_png
from gibson_sim.formats.load_mesh import load_mesh, primitive_mesh
from gibson_sim.formats.mesh import MeshPart, area_normals
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.render.culling.closed_surfaces import find_closed_surfaces
from gibson_sim.scenes.load import load_scene
from gibson_sim_bench.memory import drift, growth
from gibson_sim_bench.scenes.scan_like_mesh import make_scan_like_mesh, subdivided, without_closed_surfaces
from gibson_sim_tools.making.pixels import tone_map

CORNERS = np.array([[0.0, 0, 0], [4, 0, 0], [4, 1, 0], [0, 1, 0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def _area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.cross(b - a, c - a)[:, 2].sum() / 2)


def test_subdivided_surfaces_keep_their_area_their_side_and_their_texture() -> None:
    vertices, uvs, triangles = subdivided(CORNERS, CORNERS[:, :2] / 4, TRIANGLES, 500)
    assert len(triangles) >= 500
    assert _area(vertices, triangles) == pytest.approx(4.0)
    np.testing.assert_allclose(uvs, vertices[:, :2] / 4, atol=1e-12)


def test_subdivided_surfaces_have_no_cracks_where_corners_are_stored_twice() -> None:
    split = CORNERS[[0, 1, 2, 0, 2, 3]]
    vertices, _, triangles = subdivided(split, split[:, :2], np.arange(6).reshape(2, 3), 300)
    where = np.unique(np.rint(vertices * 1e6), axis=0, return_inverse=True)[1].reshape(-1)[triangles]
    edges = np.sort(where[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    ends = np.unique(np.rint(vertices * 1e6), axis=0)[unique] / 1e6
    rim = ((ends[:, :, 0] == 0) | (ends[:, :, 0] == 4)).all(axis=1) | ((ends[:, :, 1] == 0) | (ends[:, :, 1] == 1)).all(axis=1)
    assert set(uses[~rim].tolist()) == {2}


def test_enough_triangles_stay_unchanged() -> None:
    assert subdivided(CORNERS, CORNERS[:, :2], TRIANGLES, 2)[2] is TRIANGLES


def _scene(folder: Path, uv: float) -> Path:
    cv2.imwrite(str(folder / "red.png"), np.full((8, 8, 3), (0, 0, 255), dtype=np.uint8))
    (folder / "a.mtl").write_text("newmtl red\nKd 1 1 1\nmap_Kd red.png\nnewmtl green\nKd 0 1 0\n")
    (folder / "a.obj").write_text(
        "mtllib a.mtl\nusemtl red\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 0 4 2\nv 4 4 2\n"
        f"vt 0 0\nvt {uv} 0\nvt {uv} 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nusemtl green\nf 4/1 3/1 6/1\nf 4/1 6/1 5/1\n"
    )
    (folder / "scene.yaml").write_text("name: two\nfloor_z: 0.0\nobjects:\n- {name: a, mesh: a.obj, semantic_class: wall}\n")
    return folder


def test_a_scan_is_one_uneven_mesh_with_one_texture_that_shows_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "from").mkdir()
    (tmp_path / "to").mkdir()
    made = make_scan_like_mesh(load_scene(_scene(tmp_path / "from", 1.0)), 400, tmp_path / "to")
    scan = load_scene(tmp_path / "to")
    (part,) = load_mesh(Path(scan.visuals[0].shape.mesh), [tmp_path / "to"]).parts
    assert len(scan.visuals) == 1
    assert len(part.triangles) == made >= 400
    floor = part.vertices[:, 1] < 3.9
    assert 0.0005 < float(part.vertices[floor, 2].std()) < 0.01
    pixels, uvs = part.material.texture.pixels, part.uvs
    rows, columns = (uvs[:, 1] * pixels.shape[0]).astype(int), (uvs[:, 0] * pixels.shape[1]).astype(int)
    seen = pixels[rows.clip(0, pixels.shape[0] - 1), columns.clip(0, pixels.shape[1] - 1)]
    assert (seen[floor].mean(axis=0) > (200, -1, -1)).all()
    assert seen[part.vertices[:, 2] > 1.0].mean(axis=0)[1] > 200


def test_a_repeated_texture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="repeated"):
        make_scan_like_mesh(load_scene(_scene(tmp_path, 3.0)), 400, tmp_path)


def test_a_repeated_texture_below_a_light_map_is_drawn_with_its_light(tmp_path: Path) -> None:
    builder = GlbBuilder()
    ok, picture = cv2.imencode(".png", np.full((8, 8, 3), (40, 100, 200), dtype=np.uint8))
    assert ok
    radiance = np.repeat(np.array([[[0.2] * 3] * 4, [[0.8] * 3] * 4]), 2, axis=0)  # changes half-way along v, as y
    base = {"baseColorTexture": {"index": builder.texture_data(picture.tobytes())}}
    material = builder.light_mapped_material(
        {"pbrMetallicRoughness": base}, builder.texture_data(light_map_png(radiance, 1.0)), 1.0
    )
    corners = CORNERS[:, :2] / (4.0, 1.0)
    attributes = {
        "POSITION": builder.attribute(CORNERS * (1.0, 4.0, 1.0), bounds=True),
        "TEXCOORD_0": builder.attribute(5.0 * corners),
        "TEXCOORD_1": builder.attribute(corners * 65535, "u2", normalized=True),
    }
    builder.primitive(attributes, builder.indices(TRIANGLES), material)
    for folder in ("from", "to"):
        (tmp_path / folder).mkdir()
    (tmp_path / "from" / "a.glb").write_bytes(builder.to_bytes("a", Z_UP_TO_Y_UP.astype(float)))
    (tmp_path / "from" / "scene.yaml").write_text(
        "name: lit\nfloor_z: 0.0\nobjects:\n- {name: a, mesh: a.glb, semantic_class: floor}\n"
    )
    make_scan_like_mesh(load_scene(tmp_path / "from"), 400, tmp_path / "to")
    (part,) = load_mesh(tmp_path / "to" / "mesh.glb", [tmp_path / "to"]).parts
    pixels, uvs = part.material.texture.pixels, part.uvs
    rows, columns = (uvs[:, 1] * pixels.shape[0]).astype(int), (uvs[:, 0] * pixels.shape[1]).astype(int)
    seen = pixels[rows.clip(0, pixels.shape[0] - 1), columns.clip(0, pixels.shape[1] - 1)].astype(int)
    color = linear_from_srgb(np.array([200, 100, 40]) / 255.0)
    for half, light in ((part.vertices[:, 1] < 1.2, 0.2), (part.vertices[:, 1] > 2.8, 0.8)):
        assert np.abs(np.median(seen[half], axis=0) - tone_map(light * color)).max() <= 4


def test_growth_and_drift_compare_the_last_third_with_the_first_after_the_warm_up() -> None:
    values = [999.0, 999.0, 999.0, *[10.0] * 3, *[0.0] * 3, *[15.0] * 3]
    assert (growth(values), drift(values)) == (5.0, 1.5)


def test_nothing_in_a_scan_is_closed() -> None:
    parts = [primitive_mesh(Shape("box", (0.4, 0.4, 0.4))).parts[0], primitive_mesh(Shape("sphere", (0.3, 0.0, 0.0))).parts[0]]
    vertices = np.concatenate([parts[0].vertices, parts[1].vertices + np.float32(2.0)]).astype(np.float64)
    triangles = np.concatenate([parts[0].triangles, parts[1].triangles + len(parts[0].vertices)]).astype(np.int64)
    vertices, triangles = (
        np.vstack([vertices, CORNERS - 3.0]),
        np.vstack([triangles, TRIANGLES + len(vertices)]),
    )  # a floor is open
    left = without_closed_surfaces(vertices, triangles)
    assert len(left) == len(triangles) - 2
    gone = vertices[np.array([t for t in triangles.tolist() if t not in left.tolist()])]
    assert sorted(gone[:, :, 2].mean(axis=1).tolist()) == pytest.approx([-0.2, 1.7], abs=0.01)
    scan = MeshPart(vertices.astype(np.float32), area_normals(vertices, left).astype(np.float32), None, left.astype(np.uint32))
    assert not len(find_closed_surfaces([scan], [True]).boxes)
