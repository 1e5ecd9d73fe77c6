"""The noise of a depth camera, compared with its formulas."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.projections import rays
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.types import CameraSpec, DepthNoise, Frame

# 90 degrees over 240 rows: fx = 120 px.
CAMERA = CameraSpec("depth_camera", "", width=320, height=240, fov_y=math.pi / 2, near=0.1, far=8.0)


def wall(depth: float, stamp_ns: int = 1_000_000, camera: CameraSpec = CAMERA) -> Frame:
    """Returns an image of a wall across the axis, at ``depth`` metres."""
    return frame_of(np.full((camera.height, camera.width), depth), stamp_ns, camera)


def frame_of(depth: NDArray[np.floating], stamp_ns: int = 1_000_000, camera: CameraSpec = CAMERA) -> Frame:
    return Frame(camera, stamp_ns, np.eye(4), depth=depth.astype(np.float32))


def noisy(frame: Frame, **settings: float) -> NDArray[np.float32]:
    depth = apply_depth_noise(frame, DepthNoise(**settings)).depth  # type: ignore[arg-type]
    assert depth is not None
    assert depth.dtype == np.float32
    return depth


@pytest.mark.parametrize(("depth", "sigma"), [(1.0, 0.0065), (2.0, 0.017), (4.0, 0.053)])
def test_spread_follows_the_formula(depth: float, sigma: float) -> None:
    # 0.001 + 0.003 z + 0.0025 z^2: at 2 m 0.001 + 0.006 + 0.01, at 4 m 0.001 + 0.012 + 0.04.
    got = noisy(wall(depth), constant=0.001, linear=0.003, quadratic=0.0025)
    assert got.std() == pytest.approx(sigma, rel=0.05)
    assert got.mean() == pytest.approx(depth, abs=4 * sigma / math.sqrt(got.size))


def test_spread_is_normal() -> None:
    errors = (noisy(wall(2.0), constant=0.01) - 2.0) / 0.01
    assert np.mean(np.abs(errors) < 1.0) == pytest.approx(0.6827, abs=0.01)
    assert np.mean(np.abs(errors) < 2.0) == pytest.approx(0.9545, abs=0.005)


def test_neighbours_are_independent() -> None:
    errors = noisy(wall(2.0), constant=0.01) - 2.0
    for one, other in ((errors[1:], errors[:-1]), (errors[:, 1:], errors[:, :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02


def test_depths_are_those_of_whole_steps_of_disparity() -> None:
    # fx b = 120 * 0.1 = 12 px m; at 3.1 m the disparity is 3.871 px, in steps of 0.5 px 4 px: 3 m. At 3.5 m 3.429 px: 3.5 px, 24/7 m.
    for depth, expected in ((3.1, 3.0), (3.5, 24.0 / 7.0)):
        got = noisy(wall(depth), disparity_step_px=0.5, baseline=0.1)
        np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_disparity_below_half_a_step_is_out_of_range() -> None:
    # 12 px m / 7.9 m = 1.52 px, less than half of 4 px.
    assert np.all(noisy(wall(7.9), disparity_step_px=4.0, baseline=0.1) == np.inf)


def test_share_of_random_holes() -> None:
    holes = np.isnan(noisy(wall(2.0), hole_fraction=0.2))
    assert holes.mean() == pytest.approx(0.2, abs=0.01)


def test_no_hole_where_nothing_is() -> None:
    assert np.all(noisy(wall(np.inf), hole_fraction=1.0, constant=0.1, quadratic=0.1) == np.inf)


def _floor_below(height: float) -> NDArray[np.float64]:
    """Returns depths of a floor ``height`` below the camera, whose axis is level: z = height / y in the rows below the middle."""
    y = (np.arange(CAMERA.height) - 119.5) / 120.0
    rows = np.where(y > 0.0, height / np.where(y > 0.0, y, 1.0), np.inf)
    return np.repeat(rows[:, None], CAMERA.width, axis=1)


def _angles() -> NDArray[np.float64]:
    """Returns the angle between every ray and the vertical, degrees."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (u - 159.5) / 120.0, (v - 119.5) / 120.0
    return np.degrees(np.arccos(np.maximum(y, 0.0) / np.sqrt(x * x + y * y + 1.0)))


@pytest.mark.parametrize("with_normals", [False, True])
def test_grazing_angles_are_holes_and_others_are_not(with_normals: bool) -> None:
    depth = _floor_below(0.5)
    frame = frame_of(depth, camera=replace(CAMERA, far=1000.0))
    if with_normals:
        up = np.zeros((*depth.shape, 3), dtype=np.float32)
        up[:, :, 1] = np.where(np.isfinite(depth), -1.0, 0.0)
        frame = replace(frame, normal=up)
    got = noisy(frame, hole_angle_deg=80.0)
    angles = _angles()
    below = np.isfinite(depth)
    assert np.all(np.isnan(got[below & (angles > 80.1)]))
    np.testing.assert_array_equal(got[below & (angles < 79.9)], frame.depth[below & (angles < 79.9)])  # type: ignore[index]
    assert np.all(got[~below] == np.inf)


