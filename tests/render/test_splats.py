"""Gaussian splats in pictures: against a reference in double precision, and with the mesh, robots and cameras of all kinds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.splats import SH_DC, Splats, load_splats, splats_ply
from gibson_sim.geometry.compiling import CAN_COMPILE
from gibson_sim.geometry.projections import project
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.render.draw import splats as splats_module
from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions
from gibson_sim.scenes.spec import DrawnScene, LightSpec, SplatsSpec
from gibson_sim.types import CameraSpec, Frame, Output, Pose, Vec3
from render.drawing import BLUE, EYE, GREEN, box, eye_at, scene, state
from support.splat_files import random_splats
from support.splat_reference import draw_reference

BACKGROUND = (0.3, 0.5, 0.7)
ALL: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal", "normal_world", "position", "flow", "hole")


def _file(folder: Path, splats: Splats) -> SplatsSpec:
    path = folder / "splats.ply"
    path.write_bytes(splats_ply(splats))
    return SplatsSpec(str(path))


def _red(*positions: Vec3, size: float = 0.03, opacity: float = 0.98) -> Splats:
    """Returns round red splats."""
    count = len(positions)
    red = (np.array([1.0, 0.0, 0.0]) - 0.5) / SH_DC
    return Splats(
        np.array(positions, dtype=np.float32),
        np.full((count, 3), size, dtype=np.float32),
        np.tile(np.array([0, 0, 0, 1], dtype=np.float32), (count, 1)),
        np.full(count, opacity, dtype=np.float32),
        np.tile(red, (count, 1, 1)).astype(np.float32),
    )


def _draw(drawn: DrawnScene, *cameras: CameraSpec, positions: tuple[Vec3, ...] = (), cull: bool = True) -> list[Frame]:
    with Renderer(drawn, options=RenderOptions(cull=cull)) as renderer:
        return renderer.render(state(drawn.links, positions), list(cameras))


def _rgb(frame: Frame) -> NDArray[np.float64]:
    assert frame.rgb is not None
    return np.asarray(frame.rgb / 255.0)


def _psnr(found: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    return float(-10.0 * np.log10(np.square(found - true).mean()))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_five_thousand_splats_are_those_of_a_reference_in_double_precision(tmp_path: Path, degree: int) -> None:
    spec = _file(tmp_path, replace(random_splats(5000, degree, seed=degree, size=3.0)))
    camera = eye_at((-2.5, 0.2, 0.4), (0.0, 0.0, 0.0), width=64, height=48)
    (frame,) = _draw(replace(scene(light=LightSpec(background=BACKGROUND)), splats=spec), camera)
    image, left = draw_reference(load_splats(Path(spec.file)), matrix_from_pose(camera.pose), camera.intrinsics(), 64, 48)
    assert 0.0 < left.mean() < 0.9 and left.min() < 0.5  # they cover some of the picture, and not all
    assert _psnr(_rgb(frame), np.clip(image + left[..., None] * BACKGROUND, 0.0, 1.0)) > 50.0


def test_a_picture_with_any_matrix_is_that_of_the_reference(tmp_path: Path) -> None:
    spec = _file(tmp_path, random_splats(300, size=2.0))
    K = np.array([[50.0, 0.0, 20.0], [0.0, 70.0, 30.0], [0.0, 0.0, 1.0]])
    camera = eye_at((-2.5, 0.2, 0.4), (0.0, 0.0, 0.0), width=64, height=48, matrix=tuple(K.ravel()))
    (frame,) = _draw(replace(scene(light=LightSpec(background=BACKGROUND)), splats=spec), camera)
    image, left = draw_reference(load_splats(Path(spec.file)), matrix_from_pose(camera.pose), K, 64, 48)
    assert _psnr(_rgb(frame), np.clip(image + left[..., None] * BACKGROUND, 0.0, 1.0)) > 48.0


def test_culling_and_a_second_run_keep_images_bit_equal(tmp_path: Path) -> None:
    spec = _file(tmp_path, random_splats(3000, 1, size=4.0))
    drawn = replace(scene(box((1.0, 0.0, 0.0), size=(0.1, 1.5, 1.5)), box((0.0, 1.0, 0.0), BLUE)), splats=spec)
    cameras = [eye_at((-1.0, 0.3, 0.2), (1.0, 0.0, 0.0)), eye_at((0.2, -1.0, 0.5), (0.0, 1.0, 0.0), width=48, near=0.02)]
    first, again, all_of_them = _draw(drawn, *cameras), _draw(drawn, *cameras), _draw(drawn, *cameras, cull=False)
    for a, b, c in zip(first, again, all_of_them, strict=True):
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_array_equal(a.rgb, c.rgb)


@pytest.mark.parametrize(("walls", "most"), [((), 1.5), ((box((1.0, 0.0, 0.0)),), 255.0)])
def test_compiled_loops_and_opengl_blend_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walls: tuple[VisualSpec, ...], most: float
) -> None:
    spec = _file(tmp_path, random_splats(2000, size=3.0))
    drawn = replace(scene(*walls, light=LightSpec(background=BACKGROUND)), splats=spec)
    camera = eye_at((-2.0, 0.0, 0.0), (0.0, 0.1, 0.0), width=71, height=53)  # no whole tiles
    pictures = []
    for loops in (True, False):
        monkeypatch.setattr(splats_module, "CAN_COMPILE", loops and CAN_COMPILE)
        pictures.append(_rgb(_draw(drawn, camera)[0]))
    # Where a splat and a wall meet, rounding decides which is nearer.
    assert np.abs(pictures[0] - pictures[1]).max() < most / 255 and np.square(pictures[0] - pictures[1]).mean() < 1e-5


def test_cameras_side_by_side_see_what_each_sees_alone(tmp_path: Path) -> None:
    drawn = replace(scene(box((1.0, 0.0, 0.0))), splats=_file(tmp_path, random_splats(500, size=3.0)))
    cameras = [eye_at((-2.0, 0.0, 0.0), (0.0, 0.1, 0.0)), eye_at((0.0, -2.0, 0.3), (0.0, 0.1, 0.0))]
    together = _draw(drawn, *cameras)
    for camera, frame in zip(cameras, together, strict=True):
        np.testing.assert_array_equal(_draw(drawn, camera)[0].rgb, frame.rgb)


@pytest.mark.parametrize("projection", ["pinhole", "fisheye", "equirectangular"])
def test_all_other_outputs_are_those_without_splats_to_the_bit(tmp_path: Path, projection: str) -> None:
    view = {"pinhole": {}, "fisheye": {"fov": math.pi}, "equirectangular": {"width": 128}}[projection]
    camera = replace(EYE, projection=projection, outputs=ALL, **view)  # type: ignore[arg-type]
    plain = scene(box((1.5, 0.0, 0.0)), box((0.0, 0.0, 0.0), BLUE, (0.2, 0.2, 0.2), link="r"), links=("r",))
    (bare,) = _draw(plain, camera, positions=((1.0, 0.5, 0.0),))
    (full,) = _draw(replace(plain, splats=_file(tmp_path, random_splats(400, size=2.0))), camera, positions=((1.0, 0.5, 0.0),))
    for output in ALL[1:]:
        np.testing.assert_array_equal(getattr(full, output), getattr(bare, output), output)
    assert (_rgb(full) != _rgb(bare)).any()


def test_the_mesh_is_visible_where_no_splat_covers_it(tmp_path: Path) -> None:
    plain = scene(box((2.0, 0.0, 0.0), GREEN, (0.1, 9.0, 9.0)))
    (bare,) = _draw(plain, EYE)
    (full,) = _draw(replace(plain, splats=_file(tmp_path, _red((1.9, 0.9, 0.0), size=0.1))), EYE)
    # 32 / 1.9 = 16.8 px per metre: the splat is at column 31.5 - 0.9 * 16.8 = 16.3, and has a radius of 3.3 * 1.7 px.
    changed = np.argwhere((_rgb(full) != _rgb(bare)).any(axis=2))
    assert np.abs(changed.mean(axis=0) - (31.5, 16.3)).max() < 0.5 and np.ptp(changed, axis=0).max() < 13
    assert _rgb(full)[31, 16, 0] > 0.8


def test_splats_a_little_behind_a_surface_are_seen_and_those_behind_a_wall_are_not(tmp_path: Path) -> None:
    plain = scene(box((2.0, 0.0, 0.0), GREEN, (0.1, 9.0, 9.0)))  # its front is at 1.95 m
    found = {
        x: _rgb(_draw(replace(plain, splats=_file(tmp_path, _red((x, 0.0, 0.0), size=0.1))), EYE)[0])[31:33, 31:33, 0].max()
        for x in (1.9, 1.98, 2.1)
    }
    assert found[1.9] > 0.85 and found[1.98] > 0.85 and found[2.1] < 0.02


def test_a_slanted_surface_lets_through_as_much_along_its_normal(tmp_path: Path) -> None:
    # The floor, 0.5 m below the eye, at 5 m: the ray meets it at 5.7 degrees, so 3 cm below it are 0.3 m along the ray.
    plain = scene(box((5.0, 0.0, -0.55), GREEN, (20.0, 20.0, 0.1)))
    found = {}
    for z in (-0.53, -0.8):
        row = round(31.5 - 32 * z / 5.0)
        spec = _file(tmp_path, _red((5.0, 0.0, z), size=0.02))
        found[z] = _rgb(_draw(replace(plain, splats=spec), EYE)[0])[row - 1 : row + 2, 30:34, 0].max()
    assert found[-0.53] > 0.15 and found[-0.8] < 0.02


def test_moving_bodies_and_splats_occlude_each_other(tmp_path: Path) -> None:
    plain = scene(box((0.0, 0.0, 0.0), BLUE, (0.2, 1.0, 1.0), link="robot"), links=("robot",))
    drawn = replace(plain, splats=_file(tmp_path, _red((1.5, 0.0, 0.0), size=0.05)))
    red = {x: _rgb(_draw(drawn, EYE, positions=((x, 0.0, 0.0),))[0])[31:33, 31:33, 0].max() for x in (1.0, 1.39, 2.0)}
    # Its back is 0.1 m behind its middle: at 1.39 m the splat is 1 cm behind its front, and hidden; a surface of the scene would let it through.
    assert red[1.0] < 0.02 and red[1.39] < 0.02 and red[2.0] > 0.7


def test_moving_bodies_darken_nearby_splats_by_the_ambient_occlusion_of_their_boxes(tmp_path: Path) -> None:
    plain = scene(
        box((2.5, 0.0, 0.0), GREEN, (1.0, 9.0, 9.0)), box((0.0, 0.0, 0.0), BLUE, (0.2, 0.2, 0.2), link="robot"), links=("robot",)
    )
    drawn = replace(plain, splats=_file(tmp_path, _red((2.0, 0.0, 0.0), size=0.5)))
    # Pixel (31, 31) shows the wall at y = z = 0.5 px * 2 m / 32 px; the box of 0.2 m touches the wall, 0.05 m beside that point.
    at = 0.5 * 2.0 / 32
    beside, away = (
        _rgb(_draw(drawn, EYE, positions=(position,))[0])[31, 31, 0] for position in ((1.9, at + 0.15, at), (1.9, 3.0, 0.0))
    )
    # 0.05, 0.125 and 0.25 m before the wall. Edges are round with 0.07 m: the first and the last are beside an edge.
    gaps = (math.hypot(0.02, 0.12) - 0.07, 0.05, math.hypot(0.12, 0.12) - 0.07)
    taken = sum(max(1.0 - gap / height, 0.0) for gap, height in zip(gaps, (0.05, 0.125, 0.25), strict=True)) / 3.0
    assert away > 0.9 and beside / away == pytest.approx(1.0 - 0.6 * taken, abs=0.006)


def test_moving_bodies_do_not_darken_splats_before_them_or_far_away(tmp_path: Path) -> None:
    plain = scene(box((0.0, 0.0, 0.0), BLUE, (0.2, 0.2, 0.2), link="robot"), links=("robot",))
    drawn = replace(plain, splats=_file(tmp_path, _red((1.5, 0.0, 0.0), (1.9, 0.8, 0.0), size=0.05)))
    beside, away = (_rgb(_draw(drawn, EYE, positions=(position,))[0]) for position in ((1.9, 0.0, 0.0), (-3.0, 0.0, 0.0)))
    assert away[31, 31, 0] > 0.8
    np.testing.assert_array_equal(beside[..., 0], away[..., 0])


@pytest.mark.parametrize("samples", [1, 4])
def test_a_translucent_thing_that_moves_tints_the_splats_behind_it(tmp_path: Path, samples: int) -> None:
    pane = box((0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.5), (0.02, 1.0, 1.0), link="pane")
    drawn = replace(scene(pane, links=("pane",)), splats=_file(tmp_path, _red((1.5, 0.0, 0.0), size=0.1)))
    camera = replace(EYE, samples=samples)
    before, away = (_rgb(_draw(drawn, camera, positions=(at,))[0])[31, 31] for at in ((1.0, 0, 0), (-3.0, 0, 0)))
    assert away[0] > 0.8 and away[2] < 0.05
    assert 0.2 < before[0] < 0.9 * away[0] and before[2] > 0.2
    # Where there is no splat, it looks as it does without splats, and all other outputs do everywhere.
    (bare,) = _draw(replace(drawn, splats=None), camera, positions=((1.0, 0, 0),))
    (full,) = _draw(drawn, camera, positions=((1.0, 0, 0),))
    np.testing.assert_array_equal(_rgb(full)[5:10], _rgb(bare)[5:10])
    np.testing.assert_array_equal(full.depth, bare.depth)


@pytest.mark.parametrize("projection", ["fisheye", "equirectangular"])
def test_cameras_of_other_projections_see_splats_where_they_are(tmp_path: Path, projection: str) -> None:
    points = ((1.0, 0.2, 0.1), (0.3, 1.0, 0.2), (0.1, -1.0, -0.3)) + (
        ((-1.0, 0.3, 0.2),) if projection == "equirectangular" else ()
    )
    view = {"fisheye": {"fov": math.pi}, "equirectangular": {"width": 128}}[projection]
    camera = replace(EYE, projection=projection, **view)  # type: ignore[arg-type]
    (frame,) = _draw(replace(scene(), splats=_file(tmp_path, _red(*points, size=0.04))), camera)
    local = np.array(points) @ matrix_from_pose(camera.pose)[:3, :3]
    for u, v in project(local, camera)[0]:
        around = _rgb(frame)[round(v) - 5 : round(v) + 6, round(u) - 5 : round(u) + 6, 0]
        weights = around / around.sum()
        rows, columns = np.mgrid[: around.shape[0], : around.shape[1]]
        assert around.max() > 0.5
        assert abs((weights * rows).sum() - 5 + round(v) - v) < 0.6 and abs((weights * columns).sum() - 5 + round(u) - u) < 0.6


def test_smooth_edges_and_splats_go_together(tmp_path: Path) -> None:
    drawn = replace(scene(box((2.0, 0.5, 0.5), GREEN)), splats=_file(tmp_path, _red((1.0, -0.3, 0.0))))
    smooth, plain = (_rgb(_draw(drawn, replace(EYE, samples=samples))[0]) for samples in (4, 1))
    np.testing.assert_array_equal(smooth[40:], plain[40:])  # below the box
    assert (smooth != plain).any()


def test_a_pose_and_a_scale_are_those_of_the_file(tmp_path: Path) -> None:
    splats = random_splats(300, 3, size=1.0)
    pose = pose_from_xyz_rpy((2.0, 0.3, -0.2), (0.4, -0.3, 1.1))
    spec = replace(_file(tmp_path, splats), pose=pose, scale=1.5)
    (frame,) = _draw(replace(scene(light=LightSpec(background=BACKGROUND)), splats=spec), EYE)
    # The same picture by a camera in the frame of the file: the camera moves instead of the splats.
    T_file_camera = np.linalg.inv(matrix_from_pose(pose)) @ matrix_from_pose(EYE.pose)
    larger = replace(splats, positions=splats.positions * np.float32(1.5), scales=splats.scales * np.float32(1.5))
    image, left = draw_reference(larger, T_file_camera, EYE.intrinsics(), 64, 64)
    assert _psnr(_rgb(frame), np.clip(image + left[..., None] * BACKGROUND, 0.0, 1.0)) > 48.0


def test_bodies_that_come_and_go_leave_the_splats_and_other_splats_replace_them(tmp_path: Path) -> None:
    first = replace(scene(), splats=_file(tmp_path, _red((1.0, 0.0, 0.0))))
    with Renderer(first) as renderer:
        before = renderer.render(state(), [EYE])[0]
        more = replace(first, revision=2, links=("b",), visuals=(box((0.0, 0.0, 0.0), BLUE, (0.1, 0.1, 0.1), link="b"),))
        assert not renderer.update(more)
        behind = renderer.render(state(("b",), ((5.0, 2.0, 0.0),), revision=2), [EYE])[0]
        np.testing.assert_array_equal(behind.rgb[:, 25:40], before.rgb[:, 25:40])  # type: ignore[index]
        assert renderer.update(replace(first, revision=3, splats=None))
        assert _rgb(renderer.render(state(revision=3), [EYE])[0]).max() == 0.0


def test_a_changed_file_of_splats_is_reloaded(tmp_path: Path) -> None:
    first = replace(scene(), splats=_file(tmp_path, _red((1.0, 0.0, 0.0))), content_hash="old")
    with Renderer(first) as renderer:
        before = renderer.render(state(), [EYE])[0]
        _file(tmp_path, _red((1.0, 0.3, 0.0), size=0.05))
        after = replace(first, revision=2, content_hash="new")
        assert renderer.update(after)
        frame = renderer.render(state(revision=2), [EYE])[0]
    with Renderer(after) as fresh:
        np.testing.assert_array_equal(frame.rgb, fresh.render(state(revision=2), [EYE])[0].rgb)  # type: ignore[arg-type]
    assert (frame.rgb != before.rgb).any()  # type: ignore[union-attr]


def test_a_file_that_cannot_be_drawn_is_one_line(tmp_path: Path) -> None:
    spec = SplatsSpec(str(tmp_path / "none.spz"))
    with pytest.raises(SceneError, match=r"none\.spz: cannot be read"):
        Renderer(replace(scene(), splats=spec))
    inside = _file(tmp_path, _red((1.0, 0.0, 0.0)))
    with pytest.raises(SceneError, match="outside the allowed folders: /nowhere"):
        Renderer(replace(scene(), splats=inside), meshes=MeshFiles(allowed_roots=[Path("/nowhere")]))


def test_the_pose_of_a_camera_is_that_of_its_link(tmp_path: Path) -> None:
    drawn = replace(scene(links=("head",)), splats=_file(tmp_path, _red((5.0, 0.0, 0.0))))
    camera = replace(EYE, link="head", pose=Pose(quat_xyzw=EYE.pose.quat_xyzw))
    (frame,) = _draw(drawn, camera, positions=((4.0, 0.0, 0.0),))
    assert _rgb(frame)[31, 31, 0] > 0.7
