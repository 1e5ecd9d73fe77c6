"""Where a camera on a link is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, quat_from_matrix
from gibson_sim.sensors.camera import camera_matrix
from gibson_sim.types import CameraSpec, Pose, SceneState

HALF = math.sqrt(0.5)
MOUNT = Pose((0.2, 0.0, 0.5), quat_from_matrix(R_LINK_OPTICAL))
STATE = SceneState(
    0,
    0,
    1,
    ("robot/wheel", "robot/base"),
    np.array([[9.0, 9.0, 9.0], [1.0, 2.0, 3.0]]),
    np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, HALF, HALF]]),
    np.zeros((2, 6)),
)
"""The base stands at (1, 2, 3) and looks along +y."""


def test_the_mount_is_turned_with_the_link_and_then_moved():
    # 0.2 m ahead is 0.2 m along +y. Optical x (right) is +x of the world, y (down) is -z, z (forward) is +y.
    expected = [[1, 0, 0, 1.0], [0, 0, 1, 2.2], [0, -1, 0, 3.5], [0, 0, 0, 1]]
    np.testing.assert_allclose(camera_matrix(STATE, CameraSpec("eye", "robot/base", MOUNT)), expected, atol=1e-12)


def test_a_camera_without_a_link_stands_in_the_world():
    expected = [[0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]]
    np.testing.assert_allclose(camera_matrix(STATE, CameraSpec("eye", "", MOUNT)), expected, atol=1e-12)


def test_a_camera_on_an_unknown_link_is_refused_by_name():
    with pytest.raises(ConfigError, match=r"'eye'.*'robot/head'.*robot/wheel, robot/base"):
        camera_matrix(STATE, CameraSpec("eye", "robot/head", MOUNT))
