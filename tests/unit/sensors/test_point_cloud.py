"""Point clouds of depth images, by hand: a pinhole of focal length 2 px and a fisheye."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from gibson_sim.sensors.point_cloud import cloud_of_frame
from gibson_sim.types import CameraSpec, Frame

K = (2.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0)
PINHOLE = CameraSpec("cam", "", width=3, height=2, matrix=K)


def _frame(camera: CameraSpec, depth: Any, rgb: Any = None) -> Frame:
    return Frame(camera, 0, np.eye(4), rgb, np.array(depth, dtype=np.float32))


def _xyz(cloud: Any, row: int, column: int) -> tuple[float, ...]:
    return tuple(float(cloud[name][row, column]) for name in "xyz")


def test_points_lie_right_below_and_ahead_of_a_pinhole() -> None:
    cloud = cloud_of_frame(_frame(PINHOLE, [[4, 4, 4], [6, 6, 6]]))
    assert cloud.shape == (2, 3)
    assert _xyz(cloud, 0, 1) == (0.0, 0.0, 4.0)
    assert _xyz(cloud, 0, 2) == (2.0, 0.0, 4.0)  # one pixel right of the middle at 4 m: 4 / 2
    assert _xyz(cloud, 1, 0) == (-3.0, 3.0, 6.0)  # one left, one down at 6 m


def test_depth_of_a_fisheye_is_the_distance() -> None:
    k = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # 1 px = 1 rad
    camera = CameraSpec("cam", "", width=2, height=1, projection="fisheye", matrix=k, fov=math.pi)
    cloud = cloud_of_frame(_frame(camera, [[5.0, 5.0]]))
    assert _xyz(cloud, 0, 0) == (0.0, 0.0, 5.0)
    assert _xyz(cloud, 0, 1) == pytest.approx((5 * math.sin(1), 0.0, 5 * math.cos(1)), abs=1e-6)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_no_return_is_three_nans(value: float) -> None:
    cloud = cloud_of_frame(_frame(PINHOLE, [[1, value, 1], [1, 1, 1]]))
    assert all(map(math.isnan, _xyz(cloud, 0, 1)))
    assert np.isfinite(cloud["x"]).sum() == 5


def test_pixels_outside_a_fisheyes_view_are_nans() -> None:
    camera = CameraSpec("cam", "", width=9, height=9, projection="fisheye", fov=math.pi)
    cloud = cloud_of_frame(_frame(camera, np.full((9, 9), 2.0)))
    assert all(map(math.isnan, _xyz(cloud, 0, 0)))
    assert np.isfinite(cloud["z"][4, 4])


def test_colours_are_packed_as_pcl_does() -> None:
    rgb = np.zeros((2, 3, 3), dtype=np.uint8)
    rgb[1, 2] = (0x11, 0x22, 0x33)
    cloud = cloud_of_frame(_frame(PINHOLE, np.ones((2, 3)), rgb))
    assert cloud.dtype.itemsize == 16
    assert struct.unpack("<I", cloud["rgb"][1, 2].tobytes())[0] == 0x00112233
    assert cloud["rgb"][0, 0] == 0


def test_cameras_with_equal_optics_but_another_matrix_are_not_mixed_up() -> None:
    wider = CameraSpec("cam", "", width=3, height=2, matrix=(4.0, 0.0, 1.0, 0.0, 4.0, 0.0, 0.0, 0.0, 1.0))
    depth = np.full((2, 3), 4.0)
    assert _xyz(cloud_of_frame(_frame(PINHOLE, depth)), 0, 2)[0] == 2.0
    assert _xyz(cloud_of_frame(_frame(wider, depth)), 0, 2)[0] == 1.0
