"""Moving links and cameras, refused arguments, and the returned arrays."""

from __future__ import annotations

import math
import os
import threading
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError, GibsonSimError, RenderError, SceneMismatchError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL
from gibson_sim.render.renderer import Renderer
from gibson_sim.render.self_test import self_test
from gibson_sim.types import CameraSpec, Pose
from render.drawing import AHEAD, BLUE, EYE, GREEN, RED, box, eye_at, middle, plate, scene, state, where

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

HALF = math.sqrt(0.5)
LEFT_TURN = (0.0, 0.0, HALF, HALF)
"""Yaw of 90 degrees: the link's x axis points to the world's +y, its y axis to -x."""
ROLL = (HALF, 0.0, 0.0, HALF)
"""Roll of 90 degrees: the link's y axis points to the world's +z, its z axis to -y."""


@pytest.mark.parametrize(
    ("quat", "offset", "expected"),
    [
        # The body is at (3, 0.5, 0.25): u = 31.5 - 32 * 0.5 / 3, v = 31.5 - 32 * 0.25 / 3.
        (LEFT_TURN, (0.5, 0.0, 0.25), (26.17, 28.83)),
        # It is at (3, -0.25, 0.5).
        (ROLL, (0.0, 0.5, 0.25), (34.17, 26.17)),
    ],
)
def test_a_part_of_a_link_follows_position_and_rotation_of_the_state(quat, offset, expected):
    part = box(offset, RED, (0.05, 0.05, 0.05), link="robot/arm")
    camera = replace(EYE, width=256, height=256)
    with Renderer(scene(part, links=("robot/arm",))) as renderer:
        frame = renderer.render(state(["robot/arm"], [(3.0, 0.0, 0.0)], [quat]), [camera])[0]
    # Four times the pixels: 4 (u + 0.5) - 0.5.
    assert middle(where(frame, 0)) == pytest.approx([4 * c + 1.5 for c in expected], abs=0.6)


def test_each_link_has_its_own_pose():
    thin = (0.002, 0.3, 0.3)
    with Renderer(scene(box((0, 0, 0), RED, thin, link="a"), box((0, 0, 0), BLUE, thin, link="b"), links=("a", "b"))) as renderer:
        frame = renderer.render(state(["a", "b"], [(3.0, 0.75, 0.0), (3.0, -0.75, 0.0)]), [EYE])[0]
    assert middle(where(frame, 0)) == pytest.approx((23.5, 31.5), abs=0.6)
    assert middle(where(frame, 2)) == pytest.approx((39.5, 31.5), abs=0.6)


def test_static_geometry_ignores_the_state():
    with Renderer(scene(plate((3.0, 0.0, 0.0), RED), links=("robot/base",))) as renderer:
        first, second = (
            renderer.render(state(["robot/base"], [p], [q]), [EYE])[0]
            for p, q in (((0, 0, 0), (0, 0, 0, 1)), ((5, 1, 2), LEFT_TURN))
        )
    np.testing.assert_array_equal(first.rgb, second.rgb)
    np.testing.assert_array_equal(first.depth, second.depth)


def test_a_camera_on_a_link_is_where_link_and_mount_put_it():
    # The link stands at (1, 2, 3) and looks along +y; the camera sits 0.2 m ahead of it and 0.5 m above.
    camera = CameraSpec("eye", "robot/base", Pose((0.2, 0.0, 0.5), AHEAD.quat_xyzw), 64, 64, math.pi / 2)
    expected = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 2.2], [0.0, -1.0, 0.0, 3.5], [0.0, 0.0, 0.0, 1.0]])
    # 4 m ahead along +y, 1 m to the right (+x), 0.5 m down: u = 31.5 + 32 / 4, v = 31.5 + 16 / 4.
    target = box((2.0, 6.2, 3.0), RED, (0.3, 0.002, 0.3))
    with Renderer(scene(target, links=("robot/base",))) as renderer:
        frame = renderer.render(state(["robot/base"], [(1.0, 2.0, 3.0)], [LEFT_TURN]), [camera])[0]
    np.testing.assert_allclose(frame.T_world_camera, expected, atol=1e-12)
    assert middle(where(frame, 0)) == pytest.approx((39.5, 35.5), abs=0.6)
    assert frame.depth[np.isfinite(frame.depth)].min() == pytest.approx(3.999, abs=1e-4)


