"""Finished scenes, from Blender's bake to a folder that loads. Only the last test needs Blender."""

from __future__ import annotations

import importlib.util
import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.formats.light_maps import WHITE, radiance_of
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.picture_files import write_picture
from gibson_sim.render.draw.environment import irradiance, load_environment
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools import package_path
from gibson_sim_tools.making.baking import check_blender, make_scene, work_folder
from gibson_sim_tools.making.blender.appearances import APPEARANCES
from gibson_sim_tools.making.blender.assembly import assemble
from gibson_sim_tools.making.blender.charts import BORDER_PX, chart_map, outset_corners, place_charts
from gibson_sim_tools.making.blender.furniture import BUILDERS, build_piece
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, Surface
from gibson_sim_tools.making.blender.shell import build_shell, offset_polygon
from gibson_sim_tools.making.building import (
    MATERIALS,
    QUALITIES,
    Body,
    Building,
    Lamp,
    Opening,
    Piece,
    Quality,
    Room,
    Start,
    Storey,
    Wall,
    read_plan,
    write_plan,
)
from gibson_sim_tools.making.catalogue import CATALOGUE
from gibson_sim_tools.making.light_maps import dilate_charts, sample_light, smooth_small_charts, stitch_seams, write_light
from gibson_sim_tools.making.pictures import write_surroundings
from gibson_sim_tools.making.pixels import (
    exposure_factors,
    fill_gaps,
    fill_gaps_mirrored,
    hidden_texels,
    limit_outliers,
    median_filtered,
    tone_map,
)
from gibson_sim_tools.making.planning.planner import plan_building
from gibson_sim_tools.making.scene_folder import (
    MAX_SCENE_BYTES,
    BakedMaterial,
    Patch,
    write_glb,
    write_scene_folder,
)

ABOVE = {"kitchen_sink", "basin", "bath"}
"""Their taps stand out above them."""
BELOW = {"coat_rack"}
"""Coats hang from it."""


def two_rooms() -> Building:
    living = Room("living", "living", ((0, 0), (3, 0), (3, 2.5), (0, 2.5)))
    bath = Room("bath", "bathroom", ((3, 0), (5, 0), (5, 2.5), (3, 2.5)), "tile_grey", "tile_white")
    walls = (
        Wall((0, 0), (3, 0), 0.2, 2.4, "living", "", (Opening("window", 1.5, 1.0, 0.9, 1.2),)),
        Wall((3, 0), (5, 0), 0.2, 2.4, "bath", ""),
        Wall((5, 0), (5, 2.5), 0.2, 2.4, "bath", ""),
        Wall((5, 2.5), (3, 2.5), 0.2, 2.4, "bath", ""),
        Wall((3, 2.5), (0, 2.5), 0.2, 2.4, "living", ""),
        Wall((0, 2.5), (0, 0), 0.2, 2.4, "living", ""),
        Wall((3, 0), (3, 2.5), 0.1, 2.4, "living", "bath", (Opening("door", 1.2, 0.8, 0.0, 2.0),)),
    )
    pieces = (
        Piece("table", "coffee_table", 0, "living", (1.2, 1.2, 0.0), 0.0, (0.6, 1.0, 0.4), 1),
        Piece("lamp", "ceiling_lamp", 0, "bath", (4.0, 1.2, 2.3), 0.0, (0.3, 0.3, 0.1), 1),
    )
    lamps = (Lamp("ceiling", (4.0, 1.2, 2.28), 30.0),)
    storey = Storey(0.0, 2.4, (living, bath), walls)
    bodies = (Body("mug", "mug", (1.2, 1.2, 0.4), 0.5),)
    return Building("two_rooms", "flat", 3, (storey,), pieces, bodies, lamps, (Start("door", (2.4, 0.6, 0.0), 1.5),))


@pytest.mark.parametrize("kind", sorted(CATALOGUE))
def test_a_piece_fills_its_size_and_no_more(kind: str) -> None:
    entry = CATALOGUE[kind]
    size = (sum(entry.depth) / 2, sum(entry.width) / 2, sum(entry.height) / 2)
    solid = build_piece(kind, size, 5)
    points = np.concatenate([part.vertices[part.triangles].reshape(-1, 3) for part in solid.parts])
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]), np.array([size[0] / 2, size[1] / 2, size[2]])
    slack = np.full(3, 0.035)
    assert (points.min(axis=0) > low - slack).all() or kind in BELOW
    assert (points.max(axis=0) < high + slack).all() or kind in ABOVE
    assert 40 < sum(len(part.triangles) for part in solid.parts) < 15_000
    assert solid.boxes


