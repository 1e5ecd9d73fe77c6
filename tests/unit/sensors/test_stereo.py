"""Stereo pairs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.sensors.stereo import stereo_pair
from gibson_sim.types import CameraSpec, Pose

LEFT = CameraSpec("stereo/left", "robot/head", Pose((0.2, 0.06, 0.5), quat_from_matrix(R_LINK_OPTICAL)))


def test_right_camera_stands_to_the_right_and_looks_the_same_way() -> None:
    left, right = stereo_pair(LEFT, 0.12)
    assert left is LEFT
    # The link's y axis points left.
    assert right.pose.position == pytest.approx((0.2, -0.06, 0.5))
    assert right.pose.quat_xyzw == pytest.approx(LEFT.pose.quat_xyzw)
    assert (right.name, right.link, right.stereo_baseline) == ("stereo/right", "robot/head", 0.12)
    np.testing.assert_array_equal(right.intrinsics(), left.intrinsics())


def test_right_camera_of_a_camera_that_looks_back_stands_at_its_own_right() -> None:
    back = replace(LEFT, pose=Pose((0.0, 0.0, 0.0), quat_from_matrix(np.diag([-1.0, -1.0, 1.0]) @ R_LINK_OPTICAL)))
    assert stereo_pair(back, 0.1)[1].pose.position == pytest.approx((0.0, 0.1, 0.0))


def test_name_without_left_gets_an_ending() -> None:
    assert stereo_pair(replace(LEFT, name="head"), 0.1)[1].name == "head_right"


@pytest.mark.parametrize("baseline", [0.0, -0.1, math.nan, math.inf])
def test_impossible_baseline_is_refused(baseline: float) -> None:
    with pytest.raises(ConfigError, match="must be a finite number above 0"):
        stereo_pair(LEFT, baseline)


def test_fisheye_pair_is_refused() -> None:
    with pytest.raises(ConfigError, match="needs pinhole cameras"):
        stereo_pair(replace(LEFT, projection="fisheye"), 0.1)
