"""Holes in images are filled if the camera requests it, and nothing else in the images changes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.filling.inputs import filled_colour
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, ImageEffects, Pose
from render.drawing import EYE, box, scene, state
from support.filler_networks import generator, our_network, pipeline

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

RED, GREEN, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
LEFT, RIGHT = box((2.001, 1.25, 0.0), RED, (0.002, 2.0, 6.0)), box((2.001, -1.25, 0.0), GREEN, (0.002, 2.0, 6.0))
"""A wall 2 m ahead with a gap of 0.5 m in the middle: 32 * 0.25 / 2 = 4 pixels on each side of column 31.5."""
FILLED = replace(EYE, outputs=OUTPUTS, fill="push_pull")


@pytest.fixture(scope="module")
def renderer(egl: object) -> Iterator[Renderer]:
    with Renderer(scene(LEFT, RIGHT)) as made:
        yield made


def _see(renderer: Renderer, camera: CameraSpec) -> Frame:
    return renderer.render(state(), [camera])[0]


def test_a_gap_is_closed_with_the_colours_of_both_sides(renderer: Renderer) -> None:
    frame = _see(renderer, FILLED)
    assert (frame.hole[32, 28:36] == 1).all() and not frame.hole[32, 20:28].any() and not frame.hole[32, 36:44].any()
    left, right = frame.rgb[32, 27].astype(int), frame.rgb[32, 36].astype(int)
    gap = frame.rgb[32, 28:36].astype(int)
    # The level of 16 x 16 pixels is the first without a hole: columns 16 to 31 are red, 32 to 47 green, and between their centres,
    # 7.5 pixels from the gap's, it goes from one to the other.
    assert (np.diff(gap[:, 0]) <= 0).all() and (np.diff(gap[:, 1]) >= 0).all()
    assert np.abs(gap.mean(axis=0) - (left + right) / 2).max() < 4.0


def test_nothing_else_changes(renderer: Renderer) -> None:
    plain, filled = _see(renderer, replace(FILLED, fill="")), _see(renderer, FILLED)
    for output in OUTPUTS:
        if output != "rgb":
            assert np.array_equal(getattr(plain, output), getattr(filled, output), equal_nan=True), output
    seen = plain.hole == 0
    assert np.array_equal(plain.rgb[seen], filled.rgb[seen])
    assert np.array_equal(filled.rgb, filled_colour(plain.rgb, plain.hole))


def test_the_image_does_not_depend_on_the_other_outputs(renderer: Renderer) -> None:
    every = _see(renderer, FILLED).rgb
    assert np.array_equal(_see(renderer, replace(FILLED, outputs=("rgb",))).rgb, every)


def test_depth_is_filled_only_on_request(renderer: Renderer) -> None:
    plain, filled = _see(renderer, FILLED), _see(renderer, replace(FILLED, fill_depth=True))
    hole = plain.hole != 0
    assert np.isinf(plain.depth[hole]).all() and np.allclose(filled.depth[32, 28:36], 2.0, atol=1e-5)
    assert np.array_equal(filled.depth[~hole], plain.depth[~hole])
    assert np.isfinite(filled.position[32, 28:36]).all()
    assert np.array_equal(filled.hole, plain.hole)


def test_noise_lies_over_what_is_filled(renderer: Renderer) -> None:
    noisy = _see(renderer, replace(FILLED, effects=ImageEffects(read_noise=0.05)))
    clean = _see(renderer, FILLED)
    assert 3.0 < (noisy.rgb[30:34, 28:36].astype(float) - clean.rgb[30:34, 28:36]).std() < 60.0


def test_cameras_side_by_side_are_filled_each_for_itself(renderer: Renderer) -> None:
    back = replace(FILLED, name="back", pose=Pose(quat_xyzw=quat_from_matrix(np.diag([-1.0, -1.0, 1.0]) @ R_LINK_OPTICAL)))
    alone = _see(renderer, FILLED)
    ahead, behind = renderer.render(state(), [FILLED, back])
    assert np.array_equal(ahead.rgb, alone.rgb)
    assert (behind.hole == 1).all() and not behind.rgb.any(), "where nothing is known, nothing is made up"


@pytest.mark.parametrize("way", ["start", "tensors"])
def test_frames_that_are_read_later_and_tensors_are_filled_too(renderer: Renderer, way: str) -> None:
    expected = _see(renderer, FILLED).rgb
    found = renderer.start(state(), [FILLED]).result() if way == "start" else renderer.render_tensors(state(), [FILLED])
    assert np.array_equal(np.asarray(found[0].rgb), expected)


def test_smooth_edges_do_not_bring_the_background_into_the_hole() -> None:
    grey = replace(scene(replace(LEFT, color=GREEN), RIGHT), light=replace(scene().light, background=(1.0, 1.0, 1.0)))
    with Renderer(grey) as made:
        smooth = made.render(state(), [replace(FILLED, samples=4, width=61, height=61)])[0]
        fisheye = made.render(state(), [replace(FILLED, projection="fisheye", fov=math.pi / 2)])[0]
    for frame in (smooth, fisheye):
        row = frame.rgb[frame.camera.height // 2, 20:41]
        assert row[:, 0].max() == 0 and row[:, 2].max() == 0, "the wall and what is between is pure green"


def test_a_panorama_is_filled_across_its_edge() -> None:
    camera = replace(FILLED, pose=Pose(quat_xyzw=quat_from_matrix(np.diag([-1.0, -1.0, 1.0]) @ R_LINK_OPTICAL)), fill_depth=True)
    camera = replace(camera, projection="equirectangular", width=128, height=64)
    with Renderer(scene(LEFT, RIGHT)) as made:
        frame = _see(made, camera)
    # The gap between the red and the green wall is behind the camera: at the left and the right edge of the image.
    assert (frame.hole[32, [0, -1]] == 1).all()
    step = np.abs(frame.rgb[32, 0].astype(int) - frame.rgb[32, -1])
    assert step.max() < 60, "a step of the ramp from red to green, not the whole of it"
    assert abs(frame.depth[32, 0] - frame.depth[32, -1]) < 0.05


def test_pixels_outside_a_fisheye_stay_black_and_are_holes_to_networks(tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(pipeline())
    camera = replace(FILLED, projection="fisheye", fov=math.pi)
    with Renderer(scene(LEFT, RIGHT)) as made:
        frame = _see(made, replace(camera, fill=str(file)))
    assert (frame.hole == 3).any() and not frame.rgb[frame.hole == 3].any()


def test_a_hole_that_is_filled_is_nearer_to_the_closed_wall_than_one_that_is_not(renderer: Renderer) -> None:
    with Renderer(scene(LEFT, RIGHT, box((2.001, 0.0, 0.0), (0.5, 0.5, 0.0, 1.0), (0.002, 0.5, 6.0)))) as made:
        truth = _see(made, FILLED).rgb
    filled, plain = _see(renderer, FILLED).rgb, _see(renderer, replace(FILLED, fill="")).rgb
    assert cv2.PSNR(filled, truth) > cv2.PSNR(plain, truth) + 3.0


def test_a_missing_network_is_named(renderer: Renderer, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot read '.*nothing\.onnx': No such file"):
        renderer.prepare([replace(FILLED, fill=str(tmp_path / "nothing.onnx"))])


def test_depth_by_a_network_does_not_depend_on_the_other_outputs(renderer: Renderer, tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(our_network(depth=True))
    camera = replace(FILLED, fill=str(file), fill_depth=True)
    every = _see(renderer, camera)
    # The inverse depth of the network is 0 + 0.5 where nothing is drawn.
    assert np.allclose(every.depth[every.hole == 1], 2.0, atol=1e-5)
    assert np.array_equal(_see(renderer, replace(camera, outputs=("depth",))).depth, every.depth)
    assert np.array_equal(every.rgb, _see(renderer, FILLED).rgb), "this network returns what push-pull made"


@pytest.mark.parametrize("kind", ["push_pull", "network"])
def test_moving_links_keep_their_colours_and_fill_no_hole(kind: str, tmp_path: Path) -> None:
    network = tmp_path / "network.onnx"
    network.write_bytes(our_network(gain=0.5))
    fill = "push_pull" if kind == "push_pull" else str(network)
    arm = box(
        (1.5, 0.0, 0.0), BLUE, (0.002, 0.25, 6.0), link="arm"
    )  # 4 of the 8 columns of the gap, and 1 on either side at 1.5 m
    with Renderer(scene(LEFT, replace(RIGHT, color=RED), arm, links=("arm",))) as made:
        plain, filled = (
            made.render(state(("arm",), [(0.0, 0.0, 0.0)]), [replace(FILLED, fill=method, fill_depth=bool(method))])[0]
            for method in ("", fill)
        )
    is_arm, holes = plain.rgb[:, :, 2] > 0, plain.hole == 1
    assert is_arm[32].any() and holes[32].any() and (plain.hole[is_arm] == 0).all()
    assert np.array_equal(filled.rgb[is_arm], plain.rgb[is_arm]), "an arm is no part of the scan"
    assert not filled.rgb[holes][:, 2].any(), "the gap is as red as the wall, and not blue"
    assert np.allclose(filled.depth[32][holes[32]], 2.0, atol=1e-5), "the gap is as far as the wall"
    if kind == "network":
        assert filled.rgb[32, 26, 0] < 0.6 * plain.rgb[32, 26, 0], "the wall beside the gap is corrected"


def test_smooth_edges_do_not_cut_moving_links() -> None:
    arm = box((1.5, 0.0, 0.0), BLUE, (0.002, 0.25, 6.0), link="arm")
    camera = replace(FILLED, samples=4)
    with Renderer(scene(LEFT, RIGHT, arm, links=("arm",))) as made:
        plain, filled = (
            made.render(state(("arm",), [(0.0, 0.0, 0.0)]), [replace(camera, fill=fill)])[0] for fill in ("", "push_pull")
        )
    is_arm = plain.instance == np.bincount(plain.instance[32, 31:33]).argmax()
    assert 4 <= is_arm[32].sum() <= 8
    assert np.array_equal(filled.rgb[is_arm], plain.rgb[is_arm])


@pytest.mark.parametrize("kind", [our_network, pipeline, generator])
def test_colours_that_networks_predict_do_not_depend_on_a_moving_link_before_the_hole(kind: object, tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(kind())
    pictures = []
    for colour in (BLUE, GREEN):
        arm = box((1.5, 0.0, 0.0), colour, (0.002, 0.25, 6.0), link="arm")
        with Renderer(scene(LEFT, RIGHT, arm, links=("arm",))) as made:
            pictures.append(made.render(state(("arm",), [(0.0, 0.0, 0.0)]), [replace(FILLED, fill=str(file))])[0])
    holes = pictures[0].hole == 1
    assert holes[32].any() and np.array_equal(pictures[0].rgb[holes], pictures[1].rgb[holes])


def test_buffers_of_images_before_a_failure_are_used_again(tmp_path: Path) -> None:
    file = tmp_path / "network.onnx"
    file.write_bytes(our_network(nan=True))
    first = replace(FILLED, name="first", width=48)  # of another size, so it is drawn first, into a target of its own
    with Renderer(scene(LEFT, RIGHT)) as made:
        for _ in range(3):
            with pytest.raises(ConfigError, match=r"holes of camera 'eye', 64x64, are not filled: .*NaN"):
                made.start(state(), [first, replace(FILLED, fill=str(file))])
        assert not made._pixel_buffers._pending and len(made._pixel_buffers._free) <= 2


def test_pictures_with_a_shutter_are_filled() -> None:
    camera = replace(FILLED, link="a", effects=ImageEffects(shutter_s=0.05, readout_s=0.02))
    now, before = (state(("a",), [(0.0, y, 0.0)], stamp_ns=stamp) for y, stamp in ((0.05, 100_000_000), (0.0, 0)))
    with Renderer(scene(LEFT, RIGHT, links=("a",))) as made:
        filled, plain = (made.render(now, [one], before)[0] for one in (camera, replace(camera, fill="")))
    assert np.array_equal(filled.hole, plain.hole) and (plain.hole == 1).any()
    assert (plain.rgb[32, 10:54].max(axis=1) == 0).any() and (filled.rgb[32, 10:54].max(axis=1) > 0).all()


def test_blur_does_not_bring_the_background_into_the_image() -> None:
    camera = replace(FILLED, link="a", fill_depth=True, effects=ImageEffects(shutter_s=0.1))
    now, before = (state(("a",), [(0.0, y, 0.0)], stamp_ns=stamp) for y, stamp in ((0.4, 100_000_000), (0.0, 0)))
    blue = replace(scene(LEFT, replace(RIGHT, color=RED), links=("a",)), light=replace(scene().light, background=(0.0, 0.0, 1.0)))
    with Renderer(blue) as made:
        filled, plain, still = (
            made.render(now, [one], before)[0]
            for one in (camera, replace(camera, fill="", fill_depth=False), replace(camera, effects=ImageEffects()))
        )
    assert (plain.rgb[32, 10:54, 2] > 50).sum() > 8 and not filled.rgb[32, 10:54, 2].any(), "walls and gap are pure red"
    for output in ("depth", "hole", "semantic", "normal"):
        assert np.array_equal(getattr(filled, output), getattr(still, output)), output