def test_every_kind_of_the_catalogue_and_every_material_can_be_made() -> None:
    assert set(BUILDERS) == set(CATALOGUE)
    assert set(MATERIALS) <= set(APPEARANCES)


def test_the_same_seed_gives_the_same_piece_and_another_gives_another() -> None:
    first, again, other = (build_piece("bookshelf", (0.3, 1.0, 1.9), seed) for seed in (1, 1, 2))
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(first.parts, again.parts, strict=True))
    assert len(other.parts) != len(first.parts)


def test_the_faces_of_all_shapes_look_outwards() -> None:
    solid, plain = ObjectBuilder(np.random.default_rng(0)), Surface("plain")
    parts = {
        "chamfered box": solid.box((0, 0, 0), (1, 2, 3), plain),
        "sharp box": solid.box((0, 0, 0), (1, 2, 3), plain, 0.0),
        "cushion": solid.cushion((0, 0, 0), (1, 2, 3), plain),
        "tube": solid.tube([(0, 0, 0), (0, 0, 1), (1, 0, 1.5)], 0.1, plain),
        "lathe": solid.lathe((0, 0, 0), [(0, 0), (1, 0), (1, 1), (0, 1)], plain),
    }
    for name, part in parts.items():
        corners = part.vertices[part.triangles]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        assert volume > 0.04, name


def test_light_on_a_narrow_chart_is_evened_out_and_leaves_its_neighbours_alone() -> None:
    light = np.ones((40, 80, 4), dtype=np.float32)
    light[5:9, 5:65:2, :3] = 3.0
    before = light.copy()
    smooth_small_charts(light, np.array([[5, 5, 60, 4], [5, 12, 60, 26]]))
    assert light[6, 15:55, 0].std() < 0.05 and light[6, 15:55, 0].mean() == pytest.approx(2.0, abs=0.05)
    assert np.array_equal(light[9:], before[9:]) and np.array_equal(light[:5], before[:5])


def test_walls_end_at_the_inner_corners_and_leave_their_openings_free() -> None:
    things = {thing.name: thing for thing in build_shell(two_rooms())}
    window_wall = things["wall_0"].solid
    inner = next(p for p in window_wall.parts if p.surface.material == "plaster")
    assert inner.vertices[:, 0].min() == pytest.approx(0.1)
    assert inner.vertices[:, 0].max() == pytest.approx(2.95)
    assert np.ptp(inner.vertices[:, 1]) == pytest.approx(0.0)
    holes = [(low, high) for low, high in window_wall.boxes if low[0] < 1.5 < high[0] and low[2] < 1.5 < high[2]]
    assert not holes
    floor = things["floor_living"].solid.parts[0].vertices
    assert floor[:, 0].max() == pytest.approx(2.95) and floor[:, 1].max() == pytest.approx(2.4)


def test_a_wall_that_is_not_axis_aligned_is_refused() -> None:
    building = two_rooms()
    askew = Wall((0, 0), (3, 1), 0.2, 2.4, "living", "")
    storey = Storey(0.0, 2.4, building.storeys[0].rooms, (askew,))
    with pytest.raises(SceneError, match="along x or along y"):
        build_shell(Building("x", "flat", 1, (storey,), (), (), (), ()))


def test_charts_do_not_overlap_and_are_padded() -> None:
    rng = np.random.default_rng(2)
    placed = place_charts(rng.uniform(0.0, 1.5, (300, 2)), np.ones(300), 2, 512)
    used = np.zeros((2, 512, 512), dtype=int)
    for k in range(300):
        (x, y), (w, h) = placed.low_px[k], placed.size_px[k]
        assert min(w, h) >= 2
        assert x >= BORDER_PX and y >= BORDER_PX and x + w + BORDER_PX <= 512 and y + h + BORDER_PX <= 512
        used[placed.atlas[k], y - BORDER_PX : y + h + BORDER_PX, x - BORDER_PX : x + w + BORDER_PX] += 1
    assert used.max() == 1
    assert BORDER_PX >= 2