_OTHER_OPTICS: dict[str, dict[str, Any]] = {
    "fisheye": {"projection": "fisheye", "fov": 2.5},
    "distorted": {"distortion": (-0.2, 0.05, 0.001, 0.0)},
    "skewed": {"matrix": (100.0, 5.0, 170.0, 0.0, 110.0, 100.0, 0.0, 0.0, 1.0)},
}


@pytest.mark.parametrize("optics", _OTHER_OPTICS.values(), ids=_OTHER_OPTICS)
@pytest.mark.parametrize("with_normals", [False, True])
def test_grazing_angles_of_other_cameras(optics: dict[str, Any], with_normals: bool) -> None:
    camera = replace(CAMERA, far=1000.0, **optics)
    directions = rays(camera)
    y = directions[:, :, 1]
    below = y > 0.02
    depth = np.where(below, 0.5 / np.where(below, y, 1.0), np.inf)
    frame = frame_of(depth, camera=camera)
    if with_normals:
        frame = replace(frame, normal=np.broadcast_to(np.float32([0.0, -1.0, 0.0]), (*depth.shape, 3)))
    got = noisy(frame, hole_angle_deg=75.0)
    angles = np.degrees(np.arccos(np.abs(y) / np.linalg.norm(directions, axis=2)))
    assert np.all(np.isnan(got[below & (angles > 76.0)]))
    # Without normals the rows beside nothing, and the last ones of the image, are a little off.
    inner = below & (angles < 74.0)
    assert inner.sum() > 10_000
    assert np.mean(np.isfinite(got[inner])) > 0.999


def test_edge_of_a_thing_in_front_of_a_wall_is_no_grazing_surface() -> None:
    depth = np.full((240, 320), 4.0)
    depth[80:160, 100:200] = 1.0
    assert np.all(np.isfinite(noisy(frame_of(depth), hole_angle_deg=75.0)))


def test_limits_of_range() -> None:
    depth = np.full((240, 320), 2.0)
    depth[0], depth[1], depth[2], depth[3] = 0.2, 0.3, 8.1, np.inf
    got = noisy(frame_of(depth), range_min=0.25)
    assert got[:5, 0].tolist() == [-np.inf, np.float32(0.3), np.inf, np.inf, 2.0]


def test_same_seed_stamp_and_camera_give_the_same_bits_in_any_order() -> None:
    settings = {"constant": 0.01, "hole_fraction": 0.1}
    first, second = noisy(wall(2.0, 10), **settings), noisy(wall(2.0, 20), **settings)
    np.testing.assert_array_equal(noisy(wall(2.0, 20), **settings), second)
    np.testing.assert_array_equal(noisy(wall(2.0, 10), **settings), first)


@pytest.mark.parametrize("other", ["stamp", "seed", "camera"])
def test_another_stamp_seed_or_camera_gives_other_noise(other: str) -> None:
    base = noisy(wall(2.0), constant=0.01)
    camera = replace(CAMERA, name="other") if other == "camera" else CAMERA
    frame = wall(2.0, 1_000_001 if other == "stamp" else 1_000_000, camera)
    got = noisy(frame, constant=0.01, seed=1 if other == "seed" else 0)
    assert abs(np.corrcoef((base - 2.0).ravel(), (got - 2.0).ravel())[0, 1]) < 0.02


def test_holes_stay_where_they_are_when_noise_is_added() -> None:
    holes = np.isnan(noisy(wall(2.0), hole_fraction=0.1))
    np.testing.assert_array_equal(np.isnan(noisy(wall(2.0), hole_fraction=0.1, constant=0.01)), holes)


def test_true_frame_stays_as_it_is() -> None:
    frame = wall(2.0)
    noisy(frame, constant=0.1, disparity_step_px=1.0, hole_fraction=0.5, hole_angle_deg=45.0)
    assert np.all(frame.depth == 2.0)


def test_no_noise_is_no_work() -> None:
    frame = wall(2.0)
    assert apply_depth_noise(frame, DepthNoise(seed=3, baseline=0.2)) is frame


def test_frame_without_depth_stays_as_it_is() -> None:
    frame = Frame(CAMERA, 0, np.eye(4))
    assert apply_depth_noise(frame, DepthNoise(constant=0.1)) is frame


def test_disparity_of_a_fisheye_is_refused() -> None:
    fisheye = replace(CAMERA, projection="fisheye")
    with pytest.raises(ConfigError, match="disparity_step_px needs a pinhole camera"):
        noisy(wall(2.0, camera=fisheye), disparity_step_px=0.5)
    with pytest.raises(ConfigError, match="disparity_step_px is for pinhole cameras"):
        replace(fisheye, depth_noise=DepthNoise(disparity_step_px=0.5))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"constant": -1.0}, "constant is -1"),
        ({"quadratic": math.nan}, "quadratic is nan"),
        ({"baseline": 0.0}, "baseline is 0 m"),
        ({"hole_angle_deg": 91.0}, "hole_angle_deg is 91"),
        ({"hole_fraction": 1.5}, "hole_fraction is 1.5"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        DepthNoise(**settings)  # type: ignore[arg-type]
