"""Occlusion culling changes no bit of any output."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Material, TextureSource
from gibson_sim.render.draw import gl_scene
from gibson_sim.render.draw.target import RenderTarget
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, SceneState
from render.drawing import BLUE, EYE, RED, box, quad, scene, state, where
from render.rooms import rooms, way

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

PLAIN = [replace(EYE, name=f"eye {k}", pose=pose, width=120, height=90, outputs=OUTPUTS) for k, pose in enumerate(way(5))]
NOW, BEFORE = (state(("a", "b"), [(1.0 + d, 1.6, 0.5), (5.0, 1.6 + d, 1.0)]) for d in (0.0, 0.05))


@pytest.fixture(scope="module")
def renderer(egl: None) -> Iterator[Renderer]:
    """The rooms at their finest, with two moving boxes and a pane."""
    visuals, loader = rooms()
    moving = box((0.0, 0.0, 0.0), RED, link="a"), box((0.0, 0.0, 0.0), BLUE, link="b")
    pane = box((3.0, 1.6, 1.0), (0.2, 0.4, 0.9, 0.4), (0.02, 2.0, 2.0))
    drawn = scene(*visuals, pane, *moving, links=("a", "b"))
    with Renderer(drawn, meshes=loader, options=RenderOptions(detail_px=0.0)) as one:
        yield one


@pytest.fixture(autouse=True)
def _few_triangles_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_scene, "_OCCLUSION_FROM", 1)


def _drawn(
    renderer: Renderer, cameras: list[CameraSpec], occlusion: bool, now: SceneState = NOW, before: SceneState = BEFORE
) -> tuple[list[Frame], int]:
    assert renderer._scene is not None
    renderer._scene._occlusion = occlusion
    frames = renderer.render(now, cameras, before)
    return frames, renderer._scene.drawn_triangles


def _assert_equal(some: list[Frame], others: list[Frame]) -> None:
    for a, b in zip(some, others, strict=True):
        for field in fields(Frame):
            if isinstance(getattr(a, field.name), np.ndarray):
                np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


def test_a_picture_is_the_same_for_fewer_triangles(renderer: Renderer) -> None:
    fewer = all_of_them = 0
    for camera in PLAIN:
        (with_it, some), (without, every) = (_drawn(renderer, [camera], on) for on in (True, False))
        _assert_equal(with_it, without)
        assert np.isfinite(without[0].depth).mean() > 0.9
        fewer, all_of_them = fewer + some, all_of_them + every
    assert 0 < fewer < 0.8 * all_of_them


def test_the_nearest_things_are_drawn_first_where_large_ones_leave_gaps(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, large_alone = _drawn(renderer, PLAIN[:1], True)
    monkeypatch.setattr(gl_scene, "_NEAR_FROM", 1)
    monkeypatch.setattr(gl_scene, "_COVERED", 1.1)
    fewer = all_of_them = 0
    for camera in PLAIN:
        (with_it, some), (without, every) = (_drawn(renderer, [camera], on) for on in (True, False))
        _assert_equal(with_it, without)
        assert some <= every
        fewer, all_of_them = fewer + some, all_of_them + every
    assert fewer < all_of_them
    assert _drawn(renderer, PLAIN[:1], True)[1] <= large_alone


def test_which_of_two_surfaces_at_one_depth_is_seen_does_not_depend_on_what_is_hidden() -> None:
    # Sheets and plates are drawn by kind, the kind with the nearest one first. The nearest one is a sheet behind the wall.
    sheet = quad([(0.0, 0.3, 0.3), (0.0, -0.3, 0.3), (0.0, -0.3, -0.3), (0.0, 0.3, -0.3)], Material(base_color=RED, unlit=True))
    pane = Material(texture=TextureSource("grey", np.full((4, 4, 3), 200, dtype=np.uint8)))
    wall = quad([(1.0, 1.0, 1.0), (1.0, -0.05, 1.0), (1.0, -0.05, -1.0), (1.0, 1.0, -1.0)], pane)
    meshes = {"/sheet": sheet, "/wall": wall}
    visuals = [VisualSpec(name, name, Shape("mesh", mesh="/sheet")) for name in ("hidden", "seen")]
    visuals.append(VisualSpec("wall", "wall", Shape("mesh", mesh="/wall")))
    visuals.append(box((0.5, 0.0, 0.0), BLUE, (1.0, 0.6, 0.6), link="block"))
    links = ("hidden", "seen", "wall", "block")
    drawn = scene(*visuals, links=links)
    now = state(links, [(1.5, 0.9, 0.0), (3.0, -0.3, 0.0), (0.0, 0.0, 0.0), (3.0, -0.3, 0.0)])
    with Renderer(drawn, meshes=lambda s: meshes[s.mesh] if s.kind == "mesh" else primitive_mesh(s)) as one:
        camera = replace(EYE, outputs=OUTPUTS)
        (with_it, some), (without, every) = (_drawn(one, [camera], on, now, now) for on in (True, False))
    _assert_equal(with_it, without)
    assert some < every
    assert where(without[0], 0).sum() > 20


def test_depth_alone_is_that_of_the_whole_picture(renderer: Renderer) -> None:
    for camera in PLAIN[:3]:
        (alone, *_), _ = _drawn(renderer, [replace(camera, outputs=("depth",))], True)
        (whole, *_), _ = _drawn(renderer, [camera], False)
        np.testing.assert_array_equal(alone.depth, whole.depth)


def test_pictures_side_by_side_hide_nothing_of_each_other(renderer: Renderer) -> None:
    cameras = [replace(camera, width=60 + 20 * k, height=90 - 10 * k) for k, camera in enumerate(PLAIN)]
    (with_it, fewer), (without, all_of_them) = (_drawn(renderer, cameras, on) for on in (True, False))
    _assert_equal(with_it, without)
    assert fewer < 0.9 * all_of_them


@pytest.mark.parametrize("change", [{"samples": 4}, {"projection": "fisheye"}, {"projection": "equirectangular", "samples": 4}])
def test_anti_aliased_and_non_pinhole_images_are_the_same(renderer: Renderer, change: dict[str, object]) -> None:
    cameras = [replace(camera, **change) for camera in PLAIN[:3]]
    _assert_equal(*(_drawn(renderer, cameras, on)[0] for on in (True, False)))


def test_pixel_centres_do_not_decide_the_occlusion_of_other_samples(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    read = gl_scene.GlScene._read_depth

    def all_hidden_if_smooth(self: gl_scene.GlScene, target: RenderTarget) -> NDArray[np.float32]:
        return read(self, target) if target.samples == 1 else np.ones((target.height, target.width), dtype=np.float32)

    # OpenGL does not read the depths of several samples: what memory held before would decide.
    monkeypatch.setattr(gl_scene.GlScene, "_read_depth", all_hidden_if_smooth)
    smooth = [replace(camera, samples=4) for camera in PLAIN]
    _assert_equal(*(_drawn(renderer, smooth, on)[0] for on in (True, False)))


def test_body_that_leaves_an_occluder_is_drawn_at_once(renderer: Renderer) -> None:
    for x in (1.0, 2.0, 2.6, 3.2):
        now = state(("a", "b"), [(x, 1.6, 0.5), (7.0 - x, 1.6, 1.0)])
        _assert_equal(*(_drawn(renderer, PLAIN[:2], on, now)[0] for on in (True, False)))


def test_scenes_of_few_triangles_are_drawn_without_occlusion_culling(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl_scene, "_OCCLUSION_FROM", 10**9)
    assert _drawn(renderer, PLAIN[:1], True)[1] == _drawn(renderer, PLAIN[:1], False)[1]
