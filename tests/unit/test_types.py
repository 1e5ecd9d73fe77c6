"""Values refuse what cannot be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import CommandError, ConfigError
from gibson_sim.types import CameraSpec, Pose, SceneState, VelocityCommand


def test_intrinsics_put_the_centre_between_the_middle_pixels() -> None:
    camera = CameraSpec("c", "robot/c", width=640, height=480, fov_y=math.radians(90.0))
    # tan(45 deg) = 1: the focal length is half the height.
    np.testing.assert_allclose(camera.intrinsics(), [[240.0, 0.0, 319.5], [0.0, 240.0, 239.5], [0.0, 0.0, 1.0]])


def test_camera_in_degrees_is_refused_with_a_hint() -> None:
    with pytest.raises(ConfigError, match=r"fov_y is 60 rad, must be in \(0, pi\); was it given in degrees"):
        CameraSpec("c", "robot/c", fov_y=60.0)


def test_camera_with_unknown_output_is_refused() -> None:
    with pytest.raises(ConfigError, match="outputs are \\['smell'\\], must be one or more of rgb, depth"):
        CameraSpec("c", "robot/c", outputs=("smell",))  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_velocity_command_refuses_what_is_not_finite(bad: float) -> None:
    with pytest.raises(CommandError, match="NaN or an infinity"):
        VelocityCommand((0.0, bad, 0.0), (0.0, 0.0, 0.0), 0)


def test_pose_refuses_a_quaternion_that_is_not_a_rotation() -> None:
    with pytest.raises(ConfigError, match="has length 2; it must be 1"):
        Pose(quat_xyzw=(0.0, 0.0, 0.0, 2.0))


def test_scene_state_refuses_arrays_of_another_length_than_its_links() -> None:
    with pytest.raises(ConfigError, match="with 2 links"):
        SceneState(0, 0, 1, ("a", "b"), np.zeros((1, 3)), np.zeros((2, 4)), np.zeros((2, 6)))
