"""Distorted pinholes, fisheyes and equirectangular cameras: by hand, against OpenCV, and round trips."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from gibson_sim.geometry.distortion import distort, valid_angle, valid_radius_squared
from gibson_sim.geometry.projections import back_project, project, rays, unproject
from gibson_sim.types import CameraSpec

K = (310.0, 4.0, 301.5, 0.0, 295.0, 248.0, 0.0, 0.0, 1.0)
PINHOLE = CameraSpec("eye", "", width=640, height=480, matrix=K)
BARREL = (-0.28, 0.09, 0.0008, -0.0005, -0.012)
PINCUSHION = (0.12, 0.03, -0.001, 0.002, 0.004)
RATIONAL = (1.9, 0.7, 0.0003, -0.0002, 0.05, 2.1, 1.1, 0.12)
FISHEYE = CameraSpec("eye", "", width=200, height=100, projection="fisheye")
LENS = (0.02, -0.011, 0.004, -0.0007)
SPHERE = CameraSpec("eye", "", width=64, height=32, projection="equirectangular")


def cloud(n: int = 300, widest: float = 0.9) -> np.ndarray:
    rng = np.random.default_rng(3)
    slopes = rng.uniform(-widest, widest, (n, 2)) / math.sqrt(2.0)
    return np.column_stack([slopes, np.ones(n)]) * rng.uniform(0.5, 20.0, (n, 1))


@pytest.mark.parametrize("d", [BARREL[:4], BARREL, PINCUSHION, RATIONAL])
def test_a_distorted_pinhole_projects_as_opencv_does(d):
    no_skew = (*K[:1], 0.0, *K[2:])
    pixels, depth = project(cloud(), replace(PINHOLE, matrix=no_skew, distortion=d))
    expected, _ = cv2.projectPoints(cloud(), np.zeros(3), np.zeros(3), np.reshape(no_skew, (3, 3)), np.array(d))
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_array_equal(depth, cloud()[:, 2])


@pytest.mark.parametrize("d", [(), LENS])
def test_a_fisheye_projects_as_opencv_does(d):
    # OpenCV gives its skew as a part of fx.
    matrix = (62.0, 0.02 * 62.0, 101.0, 0.0, 60.0, 47.0, 0.0, 0.0, 1.0)
    no_skew = np.array([[62.0, 0.0, 101.0], [0.0, 60.0, 47.0], [0.0, 0.0, 1.0]])
    points = cloud(widest=4.0)
    pixels, depth = project(points, replace(FISHEYE, matrix=matrix, distortion=d))
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), no_skew, np.array(d or (0.0,) * 4), alpha=0.02
    )
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(depth, np.linalg.norm(points, axis=1))


def test_plumb_bob_by_hand():
    # r2 = 0.25: 1 + 0.4 * 0.25 = 1.1; tangential: 2 * 0.01 * 0.12 and 0.01 * (0.25 + 2 * 0.16).
    camera = CameraSpec("eye", "", matrix=(100.0, 0.0, 50.0, 0.0, 100.0, 50.0, 0.0, 0.0, 1.0), distortion=(0.4, 0.0, 0.01, 0.0))
    pixels, _ = project([(0.6, 0.8, 2.0)], camera)
    assert pixels[0] == pytest.approx((50 + 100 * (0.33 + 0.0024), 50 + 100 * (0.44 + 0.0057)))


def test_the_angle_from_the_axis_decides_where_a_fisheye_shows_a_point():
    # 100 px for pi: 31.83 px per radian; the centre is (99.5, 49.5). 60 degrees to the left is a third of the way across.
    pixels, depth = project([(-math.sin(math.pi / 3), 0.0, math.cos(math.pi / 3)), (0.0, 2.0, 0.0), (0.0, 0.0, 7.0)], FISHEYE)
    assert pixels == pytest.approx(np.array([(99.5 - 100 / 3, 49.5), (99.5, 99.5), (99.5, 49.5)]))
    assert depth == pytest.approx((1.0, 2.0, 7.0))


def test_a_fisheye_sees_nothing_beyond_its_field_of_view():
    pixels, _ = project([(1.0, 0.0, -0.01), (1.0, 0.0, 0.01), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)], FISHEYE)
    assert np.isnan(pixels).all(axis=1).tolist() == [True, False, True, True]
    seen = np.isfinite(rays(FISHEYE)).all(axis=2)
    v, u = np.mgrid[:100, :200]
    np.testing.assert_array_equal(seen, np.hypot(u - 99.5, v - 49.5) <= 50.0)


def test_a_fisheye_may_see_what_is_behind_it():
    camera = replace(FISHEYE, fov=math.radians(220.0))
    angle = math.radians(105.0)
    pixels, _ = project([(math.sin(angle), 0.0, math.cos(angle))], camera)
    assert pixels[0] == pytest.approx((99.5 + 50 * 105 / 110, 49.5))


def test_an_equirectangular_image_shows_the_whole_sphere():
    # 64 px for 2 pi: a pixel is pi / 32; the centre is (31.5, 15.5).
    points = [(0, 0, 5), (3, 0, 0), (-2, 0, 0), (1, 0, 1), (0, -1, 0), (0, 1, 0), (0, -1, 1)]
    pixels, depth = project(points, SPHERE)
    expected = [(31.5, 15.5), (47.5, 15.5), (15.5, 15.5), (39.5, 15.5), (31.5, -0.5), (31.5, 31.5), (31.5, 7.5)]
    assert pixels == pytest.approx(np.array(expected))
    assert depth == pytest.approx((5, 3, 2, math.sqrt(2), 1, 1, math.sqrt(2)))
    assert np.linalg.norm(rays(SPHERE), axis=2) == pytest.approx(np.ones((32, 64)))


def test_left_and_right_edge_of_an_equirectangular_image_meet_behind_the_camera():
    left, right = rays(SPHERE)[15, [0, 63]]
    half = math.pi / 64
    assert left == pytest.approx((-math.sin(half) * math.cos(half), -math.sin(half), -(math.cos(half) ** 2)))
    assert right == pytest.approx((-left[0], left[1], left[2]))


def test_the_depth_of_a_fisheye_is_a_distance():
    points = back_project(np.full((100, 200), 3.0), FISHEYE)
    seen = np.isfinite(points).all(axis=2)
    assert seen.sum() == pytest.approx(math.pi * 50**2, rel=0.01)
    assert np.linalg.norm(points[seen], axis=1) == pytest.approx(3.0)


def test_no_lens_shows_two_directions_in_one_pixel():
    # r (1 - r2 / 3) grows up to r = 1, where it is 2 / 3.
    d = (-1.0 / 3.0, 0.0, 0.0, 0.0)
    assert valid_radius_squared(d) == pytest.approx(1.0)
    camera = CameraSpec(
        "eye", "", width=201, height=201, matrix=(100.0, 0.0, 100.0, 0.0, 100.0, 100.0, 0.0, 0.0, 1.0), distortion=d
    )
    pixels, _ = project([(0.99, 0.0, 1.0), (1.01, 0.0, 1.0), (1.5, 0.0, 1.0)], camera)
    assert np.isnan(pixels[:, 0]).tolist() == [False, True, True]
    there = rays(camera)[100, 100:]
    np.testing.assert_array_equal(np.isfinite(there[:, 0]), np.arange(101) <= 66)
    assert there[66, 0] < 1.0


def test_an_equidistant_polynomial_ends_where_it_stops_growing():
    # theta (1 - theta2 / 3) grows up to 1 rad.
    d = (-1.0 / 3.0, 0.0, 0.0, 0.0)
    assert valid_angle(d) == pytest.approx(1.0)
    camera = replace(FISHEYE, distortion=d)
    pixels, _ = project([(math.sin(a), 0.0, math.cos(a)) for a in (0.99, 1.01)], camera)
    assert np.isnan(pixels[:, 0]).tolist() == [False, True]


def test_the_derivatives_of_distortion_are_its_derivatives():
    points = np.array([(0.3, -0.2), (-0.5, 0.6)])
    _, jacobian = distort(points, RATIONAL)
    step = 1e-6
    for axis in (0, 1):
        moved = np.eye(2)[axis] * step
        slope = (distort(points + moved, RATIONAL)[0] - distort(points - moved, RATIONAL)[0]) / (2 * step)
        np.testing.assert_allclose(jacobian[..., axis], slope, atol=1e-8)


CAMERAS = {
    "skewed": PINHOLE,
    "barrel": replace(PINHOLE, distortion=BARREL),
    "pincushion": replace(PINHOLE, distortion=PINCUSHION),
    "rational": replace(PINHOLE, distortion=RATIONAL),
    "fisheye": replace(FISHEYE, fov=math.radians(250.0)),
    "fisheye lens": replace(FISHEYE, distortion=LENS, matrix=(32.0, 0.3, 99.0, 0.0, 30.0, 51.0, 0.0, 0.0, 1.0)),
    "equirectangular": replace(SPHERE, width=200, height=100),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_every_pixel_of_the_image_comes_back_to_itself(name):
    camera = CAMERAS[name]
    there = rays(camera)
    assert there.shape == (camera.height, camera.width, 3)
    seen = np.isfinite(there).all(axis=2)
    assert seen.mean() > 0.35
    pixels, depth = project(there[seen], camera)
    v, u = np.nonzero(seen)
    assert np.abs(pixels - np.stack([u, v], axis=1)).max() < 1e-10
    assert depth == pytest.approx(1.0)


@given(st.sampled_from(sorted(CAMERAS)), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.01, 1000.0))
def test_a_pixel_survives_the_way_to_space_and_back(name, across, down, distance):
    camera = CAMERAS[name]
    pixel = np.array([[across * (camera.width - 1), down * (camera.height - 1)]])
    ray = unproject(pixel, camera)
    if np.isfinite(ray).all():
        back, depth = project(ray * distance, camera)
        assert back == pytest.approx(pixel, abs=1e-8)
        assert depth[0] == pytest.approx(distance)


@given(
    st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
)
def test_a_pixel_of_any_lens_survives_unprojection_and_projection(k1, k2, k3, tangential):
    camera = replace(PINHOLE, distortion=(k1, k2, *tangential, k3))
    points = cloud(40)
    pixels, _ = project(points, camera)
    known = np.isfinite(pixels).all(axis=1)
    ray = unproject(pixels[known], camera)
    # Where the distortion polynomial nearly stops growing, a pixel covers much of the world: compare in the image.
    again, _ = project(ray, camera)
    np.testing.assert_allclose(again, pixels[known], atol=1e-6)
