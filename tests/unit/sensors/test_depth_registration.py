"""Registered depth, computed by hand: pinholes of focal length 10 px with the centre at (10, 10)."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.sensors.depth_registration import DepthRegistration
from gibson_sim.types import CameraSpec

K = (10.0, 0.0, 10.0, 0.0, 10.0, 10.0, 0.0, 0.0, 1.0)
SOURCE = CameraSpec("depth", "", width=21, height=21, matrix=K)
TARGET = CameraSpec("color", "", width=21, height=21, matrix=K)


def _beside(x: float, z: float = 0.0) -> np.ndarray:
    """Returns T_target_source of a source that stands at (x, 0, z) in the target's frame, looking the same way."""
    T = np.eye(4)
    T[:3, 3] = (x, 0.0, z)
    return T


def _one_pixel(row: int, column: int, depth: float) -> np.ndarray:
    image = np.full((21, 21), np.inf, dtype=np.float32)
    image[row, column] = depth
    return image


def test_the_same_place_and_optics_change_nothing() -> None:
    depth = np.random.default_rng(3).uniform(1.0, 5.0, (21, 21)).astype(np.float32)
    assert np.allclose(DepthRegistration(SOURCE, TARGET, np.eye(4)).image(depth), depth, atol=1e-5)


def test_a_near_point_moves_farther_in_the_image_than_a_far_one() -> None:
    move = DepthRegistration(SOURCE, TARGET, _beside(0.5))
    near, far = move.image(_one_pixel(10, 10, 1.0)), move.image(_one_pixel(10, 10, 5.0))
    assert np.argwhere(np.isfinite(near)).tolist() == [[10, 15]]  # 10 px * 0.5 m / 1 m
    assert np.argwhere(np.isfinite(far)).tolist() == [[10, 11]]
    assert near[10, 15] == pytest.approx(1.0)


def test_depth_is_measured_from_the_target() -> None:
    moved = DepthRegistration(SOURCE, TARGET, _beside(0.0, z=0.25)).image(_one_pixel(10, 10, 2.0))
    assert moved[10, 10] == pytest.approx(2.25)


def test_the_nearest_of_two_points_wins_in_either_order() -> None:
    depth = np.full((21, 21), np.inf, dtype=np.float32)
    depth[10, 5], depth[10, 9] = 1.0, 5.0  # at x = -0.5 and -0.5: both come out at column 10
    moved = DepthRegistration(SOURCE, TARGET, _beside(0.5)).image(depth)
    assert moved[10, 10] == pytest.approx(1.0)
    assert np.isfinite(moved).sum() == 1
    mirrored = DepthRegistration(SOURCE, TARGET, _beside(-0.5)).image(depth[:, ::-1].copy())
    assert mirrored[10, 10] == pytest.approx(1.0)


def test_a_wall_has_no_holes_in_a_target_three_times_as_fine() -> None:
    fine = CameraSpec("color", "", width=63, height=63, matrix=(30.0, 0.0, 31.0, 0.0, 30.0, 31.0, 0.0, 0.0, 1.0))
    moved = DepthRegistration(SOURCE, fine, np.eye(4)).image(np.full((21, 21), 2.0, dtype=np.float32))
    assert np.allclose(moved, 2.0)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_pixels_without_depth_are_left_out(value: float) -> None:
    depth = np.full((21, 21), value, dtype=np.float32)
    assert np.isposinf(DepthRegistration(SOURCE, TARGET, np.eye(4)).image(depth)).all()


def test_points_behind_the_target_are_left_out() -> None:
    assert np.isposinf(DepthRegistration(SOURCE, TARGET, _beside(0.0, z=-3.0)).image(_one_pixel(10, 10, 2.0))).all()


def test_a_fisheye_gets_distances() -> None:
    fisheye = CameraSpec("color", "", width=21, height=21, projection="fisheye", matrix=K)
    moved = DepthRegistration(SOURCE, fisheye, np.eye(4)).image(_one_pixel(10, 20, 2.0))
    # The ray is (1, 0, 1): 45 degrees = 0.785 rad = 7.85 px, and 2 m along the axis are 2.83 m away.
    assert np.argwhere(np.isfinite(moved)).tolist() == [[10, 18]]
    assert moved[10, 18] == pytest.approx(2.0 * np.sqrt(2.0))


def test_a_target_far_too_fine_is_refused_with_the_ratio() -> None:
    fine = CameraSpec("color", "", width=640, height=640, matrix=(300.0, 0.0, 320.0, 0.0, 300.0, 320.0, 0.0, 0.0, 1.0))
    with pytest.raises(ConfigError, match=r"30\.0 times as fine; at most 8"):
        DepthRegistration(SOURCE, fine, np.eye(4))
