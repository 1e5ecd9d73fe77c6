"""Rays and ranges of a planar lidar."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.robots.sensor_specs import LidarSpec
from gibson_sim.sensors.lidar import measure_scan, ranges_from_distances, ray_directions, world_rays
from gibson_sim.types import SceneState

FOUR = LidarSpec("robot/base_scan", beams=4, range_min=0.1, range_max=10.0)


def state(position: tuple[float, float, float], yaw: float) -> SceneState:
    """Returns a state of two links, the second of which is the lidar."""
    quats = np.array([[0, 0, 0, 1], [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)]])
    links = ("robot/base", "robot/base_scan")
    return SceneState(77, 5, 1, links, np.array([[9.0, 9, 9], position]), quats, np.zeros((2, 6)))


def test_first_ray_points_forward_and_the_second_left() -> None:
    got = ray_directions(FOUR)
    np.testing.assert_allclose(got, [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


def test_rays_follow_the_link() -> None:
    # A link at (1, 2, 3), turned left by 90 degrees: its x axis is the world's y axis.
    T = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    origins, directions = world_rays(T, [[1, 0, 0], [0, 1, 0]])
    assert origins.tolist() == [[1, 2, 3], [1, 2, 3]]
    assert directions.tolist() == [[0, 1, 0], [-1, 0, 0]]


def test_ranges_outside_the_limits_are_infinite() -> None:
    got = ranges_from_distances([0.05, 0.1, 5.0, 10.0, 10.1, np.inf], FOUR)
    assert got.tolist() == pytest.approx([-math.inf, 0.1, 5.0, 10.0, math.inf, math.inf])
    assert got.dtype == np.float32


def test_scan_carries_the_stamp_of_the_state_and_asks_for_its_own_body_to_be_ignored() -> None:
    asked = []

    def cast(origins: np.ndarray, directions: np.ndarray, range_max: float, ignore: str | None) -> np.ndarray:
        asked.append((origins.tolist(), np.round(directions, 9).tolist(), range_max, ignore))
        return np.array([1.0, 2.0, 3.0, np.inf])

    scan = measure_scan(FOUR, state((1.0, 2.0, 3.0), math.pi / 2), cast)
    assert scan.stamp_ns == 77
    assert scan.ranges.tolist() == [1.0, 2.0, 3.0, math.inf]
    assert asked == [([[1, 2, 3]] * 4, [[0, 1, 0], [-1, 0, 0], [0, -1, 0], [1, 0, 0]], 10.0, "robot")]


def test_angles_cover_one_turn() -> None:
    scan = measure_scan(FOUR, state((0, 0, 0), 0.0), lambda *_: np.ones(4))
    assert (scan.angle_min, scan.angle_increment, scan.angle_max) == pytest.approx((0.0, math.pi / 2, 3 * math.pi / 2))


def test_unknown_link_is_refused() -> None:
    with pytest.raises(ConfigError, match="'robot/gone'"):
        measure_scan(LidarSpec("robot/gone"), state((0, 0, 0), 0.0), lambda *_: np.ones(360))