def test_a_building_is_lit_by_texels_of_its_own_charts_alone() -> None:
    assembly = assemble(two_rooms(), 1, 256)
    charts, lit = chart_map(assembly.charts, 0, 256), assembly.atlas == 0
    pixels = assembly.uv[lit] * 256 - 0.5
    low, high = np.floor(pixels + 1e-6).astype(int), np.ceil(pixels - 1e-6).astype(int)
    owners = np.stack([charts[rows[..., 1], columns[..., 0]] for rows in (low, high) for columns in (low, high)], axis=-1)
    assert (owners >= 0).all()
    assert (owners == owners[:, :1, :1]).all()
    # The bake meets the centres of the outermost texels.
    enlarged = outset_corners(assembly.uv[lit], assembly.charts, 0, 256) * 256 - 0.5
    assert 0.02 < np.abs(enlarged - pixels).max() < 0.04
    assert (np.abs(enlarged - pixels) < 0.04).all()


def test_charts_that_do_not_fit_are_refused() -> None:
    with pytest.raises(SceneError, match="do not fit"):
        place_charts(np.ones((5000, 2)), np.ones(5000), 1, 64)


def test_gaps_get_the_colour_of_the_chart_beside_them() -> None:
    image = np.zeros((8, 8, 3), dtype=np.float32)
    image[:, :3], image[:, 5:] = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    covered = np.ones((8, 8), dtype=bool)
    covered[:, 3:5] = False
    result = fill_gaps(image, covered)
    assert np.allclose(result[:, 3], (1, 0, 0)) and np.allclose(result[:, 4], (0, 0, 1))


def test_texels_inside_solids_and_beside_the_openings_of_gaps_are_hidden() -> None:
    covered = np.ones((5, 14), dtype=bool)
    inside, near = np.zeros_like(covered), np.zeros_like(covered)
    inside[:, 0:3], near[:, 5:11] = True, True
    near[1, 13] = True
    hidden = hidden_texels(inside, near, covered)
    # Deep in a gap, the darkness is seen; texels deep inside are never seen.
    assert np.flatnonzero(hidden[3]).tolist() == [1, 2, 5, 6, 9, 10]
    assert hidden[1, 13] and not hidden_texels(inside, near, np.zeros_like(covered)).any()


def test_the_median_removes_noise_and_keeps_the_edge_of_a_half_covered_row() -> None:
    image = np.zeros((7, 9, 1), dtype=np.float32)
    image[3], image[4:] = 0.6, 1.0
    noisy = image.copy()
    noisy[3, 4], noisy[1, 2] = 0.95, 0.8
    assert np.array_equal(median_filtered(noisy), image)


def test_a_single_bright_pixel_is_dimmed_and_the_edge_of_a_sun_patch_is_kept() -> None:
    image = np.ones((8, 12, 1), dtype=np.float32)
    image[:, 8:] = 9.0
    noisy = image.copy()
    noisy[4, 3] = 40.0
    limited = limit_outliers(noisy)
    assert limited[4, 3, 0] == pytest.approx(3.0)
    limited[4, 3] = 1.0
    assert np.array_equal(limited, image)


def test_gaps_show_their_surroundings_mirrored_at_their_edges() -> None:
    image = np.arange(20, dtype=np.float32)[None, :, None].repeat(3, axis=0)
    covered = np.ones((3, 20), dtype=bool)
    covered[:, 8:12] = False
    result = fill_gaps_mirrored(image, covered)[1, :, 0]
    assert result[:8].tolist() == image[1, :8, 0].tolist()
    assert result[8:12].tolist() == [6.0, 5.0, 14.0, 13.0]


def test_a_gap_without_anything_near_is_filled() -> None:
    image, covered = np.full((64, 64, 1), 3.0, dtype=np.float32), np.zeros((64, 64), dtype=bool)
    covered[:4, :4] = True
    assert fill_gaps_mirrored(image * covered[..., None], covered)[60, 60, 0] == pytest.approx(3.0)


def test_light_baked_on_an_upper_floor_is_not_occluded_by_the_lid_of_the_lower() -> None:
    things = build_shell(plan_building("house", 0))
    lids = [thing.solid.parts[0].vertices[:, 2] for thing in things if thing.name.startswith("lid")]
    heights = [thing.solid.parts[0].vertices[:, 2] for thing in things if thing.name.startswith(("floor", "ceiling"))]
    assert len(lids) == 2
    assert sorted(z.min() > np.max(np.concatenate(heights)) or z.max() < np.min(np.concatenate(heights)) for z in lids) == [
        True,
        True,
    ]


def test_the_boxes_of_a_floor_with_six_corners_reach_below_its_walls_all_around() -> None:
    corners = np.array([(0, 0), (4, 0), (4, 2), (2, 2), (2, 3), (0, 3)], dtype=float)
    expected = [(-0.1, -0.1), (4.1, -0.1), (4.1, 2.1), (2.1, 2.1), (2.1, 3.1), (-0.1, 3.1)]
    np.testing.assert_allclose(offset_polygon(corners, 0.1), expected)


