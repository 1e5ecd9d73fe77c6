"""Atlas packing, seam levelling and the texturing pipeline, against known answers."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from gibson_sim.cli.main import main
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.scenes.load import load_scene
from gibson_sim_tools.scanning.posed_images import ScanError
from gibson_sim_tools.scanning.trajectories import write_trajectory_log
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, write_ply
from gibson_sim_tools.texturing.atlas import (
    add_vertex_offsets,
    blank_pages,
    build_atlas,
    copy_patches,
    face_index_pages,
    fill_padding,
    pack_rectangles,
)
from gibson_sim_tools.texturing.evaluation import image_similarity, render_textured
from gibson_sim_tools.texturing.levelling import (
    colors_along_seams,
    find_seams,
    global_levelling,
    local_levelling,
    mean_color_step,
)
from gibson_sim_tools.texturing.settings import TextureSettings
from gibson_sim_tools.texturing.surface import face_adjacency
from gibson_sim_tools.texturing.texture import texture_surface
from gibson_sim_tools.texturing.textured_scene import UNSEEN_MATERIAL, textured_mesh, write_textured_scene
from support.painted_wall import CAMERA, painted_wall, photographed, row_of_cameras

LEVEL = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def test_rectangles_do_not_overlap_and_stay_on_their_pages():
    rng = np.random.default_rng(0)
    size = rng.integers(3, 40, (200, 2))
    page, corner, pages = pack_rectangles(size, 160)
    assert len(pages) > 1
    for number, (width, height) in enumerate(pages):
        used = np.zeros((height, width), dtype=int)
        for (w, h), (x, y) in zip(size[page == number], corner[page == number], strict=True):
            assert x + w <= width <= 160 and y + h <= height <= 160
            used[y : y + h, x : x + w] += 1
        assert used.max() == 1 and used.mean() > 0.7


def test_a_patch_larger_than_a_page_is_an_error():
    with pytest.raises(ScanError, match="has 109 pixels on a side, a page at most 64"):
        build_atlas(np.zeros(1, np.int64), np.zeros(1, np.int32), np.array([[[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]]]), 64)


def two_patches(left: float, right: float, side: int = 45):
    """A square of two triangles, each with an even photograph of its own."""
    corners = np.array([[0, 0], [side - 1, 0], [side - 1, side - 1], [0, side - 1]], dtype=np.float64)[SQUARE]
    atlas = build_atlas(np.array([0, 1]), np.array([0, 1], np.int32), corners)
    pages = blank_pages(atlas)
    for number, value in enumerate((left, right)):
        copy_patches(atlas, number, np.full((side, side, 3), value, np.float32), pages)
    return atlas, pages, face_index_pages(atlas), find_seams(atlas, SQUARE, face_adjacency(SQUARE))


def test_a_patch_is_the_rectangle_of_its_photograph_with_padding():
    atlas, pages, face_maps, _ = two_patches(0.25, 0.75)
    assert atlas.size.tolist() == [[53, 53], [53, 53]] and atlas.origin.tolist() == [[-4, -4]] * 2
    assert sorted(np.unique(pages[0])) == [0.0, 0.25, 0.75]
    # The corner at pixel (44, 0) of the photograph lies at (48, 4) of the rectangle.
    x, y = atlas.corners[0, 1]
    assert (x, y) == (atlas.corner[0, 0] + 48, atlas.corner[0, 1] + 4) and face_maps[0][int(y), int(x)] == 0


def test_a_step_between_two_even_patches_is_levelled_to_its_middle():
    atlas, pages, face_maps, seams = two_patches(0.48, 0.52)
    colors = colors_along_seams(seams, atlas, pages)
    assert abs(mean_color_step(colors) - 0.04 * 255) < 0.1
    add_vertex_offsets(atlas, pages, face_maps, global_levelling(atlas, SQUARE, seams, colors))
    after = colors_along_seams(seams, atlas, pages)
    assert mean_color_step(after) < 0.5 and abs(after.mean() - 0.5) < 1e-2


def test_local_levelling_closes_the_seam_and_keeps_what_is_far_from_it():
    atlas, pages, face_maps, seams = two_patches(0.4, 0.6)
    local_levelling(seams, atlas, pages, face_maps)
    fill_padding(atlas, pages, face_maps)
    assert mean_color_step(colors_along_seams(seams, atlas, pages)) < 0.5
    # The corner opposite to the seam is 31 pixels from it; half-way into the strip the change is about half of 0.1.
    x, y = atlas.corners[0, 1].astype(int)
    assert pages[0][y, x, 0] == np.float16(0.4)
    x, y = (atlas.corners[0, 0] + atlas.corners[0, 2]).astype(int) // 2 + (7, -7)
    assert 0.43 < pages[0][y, x, 0] < 0.47


def test_a_triangle_that_covers_no_pixel_centre_is_levelled_too():
    sliver = np.array([[[10.2, 10.1], [10.4, 10.1], [10.3, 10.4]]])
    atlas = build_atlas(np.zeros(1, np.int64), np.zeros(1, np.int32), sliver)
    pages, face_maps = blank_pages(atlas), face_index_pages(atlas)
    add_vertex_offsets(atlas, pages, face_maps, np.full((1, 3, 3), 0.25, np.float32))
    x, y = np.rint(atlas.corners[0, 0]).astype(int)
    assert (pages[0][y, x] == 0.25).all() and (face_maps[0] == 0).sum() > 1


def test_padding_has_the_colour_of_the_nearest_pixel():
    atlas, pages, face_maps, _ = two_patches(0.4, 0.6)
    pages[0][face_maps[0] < 0] = 0.0
    fill_padding(atlas, pages, face_maps)
    (x, y), (w, h) = atlas.corner[1], atlas.size[1]
    assert (pages[0][y : y + h, x : x + w] == np.float16(0.6)).all()


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    """The wall from eight photographs of different exposure; its rim is in no photograph."""
    wall = painted_wall()
    poses = row_of_cameras(8, np.random.default_rng(2))
    gains = [1.0, 1.3, 0.8, 1.1, 0.75, 1.2, 0.9, 1.0]
    photographs = photographed(tmp_path_factory.mktemp("wall"), wall, poses, gains)
    return wall, photographs, texture_surface(wall.surface, photographs, TextureSettings(poses=False), held_out=[3])


def test_the_texture_is_the_paint(textured):
    _, photographs, found = textured
    assert not (found.labels == 3).any() and (found.labels >= 0).mean() > 0.5
    T = photographs.poses[3]
    rendered = render_textured(found, CAMERA, T)
    similarity = image_similarity(photographs.subset([3]), lambda _: rendered)
    assert similarity.psnr > 36.0 and similarity.ssim > 0.97 and similarity.pixels > 10_000
    assert np.abs(np.log(np.median(found.exposures.factors(np.array([1]), np.zeros(1, np.float32)) * 1.3))) < 0.1


def test_seams_vanish(textured):
    report = textured[2].report
    assert report.seam_edges > 20 and report.patches <= report.best_patches / 2 and report.quality_loss < 0.05
    assert report.edge_steps["global"] < report.edge_steps["before"] and report.edge_steps["before"] < report.seam_steps["before"]
    assert report.seam_steps["local"] < 2.0


def test_unseen_triangles_are_a_mesh_part_with_interpolated_vertex_colors(textured, tmp_path):
    wall, _, found = textured
    mesh = textured_mesh(found)
    unseen = next(part for part in mesh.parts if part.material.name == UNSEEN_MATERIAL)
    assert len(unseen.triangles) == (found.labels < 0).sum() == found.report.unseen and unseen.colors is not None
    assert unseen.colors.min() > 40 and unseen.colors.max() < 200
    scene = load_scene(write_textured_scene(found, tmp_path / "wall"))
    again = load_mesh(tmp_path / "wall" / "assets" / "wall.glb", [tmp_path])
    assert scene.name == "wall" and again.triangle_count == len(found.surface.triangles)
    page = next(part for part in again.parts if part.material.texture is not None)
    assert page.material.unlit and page.material.texture is not None
    # A vertex has the paint at its texture coordinates.
    pixels, (height, width) = page.material.texture.pixels, page.material.texture.pixels.shape[:2]
    x, y = (page.uvs * (width, height) - 0.5).round().astype(int).T
    gain = np.median(pixels[y, x] / 255.0) / np.median(wall.color_at(page.vertices))
    assert np.abs(pixels[y, x] / 255.0 - gain * wall.color_at(page.vertices)).mean() < 0.02


def test_a_surface_that_no_photograph_shows_is_an_error(tmp_path):
    photographs = photographed(tmp_path, painted_wall(), row_of_cameras(2, np.random.default_rng(0)))
    with pytest.raises(ScanError, match="no photograph shows a triangle of the mesh"):
        texture_surface(TriangleMesh(LEVEL - np.array([0.0, 0.0, 50.0]), SQUARE), photographs, TextureSettings())


def test_the_command_makes_a_scene(tmp_path, capsys):
    wall = painted_wall(10, 8)
    for folder in ("color", "depth"):
        (tmp_path / "scan" / folder).mkdir(parents=True)
    poses = row_of_cameras(3, np.random.default_rng(0))
    for k, T in enumerate(poses):
        wall.photograph(tmp_path / "scan" / "color" / f"{k}.png", T)
        cv2.imwrite(str(tmp_path / "scan" / "depth" / f"{k}.png"), np.zeros((120, 160), np.uint16))
    write_trajectory_log(tmp_path / "scan" / "trajectory.log", poses)
    values = '{"width": 160, "height": 120, "intrinsic_matrix": [140, 0, 0, 0, 140, 0, 79.5, 59.5, 1]}'
    (tmp_path / "scan" / "intrinsic.json").write_text(values)
    s = wall.surface
    write_ply(
        tmp_path / "wall.ply",
        TriangleMesh(s.vertices.astype(np.float64), s.triangles.astype(np.int64), np.full((len(s.vertices), 3), 9, np.uint8)),
    )
    paths = [str(tmp_path / name) for name in ("scan", "wall.ply", "made")]
    words = ["scene", "texture", paths[0], paths[1], "--output", paths[2], "--name", "Wall"]
    with pytest.raises(SystemExit) as end:
        main([*words, "--hold-out", "3", "--sheet", str(tmp_path / "sheet.png"), "--report", str(tmp_path / "report.json")])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert "1 held-out photograph, texture: PSNR" in said and "patches" in said and "next: gibson-sim scene check" in said
    assert load_scene(tmp_path / "made").name == "Wall"
    # A photograph, the grey mesh, the texture.
    sheet = cv2.imread(str(tmp_path / "sheet.png"))
    assert sheet.shape == (240, 960, 3) and np.abs(sheet[60:180, :320].astype(int) - sheet[60:180, 640:]).mean() < 4.0
    held_out = json.loads((tmp_path / "report.json").read_text())["held_out"]
    assert held_out["texture"]["psnr"] > held_out["colours of vertices"]["psnr"] + 10.0
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code != 0
    assert "already exists and is not empty" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--known-length", "0,2"], "0,2: must be two numbers above 0"),
        (["--known-length", "1,2", "--unit", "cm"], "--unit and --known-length both set the scale"),
        (["--most-photographs", "1"], "--most-photographs 1: must be 2 or more"),
    ],
)
def test_impossible_options_are_refused(tmp_path, capsys, words, said):
    with pytest.raises(SystemExit) as end:
        main(["scene", "texture", str(tmp_path), "wall.ply", "--output", str(tmp_path / "made"), *words])
    assert end.value.code != 0 and said in capsys.readouterr().err