def test_a_camera_in_the_world_has_its_pose():
    with Renderer(scene()) as renderer:
        frame = renderer.render(state(), [eye_at((1.0, 2.0, 3.0))])[0]
    np.testing.assert_allclose(frame.T_world_camera[:3, :3], R_LINK_OPTICAL, atol=1e-12)
    assert frame.T_world_camera[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_a_frame_has_the_stamp_of_the_state_and_its_camera():
    with Renderer(scene()) as renderer:
        frame = renderer.render(state(stamp_ns=123), [EYE])[0]
    assert (frame.stamp_ns, frame.camera) == (123, EYE)


def test_cameras_of_different_sizes_in_one_call_each_get_their_image():
    wide, small = replace(EYE, name="wide", width=96, height=48), replace(EYE, name="small", width=20, height=32)
    with Renderer(scene(plate((3.0, 0.0, 0.0), GREEN))) as renderer:
        first, second = renderer.render(state(), [wide, small])
        assert first.rgb.shape == (48, 96, 3)
        assert second.rgb.shape == (32, 20, 3)
        for frame, camera in ((first, wide), (second, small)):
            alone = renderer.render(state(), [camera])[0]
            np.testing.assert_array_equal(frame.rgb, alone.rgb)
            np.testing.assert_array_equal(frame.depth, alone.depth)
    assert middle(where(first, 1)) == pytest.approx((47.5, 23.5), abs=0.6)
    assert middle(where(second, 1)) == pytest.approx((9.5, 15.5), abs=0.6)


def test_more_sizes_than_are_kept_still_come_out_right():
    sizes = range(16, 16 + 2 * 12, 2)
    with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
        for _ in range(2):
            for frame, size in zip(
                renderer.render(state(), [replace(EYE, width=s, height=s) for s in sizes]), sizes, strict=True
            ):
                assert frame.depth[size // 2, size // 2] == pytest.approx(2.5, abs=1e-3)


def test_only_requested_outputs_are_returned():
    with Renderer(scene()) as renderer:
        depth, rgb = renderer.render(state(), [replace(EYE, outputs=("depth",)), replace(EYE, outputs=("rgb",))])
    assert depth.rgb is None
    assert depth.depth is not None
    assert rgb.depth is None
    assert rgb.rgb is not None


def test_no_cameras_give_no_frames():
    with Renderer(scene()) as renderer:
        assert renderer.render(state(), []) == []


def test_arrays_stay_as_they_are_when_the_next_image_is_drawn():
    with Renderer(scene(box((3.0, 0.0, 0.0), RED))) as renderer:
        frame = renderer.render(state(), [EYE])[0]
        rgb, depth = frame.rgb.copy(), frame.depth.copy()
        other = renderer.render(state(), [eye_at((2.0, 0.6, 0.0))])[0]
    assert not np.array_equal(other.rgb, rgb)
    np.testing.assert_array_equal(frame.rgb, rgb)
    np.testing.assert_array_equal(frame.depth, depth)


def test_equal_inputs_give_equal_bytes():
    drawn = scene(box((3.0, 0.0, 0.0), RED), box((2.0, 0.6, 0.3), (0.0, 0.0, 1.0, 0.5)))
    camera = eye_at((0.1, -0.2, 0.3), look_at=(3.0, 0.4, 0.1), width=97, height=61)
    frames = []
    for _ in range(2):
        with Renderer(drawn) as renderer:
            frames += [renderer.render(state(), [camera])[0] for _ in range(2)]
    assert len({(f.rgb.tobytes(), f.depth.tobytes()) for f in frames}) == 1


def test_two_renderers_side_by_side_do_not_mix():
    with Renderer(scene(plate((3.0, 0.0, 0.0), RED))) as red, Renderer(scene(plate((2.0, 0.0, 0.0), BLUE))) as blue:
        for _ in range(2):
            assert red.render(state(), [EYE])[0].depth[32, 32] == pytest.approx(2.999, abs=1e-4)
            assert where(blue.render(state(), [EYE])[0], 2).any()


def test_a_state_of_another_revision_is_refused():
    with Renderer(scene()) as renderer, pytest.raises(SceneMismatchError, match="revision 2, but revision 1 is loaded"):
        renderer.render(state(revision=2), [EYE])


def test_a_state_with_other_links_is_refused():
    with Renderer(scene(links=("a", "b"))) as renderer, pytest.raises(SceneMismatchError, match="links"):
        renderer.render(state(["b", "a"], [(0, 0, 0), (0, 0, 0)]), [EYE])


def test_a_camera_on_an_unknown_link_is_refused_by_name():
    with Renderer(scene(links=("robot/base",))) as renderer, pytest.raises(ConfigError, match=r"'eye'.*'robot/head'.*robot/base"):
        renderer.render(state(["robot/base"], [(0, 0, 0)]), [replace(EYE, link="robot/head")])


def test_an_image_too_large_for_the_driver_is_refused_and_the_next_is_drawn():
    with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
        huge = replace(EYE, width=16384, height=1)
        try:
            renderer.render(state(), [huge])
        except RenderError as e:
            assert "16384x1" in str(e)  # noqa: PT017
        assert renderer.render(state(), [EYE])[0].depth[32, 32] == pytest.approx(2.5, abs=1e-3)


def test_a_closed_renderer_refuses_to_draw():
    renderer = Renderer(scene())
    renderer.close()
    with pytest.raises(RenderError, match="closed"):
        renderer.render(state(), [EYE])


def test_closing_twice_is_fine():
    renderer = Renderer(scene(box((3.0, 0.0, 0.0))))
    renderer.render(state(), [EYE])
    renderer.close()
    renderer.close()


def test_another_thread_may_not_draw():
    errors: list[GibsonSimError] = []

    def draw_there() -> None:
        try:
            renderer.render(state(), [EYE])
        except GibsonSimError as e:
            errors.append(e)

    with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
        thread = threading.Thread(target=draw_there)
        thread.start()
        thread.join()
        assert [type(e) for e in errors] == [RenderError]
        assert "thread" in str(errors[0])
        assert renderer.render(state(), [EYE])[0].depth[32, 32] == pytest.approx(2.5, abs=1e-3)


def test_a_renderer_made_in_another_thread_draws_there():
    depths: list[float] = []

    def draw_there() -> None:
        with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
            depths.append(float(renderer.render(state(), [EYE])[0].depth[32, 32]))

    thread = threading.Thread(target=draw_there)
    thread.start()
    thread.join()
    assert depths == pytest.approx([2.5], abs=1e-3)


def test_making_and_closing_renderers_leaks_no_file_descriptors():
    def once() -> None:
        with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
            renderer.render(state(), [EYE])

    once()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(15):
        once()
    assert len(os.listdir("/proc/self/fd")) == before


def test_renderer_info_has_the_device_and_the_number_of_triangles():
    with Renderer(scene(box((3.0, 0.0, 0.0)))) as renderer:
        assert renderer.info["triangles"] == 12
        assert renderer.info["renderer"]


def test_self_test_names_the_device():
    assert self_test().startswith("pixel-exact (")


def test_a_part_of_a_rotated_link_is_lit_like_an_equally_rotated_static_part():
    quat = (0.5, 0.1, 0.7, 0.5)  # length 1: 0.25 + 0.01 + 0.49 + 0.25
    fixed, moving = box((3.0, 0.2, 0.1), quat=quat), box((0.0, 0.0, 0.0), link="robot/base")
    with Renderer(scene(fixed)) as one, Renderer(scene(moving, links=("robot/base",))) as other:
        expected = one.render(state(), [EYE])[0]
        frame = other.render(state(["robot/base"], [(3.0, 0.2, 0.1)], [quat]), [EYE])[0]
    inside = np.isfinite(expected.depth) & np.isfinite(frame.depth)
    assert inside.sum() > 100
    assert len(np.unique(expected.rgb[inside])) == 2  # two faces are seen, and their light differs
    # Rounding may give a pixel on an edge to the neighbouring face.
    differing = np.abs(frame.rgb.astype(int) - expected.rgb).max(axis=2) > 1
    assert differing.sum() <= 3
