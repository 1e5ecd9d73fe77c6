"""How a rendered lidar covers its rays with views and looks them up; the pictures are computed from formulas."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import matrix_from_pose, quat_from_rpy
from gibson_sim.sensors.rendered_lidar import LidarPattern, RenderedLidar, even_elevations
from gibson_sim.types import CameraSpec, Frame, SceneState, Vec3

Trace = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""(origin (3,), unit directions (N, 3)), world frame, to distances (N,), +inf = nothing."""
SIXTEEN = LidarPattern(even_elevations(16, math.radians(-15), math.radians(15)), 360, 0.3, 50.0)


class Formula:
    """Draws depths that are computed."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace
        self.calls: list[tuple[SceneState, list[CameraSpec]]] = []

    def render(self, state: SceneState, cameras: Sequence[CameraSpec]) -> list[Frame]:
        self.calls.append((state, list(cameras)))
        return [self._frame(state, camera) for camera in cameras]

    def _frame(self, state: SceneState, camera: CameraSpec) -> Frame:
        assert camera.link == ""
        v, u = np.mgrid[: camera.height, : camera.width]
        rays = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3) @ np.linalg.inv(camera.intrinsics()).T
        T_world_camera = matrix_from_pose(camera.pose)
        length = np.linalg.norm(rays, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = self.trace(T_world_camera[:3, 3], rays / length[:, None] @ T_world_camera[:3, :3].T)
            depth = (distance / length).reshape(camera.height, camera.width)
        depth[depth > camera.far] = np.inf
        return Frame(camera, state.stamp_ns, T_world_camera, depth=depth.astype(np.float32))


def plane(normal: Vec3, offset: float) -> Trace:
    """Returns the plane ``normal . x = offset``."""

    def trace(origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        distance = (offset - origin @ np.array(normal)) / (directions @ np.array(normal))
        return np.where(distance > 0.0, distance, np.inf)

    return trace


def sphere(centre: Vec3, radius: float) -> Trace:
    def trace(origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        middle = directions @ (np.array(centre) - origin)
        inside = radius**2 - np.sum((np.array(centre) - origin) ** 2) + middle**2
        return np.where((inside > 0.0) & (middle > 0.0), middle - np.sqrt(np.maximum(inside, 0.0)), np.inf)

    return trace


def nearest(*traces: Trace) -> Trace:
    return lambda origin, directions: np.minimum.reduce([trace(origin, directions) for trace in traces])


ROOM = nearest(
    plane((1, 0, 0), 5.0), plane((1, 0, 0), -3.0), plane((0, 1, 0), 4.0), plane((0, 1, 0), -2.0), plane((0, 0, 1), -1.0), plane((0, 0, 1), 2.0)
)  # fmt: skip


def state(position: Vec3 = (0.0, 0.0, 0.0), rpy: Vec3 = (0.0, 0.0, 0.0)) -> SceneState:
    quats = np.array([[0, 0, 0, 1], quat_from_rpy(*rpy), [0, 0, 0, 1]])
    links = ("robot/base", "robot/lidar", "ball/ball")
    return SceneState(42, 0, 1, links, np.array([[0, 0, 0], position, [7, 8, 9]], dtype=float), quats, np.zeros((3, 6)))


def expected_ranges(lidar: RenderedLidar, trace: Trace) -> NDArray[np.float64]:
    """Returns the distances by the formula, for a lidar at the origin, without limits of range."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = trace(np.zeros(3), lidar.directions)
    return distance.reshape(len(lidar.pattern.elevations), lidar.pattern.azimuth_steps)


def test_rays_begin_along_x_and_turn_counter_clockwise_and_up() -> None:
    lidar = RenderedLidar("robot/lidar", LidarPattern((0.0, math.pi / 6), 4))
    half, root = 0.5, math.sqrt(0.75)
    expected = [
        [1, 0, 0],
        [0, 1, 0],
        [-1, 0, 0],
        [0, -1, 0],
        [root, 0, half],
        [0, root, half],
        [-root, 0, half],
        [0, -root, half],
    ]
    np.testing.assert_allclose(lidar.directions, expected, atol=1e-12)


def test_a_usual_lidar_has_four_views_and_a_spherical_one_six() -> None:
    assert len(RenderedLidar("robot/lidar", SIXTEEN).views) == 4
    assert len(RenderedLidar("robot/lidar", LidarPattern(even_elevations(9, -math.pi / 2, math.pi / 2), 90)).views) == 6
    assert len(RenderedLidar("robot/lidar", LidarPattern((math.radians(60),), 90)).views) == 1


def test_one_call_draws_all_views() -> None:
    renderer = Formula(ROOM)
    scan = RenderedLidar("robot/lidar", SIXTEEN).measure(state(), renderer)
    assert len(renderer.calls) == 1
    assert (scan.stamp_ns, scan.link) == (42, "robot/lidar")


@pytest.mark.parametrize("pattern", [SIXTEEN, LidarPattern(even_elevations(31, -1.5, 1.5), 128)], ids=["16 beams", "all around"])
def test_walls_floor_and_ceiling_of_a_room_are_where_the_formula_says(pattern: LidarPattern) -> None:
    lidar = RenderedLidar("robot/lidar", pattern)
    got = lidar.measure(state(), Formula(ROOM)).ranges
    error = np.abs(got - expected_ranges(lidar, ROOM))
    # Beside the edges of the room the nearest pixel may show the other wall; even there the error is less than that of a pixel.
    assert np.mean(error < 2e-4) > 0.97
    assert error.max() < 0.1


