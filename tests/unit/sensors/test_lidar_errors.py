"""Errors of lidars, fields of view of less than a turn, and clouds of many channels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import Lidar3DSpec, LidarSpec
from gibson_sim.sensors.lidar import cloud_directions, measure_cloud, measure_scan, ranges_from_distances, ray_directions
from gibson_sim.types import SceneState

NOISE = NoiseSource("r/scan", 0)
AT_ORIGIN = SceneState(7, 1, 1, ("r/lidar",), np.zeros((1, 3)), np.array([[0.0, 0, 0, 1]]), np.zeros((1, 6)))


def box_room(origins: np.ndarray, directions: np.ndarray, range_max: float, ignore: str | None) -> np.ndarray:
    """A room with walls at x = 3 and -1.5, y = 2 and -1, floor and ceiling at z = -0.5 and 2."""
    high, low = np.array([3.0, 2.0, 2.0]), np.array([-1.5, -1.0, -0.5])
    with np.errstate(divide="ignore"):
        distances = np.max([(high - origins) / directions, (low - origins) / directions], axis=0).min(axis=1)
    return np.where(distances > range_max, np.inf, distances)


def test_noise_has_the_requested_standard_deviation() -> None:
    spec = LidarSpec("r/lidar", range_noise=0.015)
    errors = ranges_from_distances(np.full(40_000, 5.0), spec, NOISE, 1).astype(np.float64) - 5.0
    assert errors.std() == pytest.approx(0.015, rel=0.02)
    assert abs(errors.mean()) < 4 * 0.015 / 200


def test_noise_in_parts_of_the_distance_grows_with_it() -> None:
    spec = LidarSpec("r/lidar", range_noise=0.003, range_noise_ratio=0.01)
    for distance in (0.5, 8.0):
        errors = ranges_from_distances(np.full(40_000, distance), spec, NOISE, 1).astype(np.float64) - distance
        assert errors.std() == pytest.approx(math.hypot(0.003, 0.01 * distance), rel=0.02)


def test_wrong_scale_is_that_of_the_device_for_its_whole_life() -> None:
    spec = LidarSpec("r/lidar", range_scale=0.01)
    factors = []
    for seed in range(300):
        noise = NoiseSource("r/scan", seed)
        once, later = (ranges_from_distances([2.0, 10.0, np.inf], spec, noise, stamp) for stamp in (1, 10**12))
        assert once.tolist() == later.tolist()
        assert once[1] == pytest.approx(5 * once[0])
        assert once[2] == np.inf
        factors.append(once[0] / 2.0)
    # 300 devices: the deviation of their scales is known to 4 %.
    assert np.std(factors) == pytest.approx(0.01, rel=0.15)
    assert abs(np.mean(factors) - 1.0) < 0.002


def test_rays_reach_what_a_wrong_scale_brings_into_range() -> None:
    # Devices that measure 1 to 3 % short report a wall that is 0.5 % beyond their range.
    asked: list[float] = []

    def cast(origins: np.ndarray, directions: np.ndarray, range_max: float, ignore: str | None) -> np.ndarray:
        asked.append(range_max)
        return np.full(len(origins), 12.06)

    spec = LidarSpec("r/lidar", range_scale=0.01)
    scans = [measure_scan(spec, AT_ORIGIN, cast, NoiseSource("r/scan", seed)).ranges for seed in range(30)]
    assert min(asked) > 12.36
    assert {float(np.isfinite(ranges).mean()) for ranges in scans} == {0.0, 1.0}


def test_ranges_are_multiples_of_the_resolution() -> None:
    spec = LidarSpec("r/lidar", resolution=0.25)
    assert ranges_from_distances([0.9, 1.1, 1.13, 7.99], spec, NOISE, 1).tolist() == [1.0, 1.0, 1.25, 8.0]


def test_noise_comes_before_the_steps_of_resolution() -> None:
    spec = LidarSpec("r/lidar", range_noise=0.1, resolution=0.25)
    got = ranges_from_distances(np.full(1000, 5.1), spec, NOISE, 1)
    assert set(got.tolist()) >= {5.0, 5.25}
    assert not (got % 0.25).any()


def test_rays_that_do_not_return_are_infinite_and_as_many_as_told() -> None:
    got = ranges_from_distances(np.full(40_000, 5.0), LidarSpec("r/lidar", dropout=0.1), NOISE, 1)
    assert set(got.tolist()) == {5.0, math.inf}
    assert np.isinf(got).mean() == pytest.approx(0.1, abs=4 * math.sqrt(0.09 / 40_000))


def test_no_range_is_ever_nan_or_outside_the_limits() -> None:
    spec = LidarSpec("r/lidar", range_min=1.0, range_max=2.0, range_noise=0.2, resolution=0.03, dropout=0.1)
    got = ranges_from_distances(np.tile([0.9, 1.1, 1.9, np.inf], 1000), spec, NOISE, 1)
    assert not np.isnan(got).any()
    assert got[np.isfinite(got)].min() >= 1.0
    assert got[np.isfinite(got)].max() <= 2.0
    assert np.all(got[3::4] == np.inf)


def test_errors_depend_on_seed_name_and_stamp_alone() -> None:
    spec = LidarSpec("r/lidar", range_noise=0.01, dropout=0.1)

    def ranges(noise: NoiseSource, stamp_ns: int) -> list[float]:
        return ranges_from_distances(np.full(50, 5.0), spec, noise, stamp_ns).tolist()

    used = NoiseSource("r/scan", 3, 4)
    ranges(used, 1)
    assert ranges(used, 2) == ranges(NoiseSource("r/scan", 3, 4), 2)
    assert ranges(used, 2) != ranges(used, 1)
    assert ranges(used, 2) != ranges(NoiseSource("r/scan", 4, 3), 2)
    assert ranges(used, 2) != ranges(NoiseSource("s/scan", 3, 4), 2)


def test_rays_drop_out_the_same_with_noise_and_without() -> None:
    one, other = (
        ranges_from_distances(np.full(200, 5.0), LidarSpec("r/lidar", dropout=0.2, range_noise=sigma), NOISE, 1)
        for sigma in (0.0, 0.01)
    )
    assert np.array_equal(np.isinf(one), np.isinf(other))


@pytest.mark.parametrize(
    ("beams", "angle_min", "fov"),
    [(360, 0.0, 2 * math.pi), (271, -math.radians(135), math.radians(270)), (641, -2.0, 4.0), (1081, 0.3, 1.0)],
)
def test_slam_expects_the_number_of_ranges_in_the_scan(beams: int, angle_min: float, fov: float) -> None:
    # slam_toolbox and Karto expect round((max - min) / increment) + 1, from the float32 values of the message.
    scan = measure_scan(LidarSpec("r/lidar", beams, angle_min=angle_min, fov=fov), AT_ORIGIN, box_room)
    first, last, step = (np.float32(v) for v in (scan.angle_min, scan.angle_max, scan.angle_increment))
    assert round(float((last - first) / step)) + 1 == len(scan.ranges) == beams


def test_field_of_view_ends_with_a_ray_on_both_sides() -> None:
    spec = LidarSpec("r/lidar", beams=3, angle_min=-math.pi / 2, fov=math.pi)
    np.testing.assert_allclose(ray_directions(spec), [[0, -1, 0], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    scan = measure_scan(spec, AT_ORIGIN, box_room)
    assert scan.ranges.tolist() == pytest.approx([1.0, 3.0, 2.0])
    assert (scan.angle_min, scan.angle_max) == pytest.approx((-math.pi / 2, math.pi / 2))


def test_full_turn_does_not_repeat_its_first_ray() -> None:
    scan = measure_scan(LidarSpec("r/lidar", beams=4, angle_min=-math.pi), AT_ORIGIN, box_room)
    assert scan.ranges.tolist() == pytest.approx([1.5, 1.0, 3.0, 2.0])
    assert scan.angle_max == pytest.approx(math.pi / 2)


def test_scan_carries_the_name_of_its_lidar() -> None:
    assert measure_scan(LidarSpec("r/lidar", name="scan_rear"), AT_ORIGIN, box_room).name == "scan_rear"


def test_rings_go_up_and_the_first_ray_of_each_points_forward() -> None:
    spec = Lidar3DSpec("r/lidar", channels=3, samples=4, elevation_min=-math.pi / 4, elevation_max=math.pi / 4)
    h = math.sqrt(0.5)
    np.testing.assert_allclose(cloud_directions(spec)[::4], [[h, 0, -h], [1, 0, 0], [h, 0, h]], atol=1e-12)
    np.testing.assert_allclose(cloud_directions(spec)[5], [0, 1, 0], atol=1e-12)


def test_single_channel_is_in_the_middle() -> None:
    spec = Lidar3DSpec("r/lidar", channels=1, samples=1, elevation_min=0.0, elevation_max=math.pi / 2)
    np.testing.assert_allclose(cloud_directions(spec), [[math.sqrt(0.5), 0, math.sqrt(0.5)]])


def test_points_lie_on_the_walls_of_a_room() -> None:
    spec = Lidar3DSpec("r/lidar", elevation_max=math.radians(40))
    cloud = measure_cloud(spec, AT_ORIGIN, box_room)
    assert cloud.points.shape == (16 * 720, 3)
    assert cloud.points.dtype == np.float32
    to_walls = np.abs(np.concatenate([cloud.points - [3.0, 2.0, 2.0], cloud.points - [-1.5, -1.0, -0.5]], axis=1))
    assert to_walls.min(axis=1).max() < 1e-6
    # All of the walls, the floor (15 degrees down meets it at 1.9 m) and the ceiling (40 degrees up at 2.4 m).
    assert (to_walls.min(axis=0) < 1e-6).all()


def test_points_are_in_the_frame_of_the_link() -> None:
    # At (1, 0, 0), facing left: the wall at y = 2 is 2 m ahead, that at x = 3 2 m to the right.
    yaw = np.array([[0.0, 0, math.sqrt(0.5), math.sqrt(0.5)]])
    state = SceneState(7, 1, 1, ("r/lidar",), np.array([[1.0, 0, 0]]), yaw, np.zeros((1, 6)))
    spec = Lidar3DSpec("r/lidar", channels=1, samples=4, elevation_min=0.0, elevation_max=0.0)
    got = measure_cloud(spec, state, box_room).points
    np.testing.assert_allclose(got, [[2, 0, 0], [0, 2.5, 0], [-1, 0, 0], [0, -2, 0]], atol=1e-6)


def test_rays_without_a_return_in_range_give_no_point_and_rings_keep_their_number() -> None:
    spec = Lidar3DSpec("r/lidar", channels=2, samples=4, elevation_min=0.0, elevation_max=0.1, range_min=1.2, range_max=2.5)
    distances = np.array([1.0, 2.0, 3.0, np.inf, 2.4, 1.3, 1.1, 2.6])
    cloud = measure_cloud(spec, AT_ORIGIN, lambda *_: distances)
    assert cloud.ring.tolist() == [0, 1, 1]
    assert np.linalg.norm(cloud.points, axis=1).tolist() == pytest.approx([2.0, 2.4, 1.3])
    assert cloud.points[0].tolist() == pytest.approx([0.0, 2.0, 0.0])
    assert cloud.intensity.tolist() == [0.0, 0.0, 0.0]


def test_noise_of_a_cloud_is_along_its_rays() -> None:
    spec = Lidar3DSpec("r/lidar", range_noise=0.02)
    noisy = measure_cloud(spec, AT_ORIGIN, lambda *_: np.full(16 * 720, 5.0), NOISE).points.astype(np.float64)
    lengths = np.linalg.norm(noisy, axis=1)
    np.testing.assert_allclose(noisy / lengths[:, None], cloud_directions(spec), atol=1e-6)
    assert lengths.std() == pytest.approx(0.02, rel=0.03)


def test_wall_just_beyond_the_range_may_come_into_it_by_its_error() -> None:
    asked = []

    def cast(origins: np.ndarray, directions: np.ndarray, range_max: float, ignore: str | None) -> np.ndarray:
        asked.append(range_max)
        return np.full(len(origins), 12.01)

    scan = measure_scan(LidarSpec("r/lidar", range_noise=0.02), AT_ORIGIN, cast, NOISE)
    assert asked[0] >= 12.1
    assert 0.0 < np.isfinite(scan.ranges).mean() < 1.0
