"""Motion blur and rolling shutters in pictures: where edges are and how wide."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.formats.mesh import Material
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, ImageEffects, SceneState
from render.drawing import EYE, draw_mesh, facing_quad, loader_of, mesh_visual, quad, scene, state

pytestmark = pytest.mark.egl
# 128 x 128, focal length 64 px, on a link that moves to the left (+y) at 1 m/s; a white sheet 2 m ahead covers y > 0, left of the
# image's middle, so its edge is 32 px/s of motion away from the middle column at the stamp: things move to the right.
CAMERA = replace(EYE, link="robot/eye", width=128, height=128, outputs=("rgb", "depth", "instance"))
WHITE = Material(base_color=(1.0, 1.0, 1.0, 1.0), unlit=True)
SPEED, DISTANCE, FOCAL = 1.0, 2.0, 64.0
PX_PER_S = FOCAL * SPEED / DISTANCE


def at(seconds: float, shift: float = 0.0) -> SceneState:
    """Returns the state at a time; at 1 s the camera is at y = ``shift``."""
    y = SPEED * (seconds - 1.0) + shift
    return state(("robot/eye",), [(0.0, y, 0.0)], stamp_ns=round(seconds * 1e9))


def sheet() -> Renderer:
    """Returns a renderer of an upright sheet that covers y > 0."""
    d, h = DISTANCE, 20.0
    mesh = quad([(d, h, h), (d, 0.0, h), (d, 0.0, -h), (d, h, -h)], WHITE)
    return Renderer(scene(mesh_visual(), links=("robot/eye",)), meshes=loader_of(mesh))


def see(camera: CameraSpec = CAMERA, previous: SceneState | None = None, **effects: float) -> Frame:
    with sheet() as renderer:
        spec = replace(camera, effects=ImageEffects(**effects))  # type: ignore[arg-type]
        return renderer.render(at(1.0), [spec], previous)[0]


def light(frame: Frame) -> NDArray[np.float64]:
    """Returns linear green, (H, W)."""
    assert frame.rgb is not None
    c = frame.rgb[:, :, 1] / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def test_edge_is_where_it_should_be_without_effects() -> None:
    frame = see(previous=at(0.9))
    # The sheet ends at the middle of the image, between columns 63 and 64.
    assert np.all(light(frame)[:, 63] > 0.9) and np.all(light(frame)[:, 64] < 0.1)


def test_open_shutter_makes_an_edge_a_ramp_as_wide_as_the_motion() -> None:
    # 0.5 s at 32 px/s: 16 px. The camera was to the right of where it is, so the edge was further left: it moved from 47.5 to 63.5.
    row = light(see(previous=at(0.4), shutter_s=0.5))[64]
    assert np.all(row[:46] > 0.99) and np.all(row[66:] < 0.01)
    inside = row[49:63]
    expected = 1.0 - (np.arange(49, 63) - 47.5) / 16.0
    assert np.abs(inside - expected).max() < 0.05
    assert np.all(np.diff(row[46:66]) <= 1e-6)


def test_blur_keeps_depth_and_labels_to_the_bit() -> None:
    plain, blurred = see(previous=at(0.4)), see(previous=at(0.4), shutter_s=0.5)
    np.testing.assert_array_equal(blurred.depth, plain.depth)
    np.testing.assert_array_equal(blurred.instance, plain.instance)
    assert np.any(blurred.rgb != plain.rgb)


def test_rolling_shutter_slants_an_edge_by_the_motion_of_each_row() -> None:
    frame = see(previous=at(0.4), readout_s=0.5)
    # Row r is read 0.5 (127 - r) / 127 s before the stamp, when the edge was 16 px (127 - r) / 127 further left.
    edges = (light(frame) > 0.5).sum(axis=1)
    expected = 64.0 - 16.0 * (127 - np.arange(128)) / 127
    assert np.abs(edges - expected).max() <= 1.0
    assert edges[127] - edges[0] == pytest.approx(16, abs=1)


def test_geometry_follows_the_rows_of_a_rolling_shutter() -> None:
    frame = see(previous=at(0.4), readout_s=0.5)
    assert frame.depth is not None
    white = light(frame) > 0.5
    np.testing.assert_array_equal(np.isfinite(frame.depth), white)
    np.testing.assert_array_equal(frame.instance == 1, white)
    np.testing.assert_allclose(frame.depth[white], DISTANCE, atol=1e-4)


def test_both_together_blur_a_slanted_edge() -> None:
    frame = see(previous=at(0.0), readout_s=0.5, shutter_s=0.25)
    ramps = light(frame)
    # Each row: 8 px of ramp, whose middle lies 4 px before the edge of the end of the row's exposure.
    middles = ramps.sum(axis=1)
    expected = 64.0 - 16.0 * (127 - np.arange(128)) / 127 - 4.0
    assert np.abs(middles - expected).max() < 0.6
    assert np.all(((ramps > 0.05) & (ramps < 0.95)).sum(axis=1) >= 6)


@pytest.mark.parametrize("previous", [None, at(0.5, shift=0.5)])
def test_camera_that_does_not_move_sees_the_same_bits_through_any_shutter(previous: SceneState | None) -> None:
    # At 0.5 s and 0.5 m farther left than the motion says, it stood where it stands now.
    plain, timed = see(previous=previous), see(previous=previous, shutter_s=0.1, readout_s=0.1)
    np.testing.assert_array_equal(timed.rgb, plain.rgb)
    np.testing.assert_array_equal(timed.depth, plain.depth)


def test_cameras_with_and_without_effects_in_one_call_do_not_disturb_each_other() -> None:
    plain = replace(CAMERA, name="plain")
    rolling = replace(CAMERA, name="rolling", effects=ImageEffects(readout_s=0.5))
    blurred = replace(CAMERA, name="blurred", effects=ImageEffects(shutter_s=0.5, vignette=0.5))
    noisy = replace(CAMERA, name="noisy", height=100, effects=ImageEffects(read_noise=0.05))
    cameras = [rolling, plain, blurred, noisy]
    with sheet() as renderer:
        together = renderer.render(at(1.0), cameras, at(0.4))
        alone = [renderer.render(at(1.0), [camera], at(0.4))[0] for camera in cameras]
    for one, other in zip(together, alone, strict=True):
        assert one.camera is other.camera
        np.testing.assert_array_equal(one.rgb, other.rgb)
        np.testing.assert_array_equal(one.depth, other.depth)
        np.testing.assert_array_equal(one.instance, other.instance)
    assert np.any(together[3].rgb[:, :, 0] != together[1].rgb[:100, :, 0])  # type: ignore[index]


def test_colour_effects_leave_all_geometry_as_it_is_to_the_bit() -> None:
    every = replace(EYE, outputs=OUTPUTS)
    effects = ImageEffects(exposure_ev=1.0, white_balance_k=4000.0, vignette=0.5, read_noise=0.05, shot_noise=0.05)
    mesh = facing_quad(3.0, 1.0, Material())
    plain, changed = draw_mesh(mesh, camera=every), draw_mesh(mesh, camera=replace(every, effects=effects))
    assert np.any(plain.rgb != changed.rgb)
    for name in OUTPUTS[1:]:
        np.testing.assert_array_equal(getattr(changed, name), getattr(plain, name))


def test_turning_camera_with_a_rolling_shutter_is_off_by_its_turn_at_the_top_row() -> None:
    # 0.2 rad/s for 0.25 s: 0.05 rad, 3.2 px in the middle column at the first row, none at the last.
    def turned(seconds: float) -> SceneState:
        half = 0.2 * (seconds - 1.0) / 2
        return state(
            ("robot/eye",), [(0.0, 0.0, 0.0)], [(0.0, 0.0, math.sin(half), math.cos(half))], stamp_ns=round(seconds * 1e9)
        )

    camera = replace(CAMERA, effects=ImageEffects(readout_s=0.25))
    with sheet() as renderer:
        frame = renderer.render(turned(1.0), [camera], turned(0.5))[0]
    edges = (light(frame) > 0.5).sum(axis=1)
    # Turned to the right before, so the edge was further left.
    assert 64 - edges[0] == pytest.approx(3.2, abs=1.0)
    assert edges[127] == 64