def test_flat_wall_at_five_metres_is_exact_to_two_millimetres() -> None:
    lidar = RenderedLidar("robot/lidar", SIXTEEN)
    wall = plane((1, 0, 0), 5.0)
    got, expected = lidar.measure(state(), Formula(wall)).ranges, expected_ranges(lidar, wall)
    near = expected < 40.0
    assert near.sum() > 16 * 160
    assert np.abs(got[near] - expected[near]).max() < 0.002


def test_floor_seen_at_a_flat_angle_is_exact() -> None:
    lidar = RenderedLidar("robot/lidar", LidarPattern((math.radians(-2.0),), 360, 0.3, 50.0))
    # 0.4 m below: 0.4 / sin 2 degrees = 11.46 m.
    got = lidar.measure(state(), Formula(plane((0, 0, 1), -0.4))).ranges
    np.testing.assert_allclose(got, 0.4 / math.sin(math.radians(2.0)), atol=0.002)


def test_sphere_is_exact_to_a_millimetre_but_at_its_rim() -> None:
    lidar = RenderedLidar("robot/lidar", SIXTEEN)
    ball = sphere((4.0, 1.0, 0.2), 1.0)
    got, expected = lidar.measure(state(), Formula(ball)).ranges, expected_ranges(lidar, ball)
    inner = np.isfinite(got) & (expected < 4.123106 - 0.5)
    assert inner.sum() > 30
    assert np.abs(got[inner] - expected[inner]).max() < 0.001


def test_no_point_lies_between_an_object_and_the_wall_behind_it() -> None:
    both = nearest(sphere((3.0, 0.0, 0.0), 0.5), plane((1, 0, 0), 8.0))
    got = RenderedLidar("robot/lidar", SIXTEEN).measure(state(), Formula(both)).ranges
    depth = got[:, :40] * np.cos(np.arange(40) * 2 * math.pi / 360) * np.cos(np.array(SIXTEEN.elevations))[:, None]
    assert not np.any((depth > 3.01) & (depth < 7.99))


def test_thing_one_pixel_wide_keeps_its_distance() -> None:
    post = 2.0

    def trace(origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        azimuth = np.arctan2(directions[:, 1], directions[:, 0])
        return np.where(np.abs(azimuth - math.radians(10.0)) < 0.0035, post, ROOM(origin, directions))

    got = RenderedLidar("robot/lidar", SIXTEEN).measure(state(), Formula(trace)).ranges
    assert got[7, 10] == pytest.approx(post, abs=1e-3)


def test_limits_of_range() -> None:
    lidar = RenderedLidar("robot/lidar", LidarPattern((0.0,), 4, 2.5, 4.5))
    # Walls at 5 m ahead, 4 m to the left, 3 m behind, 2 m to the right.
    scan = lidar.measure(state(), Formula(ROOM))
    assert scan.ranges[0].tolist() == pytest.approx([math.inf, 4.0, 3.0, -math.inf], abs=1e-4)
    np.testing.assert_array_equal(scan.column, [1, 2])
    np.testing.assert_array_equal(scan.ring, [0, 0])
    np.testing.assert_allclose(scan.points, [[0, 4, 0], [-3, 0, 0]], atol=1e-4)


def test_lidar_turns_and_tilts_with_its_link() -> None:
    lidar = RenderedLidar("robot/lidar", LidarPattern((0.0,), 4))
    # At (1, 1, 0), turned left: the first ray goes to the left wall at y = 4.
    turned = lidar.measure(state((1.0, 1.0, 0.0), (0.0, 0.0, math.pi / 2)), Formula(ROOM))
    assert turned.ranges[0].tolist() == pytest.approx([3.0, 4.0, 3.0, 4.0], abs=1e-4)
    # Nose down by 90 degrees: the first ray meets the floor 1 m below, the third the ceiling.
    down = lidar.measure(state(rpy=(0.0, math.pi / 2, 0.0)), Formula(ROOM))
    assert down.ranges[0].tolist() == pytest.approx([1.0, 4.0, 2.0, 2.0], abs=1e-4)
    # Points are in the frame of the link.
    np.testing.assert_allclose(down.points, [[1, 0, 0], [0, 4, 0], [-2, 0, 0], [0, -2, 0]], atol=1e-4)


@pytest.mark.parametrize(("see_own_body", "moved"), [(False, True), (True, False)])
def test_own_body_is_moved_away_while_it_measures(see_own_body: bool, moved: bool) -> None:
    renderer = Formula(ROOM)
    RenderedLidar("robot/lidar", SIXTEEN, see_own_body=see_own_body).measure(state(), renderer)
    drawn = renderer.calls[0][0]
    assert (drawn.positions[:2, 2] < -1e5).tolist() == [moved, moved]
    assert drawn.positions[2].tolist() == [7, 8, 9]


def test_unknown_link_is_refused() -> None:
    with pytest.raises(ConfigError, match="'robot/gone'"):
        RenderedLidar("robot/gone", SIXTEEN).measure(state(), Formula(ROOM))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"elevations": ()}, "one or more angles"),
        ({"elevations": (-15.0, 15.0)}, "were they given in degrees"),
        ({"elevations": (0.0,), "azimuth_steps": 3}, "azimuth_steps is 3"),
        ({"elevations": (0.0,), "range_min": 5.0, "range_max": 4.0}, "range_min is 5 and range_max 4"),
        ({"elevations": (0.0,), "pixels_per_step": 0.0}, "pixels_per_step is 0"),
    ],
)
def test_impossible_patterns_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        LidarPattern(**settings)  # type: ignore[arg-type]
