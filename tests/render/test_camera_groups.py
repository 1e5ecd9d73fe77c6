"""Many cameras in one call: each gets the image that it would get alone.

Images are not equal to the last bit: rasterisers step from the corner of the target, so the place of an image in it changes rounding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.render.draw import gl_scene
from gibson_sim.render.draw.grouping import CameraGrouping
from gibson_sim.render.renderer import Renderer, RenderOptions
from gibson_sim.types import OUTPUTS, CameraSpec, Frame
from render.drawing import BLUE, EYE, GREEN, RED, box, eye_at, scene, state
from render.rooms import rooms, way
from support.surfaces import detail_from

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

NOW, BEFORE = (state(("a/base",), [(2.0 + d, 1.4, 0.6)]) for d in (0.0, 0.04))


@pytest.fixture(scope="module")
def renderer(egl: None) -> Iterator[Renderer]:
    """The rooms and one moving box, in levels of detail."""
    visuals, loader = rooms()
    drawn = scene(*visuals, box((0.0, 0.0, 0.0), RED, link="a/base"), links=("a/base",))
    with detail_from(1), Renderer(drawn, meshes=loader) as one:
        yield one


def _mixed() -> list[CameraSpec]:
    poses = way(9)
    kinds: list[dict[str, object]] = [
        {"width": 80, "height": 60, "outputs": OUTPUTS},
        {"width": 33, "height": 71, "outputs": OUTPUTS},
        {"width": 80, "height": 60, "outputs": ("rgb", "depth")},
        {"width": 64, "height": 64, "outputs": OUTPUTS, "projection": "fisheye"},
        {"width": 80, "height": 60, "outputs": OUTPUTS, "samples": 4},
        {"width": 50, "height": 40, "outputs": ("rgb",), "samples": 4},
        {"width": 64, "height": 32, "outputs": OUTPUTS, "projection": "equirectangular", "samples": 4},
        {"width": 17, "height": 90, "outputs": ("depth", "instance")},
        {"width": 61, "height": 45, "outputs": OUTPUTS, "near": 0.2, "fov_y": 0.7, "link": "a/base"},
    ]
    return [replace(EYE, name=f"eye {k}", pose=poses[k], **kind) for k, kind in enumerate(kinds)]


ROUNDED = {"depth": 5e-5, "position": 5e-5, "normal": 1e-4, "normal_world": 1e-4, "flow": 2e-3}
"""Metres, metres, 1, 1, pixels."""


def _assert_same(some: list[Frame], others: list[Frame]) -> None:
    for a, b in zip(some, others, strict=True):
        assert a.camera == b.camera
        np.testing.assert_array_equal(a.T_world_camera, b.T_world_camera)
        edges = np.zeros((a.camera.height, a.camera.width), dtype=bool)
        for name in OUTPUTS:
            x, y = getattr(a, name), getattr(b, name)
            assert (x is None) == (y is None) == (name not in a.camera.outputs)
            if x is None:
                continue
            what = f"{a.camera.name}: {name}"
            away = ~np.isclose(x, y, rtol=0.0, atol=ROUNDED.get(name, 0.0), equal_nan=True)
            if name == "rgb":
                # At the border of two texels or mip levels rounding decides.
                assert np.abs(x.astype(int) - y).mean() < 0.05, what
                away = np.abs(x.astype(int) - y) > 2
            edges |= away.reshape(*edges.shape, -1).any(axis=2)
        assert edges.mean() < 0.005, a.camera.name


@pytest.mark.parametrize("occlusion_from", [1, 10**9])
def test_cameras_of_all_kinds_together_see_what_each_sees_alone(
    renderer: Renderer, monkeypatch: pytest.MonkeyPatch, occlusion_from: int
) -> None:
    monkeypatch.setattr(gl_scene, "_OCCLUSION_FROM", occlusion_from)
    cameras = _mixed()
    together = renderer.render(NOW, cameras, BEFORE)
    alone = [renderer.render(NOW, [camera], BEFORE)[0] for camera in cameras]
    _assert_same(together, alone)
    # They must not be equal because they are empty.
    seen = [frame.depth for frame in alone if frame.depth is not None and frame.camera.projection == "pinhole"]
    assert all(np.isfinite(depth).mean() > 0.5 for depth in seen)
    assert len({frame.depth.tobytes() for frame in alone if frame.depth is not None}) == 8


def test_without_shared_targets_the_bits_of_an_image_do_not_depend_on_other_cameras(egl: None) -> None:
    visuals, loader = rooms()
    drawn = scene(*visuals, box((0.0, 0.0, 0.0), RED, link="a/base"), links=("a/base",))
    cameras = _mixed()
    with detail_from(1), Renderer(drawn, meshes=loader, options=RenderOptions(share_targets=False)) as one:
        together = one.render(NOW, cameras, BEFORE)
        for camera, frame in zip(cameras, together, strict=True):
            (alone,) = one.render(NOW, [camera], BEFORE)
            for name in camera.outputs:
                np.testing.assert_array_equal(getattr(frame, name), getattr(alone, name), err_msg=f"{camera.name}: {name}")


def test_the_order_of_cameras_does_not_matter(renderer: Renderer) -> None:
    cameras = _mixed()
    _assert_same(renderer.render(NOW, cameras[::-1], BEFORE)[::-1], renderer.render(NOW, cameras, BEFORE))


def test_sixty_four_small_views_are_each_their_own() -> None:
    # Each looks at its own box, 2 m ahead: it sees that box's number, 1.5 m away, and nothing beside it.
    boxes = [
        replace(box((2.0, 5.0 * k, 0.0), (RED, GREEN, BLUE)[k % 3], (1.0, 1.0, 0.5 + 0.02 * k)), name=f"box {k}")
        for k in range(64)
    ]
    cameras = [
        replace(eye_at((0.0, 5.0 * k, 0.0), width=32, height=32), name=f"eye {k}", outputs=("rgb", "depth", "instance"))
        for k in range(64)
    ]
    with Renderer(scene(*boxes)) as one:
        frames = one.render(state(), cameras)
        assert frames[17].camera.name == "eye 17"
        _assert_same([frames[5], frames[63]], one.render(state(), [cameras[5], cameras[63]]))
    for k, frame in enumerate(frames):
        assert set(np.unique(frame.instance).tolist()) == {0, k + 1}
        np.testing.assert_allclose(frame.depth[np.isfinite(frame.depth)], 1.5, atol=1e-4)
        assert int(frame.rgb[16, 16].argmax()) == k % 3
        # Height of the front in rows: 16 px of focal length over 1.5 m.
        assert (frame.instance[:, 16] > 0).sum() == pytest.approx((0.5 + 0.02 * k) * 16 / 1.5, abs=1.0)


def test_a_camera_without_colours_beside_one_with_colours(renderer: Renderer) -> None:
    poses = way(3)
    shape = replace(EYE, width=60, height=60)
    one = replace(shape, name="one", pose=poses[0], outputs=("depth", "semantic"))
    other = replace(shape, name="other", pose=poses[1], outputs=("rgb", "depth", "semantic"))
    first, second = renderer.render(NOW, [one, other])
    assert first.rgb is None
    _assert_same([first, second], [renderer.render(NOW, [camera])[0] for camera in (one, other)])
    full = renderer.render(NOW, [replace(one, outputs=OUTPUTS)])[0]
    np.testing.assert_array_equal(first.depth, full.depth)
    np.testing.assert_array_equal(first.semantic, full.semantic)


def test_more_views_than_one_target_holds_come_in_several(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = [replace(EYE, name=f"eye {k}", pose=pose, width=40, height=30, outputs=OUTPUTS) for k, pose in enumerate(way(7))]
    expected = renderer.render(NOW, cameras, BEFORE)
    assert renderer._camera_images is not None
    monkeypatch.setattr(renderer._camera_images, "_largest", 64)
    monkeypatch.setattr(renderer._camera_images, "groups", CameraGrouping(64).of)
    targets: list[int] = []
    renderer.draw(NOW, cameras, BEFORE, lambda target, images, numbers: targets.append(len(numbers)))
    assert len(targets) > 2 and sum(targets) == 7
    _assert_same(renderer.render(NOW, cameras, BEFORE), expected)


def test_two_cameras_at_one_place_with_other_lenses(renderer: Renderer) -> None:
    pose = way(5)[2]
    wide = replace(EYE, name="wide", pose=pose, width=64, height=64, fov_y=math.pi / 2)
    # Twice the focal length on the same axis: its pixel 2 k + 0.5 is pixel k of the centre of the other.
    long = replace(wide, name="long", matrix=(64.0, 0.0, 31.5, 0.0, 64.0, 31.5, 0.0, 0.0, 1.0))
    a, b = renderer.render(NOW, [wide, long])
    middle = a.depth[16:48, 16:48]
    around = [b.depth[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    near, far = np.min(around, axis=0), np.max(around, axis=0)
    smooth = far - near < 0.02 * near
    assert smooth.mean() > 0.5
    np.testing.assert_allclose(middle[smooth], np.mean(around, axis=0)[smooth], rtol=0.02)