def test_the_light_is_equal_on_both_sides_of_a_seam_and_hardly_changes_elsewhere() -> None:
    # Two squares of a plane in two charts, the second lies on its side.
    square = np.array([[(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 0, 0), (1, 1, 0), (0, 1, 0)]], dtype=float)
    corners = np.concatenate([square, square + np.array([1.0, 0.0, 0.0])])
    charts = np.array([[0, 2, 2, 21, 21], [0, 30, 2, 21, 21]])
    local = square[..., :2] * 20 + 2.5
    turned = np.stack([local[..., 1] + 28.0, 25.0 - local[..., 0]], axis=-1)
    uv = np.concatenate([local, turned]) / 64
    light = np.ones((64, 64, 4), dtype=np.float32)
    light[:, 28:, :3] = 2.0
    atlas = np.zeros(4, dtype=int)
    assert stitch_seams([light], corners, atlas, uv, charts) == 1
    t = np.linspace(0, 1, 9)[:, None]
    left = sample_light(light, uv[0, 1] * (1 - t) + uv[0, 2] * t)
    right = sample_light(light, uv[3, 0] * (1 - t) + uv[3, 2] * t)
    np.testing.assert_allclose(left, right, atol=0.02)
    np.testing.assert_allclose(left, 1.5, atol=0.1)
    assert light[12, 3, 0] == pytest.approx(1.0, abs=0.05) and light[3, 40, 0] == pytest.approx(2.0, abs=0.05)
    light[:, 28:, :3], light[:, 28:, 3] = 0.0, -1.0
    before = light.copy()
    assert stitch_seams([light], corners, atlas, uv, charts) == 1
    assert np.array_equal(light, before), "hidden texels bleed"
    edged = corners.copy()
    edged[2:] = corners[2:] @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], dtype=float) + [1.0, 0.0, -1.0]
    assert stitch_seams([light], edged, atlas, uv, charts) == 0


def test_charts_are_dilated_by_two_texels() -> None:
    light = np.zeros((16, 32, 4), dtype=np.float32)
    light[4:8, 4:10, :3], light[4:8, 14:20, :3] = 1.0, 5.0
    dilate_charts(light, np.array([[4, 4, 6, 4], [14, 4, 6, 4]]))
    assert light[5, 2:12, 0].tolist() == [1.0] * 10
    assert light[5, 12:22, 0].tolist() == [5.0] * 10
    assert light[2, 4:10, 0].tolist() == light[9, 4:10, 0].tolist() == [1.0] * 6


def test_a_light_map_holds_the_light_with_twelve_bits(tmp_path: Path) -> None:
    light = np.zeros((4, 2, 3), dtype=np.float32)
    light[0, 0], light[3, 1], light[1, 1] = (0.1, 0.5, 2.0), 5.0, 0.02
    write_light(tmp_path / "light.png", light, 4.0)
    codes = np.asarray(cv2.imread(str(tmp_path / "light.png"), cv2.IMREAD_UNCHANGED), dtype=np.uint16)[::-1, :, ::-1]
    assert (codes[codes < WHITE] % 16 == 0).all() and codes[3, 1].tolist() == [WHITE] * 3
    np.testing.assert_allclose(radiance_of(codes, 4.0)[0, 0], light[0, 0], rtol=0.01)
    assert radiance_of(codes, 4.0)[1, 1, 0] == pytest.approx(0.02, rel=0.01)


def test_tones_rise_with_light_and_grey_stays_grey() -> None:
    tones = tone_map(np.repeat(np.linspace(0, 8, 50)[:, None], 3, axis=1))
    assert tones[0].tolist() == [0, 0, 0] and tones[-1].min() >= 250
    assert (np.diff(tones[:, 0].astype(int)) >= 0).all()
    assert (tones == tones[:, :1]).all()


def test_exposure_does_not_depend_on_how_strong_the_light_is() -> None:
    sample = np.random.default_rng(1).uniform(0.2, 1.0, (500, 3)).astype(np.float32)
    assert exposure_factors([sample]) == pytest.approx(10 * exposure_factors([sample * 10]), rel=1e-4)


