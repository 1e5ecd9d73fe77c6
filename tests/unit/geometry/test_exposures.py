"""The pictures of which images with motion blur and rolling shutter are composed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.geometry.exposures import LEAST_MOTION_PX, MAX_BANDS, MAX_PICTURES, MAX_SAMPLES, Exposure, exposures, pixel_motion
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix, quat_from_rpy, yaw_from_quat
from gibson_sim.types import CameraSpec, ImageEffects, Pose, SceneState, Vec3

# fx = 240 px; the corner ray is at tan = 1.666 / 1, so 1 / cos^2 = 3.78 there.
CAMERA = CameraSpec("eye", "robot/eye", Pose(quat_xyzw=quat_from_matrix(R_LINK_OPTICAL)), 640, 480, math.radians(90.0))


def state(stamp_ms: float, yaw: float = 0.0, other: Vec3 = (-5.0, 0.0, 0.0), turned: float = 0.0) -> SceneState:
    """Returns a state with a camera at the origin that looks along x, and another link (behind the camera by default)."""
    quats = np.array([quat_from_rpy(0.0, 0.0, yaw), quat_from_rpy(turned, 0.0, 0.0)])
    return SceneState(
        int(stamp_ms * 1e6), 0, 1, ("robot/eye", "ball/ball"), np.array([(0.0, 0.0, 0.0), other]), quats, np.zeros((2, 6))
    )


def camera(shutter_s: float = 0.0, readout_s: float = 0.0) -> CameraSpec:
    return replace(CAMERA, effects=ImageEffects(shutter_s=shutter_s, readout_s=readout_s))


def yaws(plan: list[Exposure]) -> list[float]:
    return [yaw_from_quat(e.state.quats_xyzw[0]) for e in plan]


def _turning(spec: CameraSpec, rate: float = 1.0, interval_ms: float = 50.0) -> list[Exposure]:
    """Returns the plan for a camera that turns left at ``rate`` and is at yaw 0 now."""
    return exposures(spec, state(100.0 - interval_ms, -rate * interval_ms / 1000.0), state(100.0, 0.0))


@pytest.mark.parametrize("spec", [camera(), camera(0.01, 0.02)])
def test_nothing_moves_and_one_picture_of_the_state_itself_is_drawn(spec: CameraSpec) -> None:
    now = state(100.0)
    (only,) = exposures(spec, state(50.0), now)
    assert only.state is now
    assert (only.rows, only.weight, only.geometry) == (slice(0, 480), 1.0, True)


@pytest.mark.parametrize("previous", [None, state(100.0, 0.5), state(150.0, 0.5)])
def test_motion_is_unknown_without_an_earlier_state(previous: SceneState | None) -> None:
    now = state(100.0)
    assert [e.state for e in exposures(camera(0.01, 0.02), previous, now)] == [now]


def test_motion_without_shutter_or_readout_changes_nothing() -> None:
    assert len(_turning(camera())) == 1


def test_shutter_does_not_matter_without_colours() -> None:
    assert len(_turning(replace(camera(shutter_s=0.02), outputs=("depth",)))) == 1
    assert len(_turning(replace(camera(shutter_s=0.02, readout_s=0.02), outputs=("depth",)))) == MAX_BANDS


def test_shutter_ends_at_the_stamp_and_begins_its_time_before() -> None:
    # At 1 rad/s the camera turns by 0.02 rad in 20 ms.
    plan = _turning(camera(shutter_s=0.02))
    assert yaws(plan)[-1] == 0.0
    assert min(yaws(plan)) == yaws(plan)[0] == pytest.approx(-0.02)
    assert sum(e.weight for e in plan) == pytest.approx(1.0)
    assert [e.geometry for e in plan] == [*[False] * (len(plan) - 1), True]
    assert {(e.rows.start, e.rows.stop) for e in plan} == {(0, 480)}


def test_average_over_the_shutter_is_its_middle() -> None:
    plan = _turning(camera(shutter_s=0.02))
    assert sum(e.weight * yaw for e, yaw in zip(plan, yaws(plan), strict=True)) == pytest.approx(-0.01)


def test_one_sample_for_each_pixel_of_motion() -> None:
    # Corners: 240 px/rad x 3.78 x rate x 5 ms: at 1 rad/s 4.5 px, of which the rotation about the image's own y moves a part.
    few, many, most = (len(_turning(camera(shutter_s=0.005), rate)) for rate in (1.0, 2.0, 50.0))
    assert 3 <= few <= 6
    assert few < many <= 2 * few
    assert most == MAX_SAMPLES


def test_rolling_shutter_reads_the_last_row_at_the_stamp_and_the_first_before() -> None:
    plan = _turning(camera(readout_s=0.02))
    assert len(plan) == MAX_BANDS
    assert [e.rows.start for e in plan] == [15 * k for k in range(32)]
    assert plan[-1].rows.stop == 480
    assert all(e.geometry and e.weight == 1.0 for e in plan)
    # Rows 0..14: the middle one is row 7, 472 of 479 rows before the last.
    assert yaws(plan)[0] == pytest.approx(-0.02 * 472 / 479)
    assert yaws(plan)[-1] == pytest.approx(-0.02 * 7 / 479)


def test_slow_rolling_shutter_needs_few_bands() -> None:
    plan = _turning(camera(readout_s=0.02), rate=0.05)
    assert 2 <= len(plan) < 12
    assert sum(e.rows.stop - e.rows.start for e in plan) == 480


def test_motion_below_the_limit_is_not_drawn() -> None:
    assert LEAST_MOTION_PX / 0.02 > 240 * 3.78 * 0.005
    assert len(_turning(camera(0.02, 0.02), rate=0.005)) == 1


def test_each_row_of_both_effects_together_gets_the_whole_light() -> None:
    plan = _turning(camera(0.01, 0.02))
    light, geometry = np.zeros(480), np.zeros(480)
    for e in plan:
        light[e.rows] += e.weight
        geometry[e.rows] += e.geometry
    np.testing.assert_allclose(light, 1.0)
    np.testing.assert_array_equal(geometry, 1.0)
    assert min(yaws(plan)) == pytest.approx(-0.01 - 0.02 * 472 / 479)


def test_many_bands_and_samples_stay_within_a_limit_of_pictures() -> None:
    plan = _turning(camera(0.02, 0.02), rate=10.0)
    assert len(plan) == MAX_PICTURES == MAX_BANDS * 8


def test_readout_longer_than_the_time_between_states_goes_on_evenly() -> None:
    plan = _turning(camera(readout_s=0.04), interval_ms=10.0)
    assert yaws(plan)[0] == pytest.approx(-0.04 * 472 / 479)


def test_motion_of_a_thing_in_view_counts_in_pixels() -> None:
    # 0.1 m sideways at 2 m: atan(0.05) = 0.05 rad, 12 px.
    got = pixel_motion(CAMERA, state(0.0, other=(2.0, 0.1, 0.0)), state(10.0, other=(2.0, 0.0, 0.0)))
    assert got == pytest.approx(12.0, rel=0.01)


def test_motion_behind_the_camera_does_not_count() -> None:
    assert pixel_motion(CAMERA, state(0.0, other=(-2.0, 0.1, 0.0)), state(10.0, other=(-2.0, 0.0, 0.0))) == 0.0


def test_turning_thing_in_view_counts() -> None:
    # A radius of 0.25 m at 2 m rotated by 0.1 rad: 0.0125 rad, 3 px.
    got = pixel_motion(CAMERA, state(0.0, other=(2.0, 0.0, 0.0)), state(10.0, other=(2.0, 0.0, 0.0), turned=0.1))
    assert got == pytest.approx(3.0, rel=0.01)


def test_turn_of_the_camera_moves_the_middle_by_the_focal_length_times_the_angle_and_corners_by_more() -> None:
    got = pixel_motion(CAMERA, state(0.0, -0.001), state(10.0))
    # At the left and right edge x = 1.333: 240 (1 + x^2) 0.001 = 0.667 px.
    assert 0.24 < 0.65 < got < 240 * 3.78 * 0.001


@pytest.mark.parametrize("projection", ["fisheye", "equirectangular"])
def test_other_projections_have_pixels_a_radian_as_well(projection: str) -> None:
    spec = replace(CAMERA, projection=projection, width=628, height=314)  # type: ignore[arg-type]
    # 100 px/rad: 628 px for 2 pi, and for the fisheye 314 px for pi.
    assert pixel_motion(spec, state(0.0, -0.01), state(10.0)) == pytest.approx(1.0, rel=0.01)
