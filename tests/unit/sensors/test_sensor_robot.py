"""The robot in ``config/robots`` whose cameras have realistic errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.robots.load import load_robot
from gibson_sim.sensors.stereo import stereo_pair
from gibson_sim.types import CameraSpec, DepthNoise, ImageEffects


@pytest.fixture
def cameras(root: Path) -> dict[str, CameraSpec]:
    return {camera.name: camera for camera in load_robot(root / "config/robots/gibson_bot_sensors").cameras}


def test_its_eyes_are_a_stereo_pair(cameras: dict[str, CameraSpec]) -> None:
    _, right = stereo_pair(cameras["stereo_left"], 0.1)
    assert cameras["stereo_right"].pose.position == pytest.approx(right.pose.position)
    assert cameras["stereo_right"].pose.quat_xyzw == pytest.approx(right.pose.quat_xyzw)
    assert (cameras["stereo_right"].name, cameras["stereo_right"].stereo_baseline) == (right.name, right.stereo_baseline)


def test_its_other_cameras_have_effects_and_noise(cameras: dict[str, CameraSpec]) -> None:
    assert cameras["color"].effects != ImageEffects()
    assert cameras["color"].effects.readout_s == 0.02
    assert cameras["depth_camera"].depth_noise != DepthNoise()
    # The published coefficient: 0.001425 z^2 is 3.6 cm at 5 m.
    assert cameras["depth_camera"].depth_noise.quadratic * 5.0**2 == pytest.approx(0.0356, abs=1e-4)