def test_a_plan_comes_back_from_its_file(tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.json", two_rooms(), QUALITIES["draft"])
    assert read_plan(tmp_path / "plan.json") == (two_rooms(), QUALITIES["draft"])


def test_a_file_that_is_no_plan_is_refused(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text('{"building": {}}')
    with pytest.raises(SceneError, match="is not the plan"):
        read_plan(tmp_path / "plan.json")


def test_a_quality_of_nothing_is_refused() -> None:
    with pytest.raises(SceneError, match="at least 1"):
        Quality(0, 256, 1)


def test_a_mesh_is_read_as_it_was_written(tmp_path: Path) -> None:
    corners = np.array([[[0, 0, 0], [2.0, 0, 0], [0, 1, 0.5]], [[2.0, 0, 0], [2, 1, 0.5], [0, 1, 0.5]]])
    write_glb(tmp_path / "a.glb", [Patch(BakedMaterial(color=(0.5, 0.25, 1.0, 1.0)), corners)])
    part = load_mesh(tmp_path / "a.glb", [tmp_path]).parts[0]
    assert len(part.vertices) == 4
    assert np.allclose(part.vertices[part.triangles], corners, atol=1e-4)
    assert part.material.unlit and part.material.base_color == pytest.approx((0.5, 0.25, 1.0, 1.0), abs=1e-3)


def test_a_light_mapped_mesh_keeps_its_two_sets_of_coordinates_and_its_factors(tmp_path: Path) -> None:
    corners = np.array([[[0, 0, 0], [2.0, 0, 0], [0, 1, 0.5]]])
    uv, light_uv = np.array([[[12.5, -3.25], [20.0, 0.0], [0.125, 7.0]]]), np.array([[[0.0, 0.0], [1.0, 0.25], [0.5, 1.0]]])
    material = BakedMaterial("tile.jpg", light="light.png", intensity=2.5)
    write_glb(tmp_path / "a.glb", [Patch(material, corners, uv, light_uv, np.array([[0.5, 0.25, 1.0]]))])
    write_picture(tmp_path / "tile.jpg", np.full((8, 8, 3), 200, dtype=np.uint8))
    write_light(tmp_path / "light.png", np.ones((4, 4, 3), dtype=np.float32), 2.5)
    part = load_mesh(tmp_path / "a.glb", [tmp_path]).parts[0]
    order = part.triangles[0]
    assert part.uvs is not None and part.light_uvs is not None and part.colors is not None
    np.testing.assert_allclose(part.uvs[order], uv[0] * [1, -1] + [0, 1], atol=1e-6)
    np.testing.assert_allclose(part.light_uvs[order], light_uv[0] * [1, -1] + [0, 1], atol=2e-5)
    np.testing.assert_allclose(linear_from_srgb(part.colors[0, :3] / 255.0), (0.5, 0.25, 1.0), atol=0.01)
    assert part.material.light_map is not None and part.material.light_intensity == 2.5 and part.material.unlit
    extension = _document(tmp_path / "a.glb")["materials"][0]["extensions"]["GIBSON_light_map"]
    assert extension == {"index": 1, "texCoord": 1, "intensity": 2.5}
    assert "GIBSON_light_map" not in _document(tmp_path / "a.glb")["extensionsRequired"]


def test_a_baked_building_becomes_a_scene_that_loads(tmp_path: Path) -> None:
    building, quality = two_rooms(), Quality(1, 256, 1)
    building = Building(**{f: getattr(building, f) for f in building.__dataclass_fields__} | {"bodies": ()})
    _pretend_baked(building, quality, tmp_path / "work")
    white = write_scene_folder(building, quality, tmp_path / "work", tmp_path / "scene", "a test")
    assert 0.3 < white < 1.1
    scene = load_scene(tmp_path / "scene")
    assert not scene.warnings
    assert {"wall", "floor", "ceiling", "table", "lamp", "window", "door_frame"} == {v.semantic_class for v in scene.visuals}
    assert "lid_0" not in {v.name for v in scene.visuals}
    assert scene.ground_z == 0.0 and [s.name for s in scene.starts] == ["door"]
    assert [(room.name, room.room_class, room.area) for room in scene.rooms] == [
        ("living", "living_room", 7.5),
        ("bath", "bathroom", 5.0),
    ]
    assert scene.room_at(4.0, 1.0) == scene.rooms[1]
    assert "CC0" in (tmp_path / "scene" / "LICENSE").read_text()
    document = _document(tmp_path / "scene" / "assets" / "wall_0.glb")
    assert {"tile_plaster.jpg", "light_0.png"} == {image["uri"] for image in document["images"]}
    for image in document["images"]:
        assert (tmp_path / "scene" / "assets" / image["uri"]).is_file()
    lit = [p["attributes"] for p in document["meshes"][0]["primitives"] if "TEXCOORD_1" in p["attributes"]]
    accessors = document["accessors"]
    for attributes in lit:
        assert accessors[attributes["TEXCOORD_1"]]["normalized"] and accessors[attributes["TEXCOORD_1"]]["componentType"] == 5123
    # Plaster has a tile, the skirting none; both have one colour.
    assert sorted(sorted(attributes) for attributes in lit) == [
        ["POSITION", "TEXCOORD_0", "TEXCOORD_1"],
        ["POSITION", "TEXCOORD_1"],
    ]
    factors = [m["pbrMetallicRoughness"]["baseColorFactor"] for m in document["materials"]]
    white = [*linear_from_srgb(np.array(APPEARANCES["wood_white"][1])), 1.0]
    assert any(np.allclose(factor, white, atol=1e-6) for factor in factors)
    size = sum(file.stat().st_size for file in (tmp_path / "scene").rglob("*") if file.is_file())
    assert size < MAX_SCENE_BYTES


def test_things_in_a_scene_are_lit_as_brightly_as_the_rooms_around_them(tmp_path: Path) -> None:
    building, quality = two_rooms(), Quality(1, 256, 1)
    _pretend_baked(building, quality, tmp_path / "work")
    white = write_scene_folder(building, quality, tmp_path / "work", tmp_path / "scene", "a test")
    write_surroundings(tmp_path / "scene", building, white)
    factors = irradiance(load_environment(tmp_path / "scene" / "assets" / "rooms.hdr"))
    assert (factors[0] + factors[6] / 3).mean() == pytest.approx(white, rel=0.02)


def test_a_light_map_that_was_not_baked_is_named(tmp_path: Path) -> None:
    building, quality = two_rooms(), Quality(1, 256, 1)
    _pretend_baked(building, quality, tmp_path)
    (tmp_path / "light_0.npy").unlink()
    with pytest.raises(SceneError, match="light map 0 was not baked"):
        write_scene_folder(building, quality, tmp_path, tmp_path / "scene", "a test")


def _pretend_baked(building: Building, quality: Quality, work: Path) -> None:
    work.mkdir(exist_ok=True)
    assemble(building, quality.atlases, quality.size_px).save(work / "mesh.npz")
    np.savez(work / "mirrors.npz")
    np.save(work / "light_0.npy", np.ones((quality.size_px, quality.size_px, 4), dtype=np.float32))


def _document(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    document: dict[str, Any] = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])
    return document


def test_a_finished_scene_is_made_again_only_without_resume_or_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    quality, folder = Quality(1, 256, 1), tmp_path / "scene"
    folder.mkdir()
    work = work_folder(two_rooms(), quality)
    work.mkdir(parents=True)
    (work / "finished").write_text(str(folder.resolve()))
    reports: list[str] = []

    def make(target: Path, resume: bool) -> None:
        make_scene(
            two_rooms(),
            quality,
            target,
            python="no-python",
            resume=resume,
            report=lambda text, _done, _left: reports.append(text),
        )

    make(folder, resume=True)
    assert reports == ["finished before"]
    with pytest.raises(SceneError, match="no-python"):
        make(tmp_path / "elsewhere", resume=True)
    with pytest.raises(SceneError, match="no-python"):
        make(folder, resume=False)


def test_a_python_without_blender_is_named() -> None:
    if importlib.util.find_spec("bpy") is not None:
        pytest.skip("SKIPPED: this Python has Blender")
    with pytest.raises(SceneError, match="has no Blender"):
        check_blender(sys.executable)


def test_blender_bakes_two_rooms(tmp_path: Path) -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("SKIPPED: no Blender in this Python: pip install bpy")
    write_plan(tmp_path / "plan.json", two_rooms(), Quality(1, 256, 1))
    path = package_path()
    command = [sys.executable, "-m", "gibson_sim_tools.making.blender", str(tmp_path / "plan.json"), str(tmp_path)]
    subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": path}, capture_output=True)
    light = np.load(tmp_path / "light_0.npy").astype(float)
    seen = light[..., 3] > 0
    assert 0.2 < seen.mean() < 1.0
    assert set(np.unique(light[..., 3])) == {-1.0, 0.0, 1.0}, "texels behind skirtings are hidden, those between charts empty"
    assert light[..., :3][seen].mean() > 0.01
