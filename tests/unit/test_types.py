"""Invalid values are refused."""

from __future__ import annotations

import math
from typing import Any

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


def test_a_given_matrix_is_the_intrinsics() -> None:
    camera = CameraSpec("c", "", matrix=(300.0, 1.5, 310.0, 0.0, 290.0, 250.0, 0.0, 0.0, 1.0))
    np.testing.assert_array_equal(camera.intrinsics(), [[300.0, 1.5, 310.0], [0.0, 290.0, 250.0], [0.0, 0.0, 1.0]])


def test_the_circle_of_a_fisheye_touches_the_edges_of_its_image() -> None:
    camera = CameraSpec("c", "", width=300, height=100, projection="fisheye", fov=2.0)
    # 100 px for 2 rad.
    np.testing.assert_allclose(camera.intrinsics(), [[50.0, 0.0, 149.5], [0.0, 50.0, 49.5], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("values", "model"),
    [
        ({}, "plumb_bob"),
        ({"distortion": (0.1,) * 4}, "plumb_bob"),
        ({"distortion": (0.1,) * 5}, "plumb_bob"),
        ({"distortion": (0.1,) * 8}, "rational_polynomial"),
        ({"projection": "fisheye"}, "equidistant"),
        ({"projection": "fisheye", "distortion": (0.1,) * 4}, "equidistant"),
        ({"projection": "equirectangular"}, None),
    ],
)
def test_the_number_of_coefficients_names_the_distortion_model(values: dict[str, Any], model: str | None) -> None:
    assert CameraSpec("c", "", **values).distortion_model == model


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"projection": "orthographic"}, "projection is 'orthographic', must be one of pinhole, fisheye, equirectangular"),
        ({"matrix": (1.0,) * 8}, "must be nine finite numbers"),
        ({"matrix": (300.0, 0.0, math.nan, 0.0, 300.0, 1.0, 0.0, 0.0, 1.0)}, "must be nine finite numbers"),
        ({"matrix": (300.0, 0.0, 1.0, 0.0, -300.0, 1.0, 0.0, 0.0, 1.0)}, "fx and fy above 0"),
        ({"matrix": (300.0, 0.0, 1.0, 0.0, 300.0, 1.0, 0.0, 0.0, 2.0)}, "must be fx skew cx 0 fy cy 0 0 1"),
        ({"matrix": (1.0,) * 9, "projection": "equirectangular"}, "always shows the whole sphere"),
        ({"distortion": (0.1, 0.2)}, r"2 numbers; projection pinhole allows: 4 or 5 \(plumb_bob\), 8"),
        ({"distortion": (0.1,) * 5, "projection": "fisheye"}, r"projection fisheye allows: 4 \(equidistant\)"),
        ({"distortion": (0.1,) * 4, "projection": "equirectangular"}, "allows: none"),
        ({"distortion": (0.1, math.inf, 0.0, 0.0)}, "its numbers must be finite"),
        ({"fov": 180.0}, "was it given in degrees"),
        ({"fov": math.nan}, "fov is nan"),
        ({"samples": 2}, "samples is 2, must be 1 or 4"),
        ({"stereo_baseline": -0.1}, "stereo_baseline is -0.1 m"),
    ],
)
def test_impossible_optics_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as error:
        CameraSpec("c", "", **values)
    assert str(error.value).startswith("camera 'c': ")


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
