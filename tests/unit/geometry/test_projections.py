"""The pinhole camera without distortion, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from gibson_sim.geometry.projections import back_project, clip_from_optical, frustum_planes, project
from gibson_sim.types import CameraSpec

EYE = CameraSpec("eye", "", width=64, height=48, fov_y=math.pi / 2)
K = EYE.intrinsics()


def test_intrinsics_have_their_middle_between_the_pixels_of_an_even_image():
    assert pytest.approx(np.array([[24.0, 0, 31.5], [0, 24.0, 23.5], [0, 0, 1]])) == K


def test_a_point_on_the_axis_is_in_the_middle():
    pixels, depth = project([(0, 0, 2)], EYE)
    assert pixels[0] == pytest.approx((31.5, 23.5))
    assert depth.tolist() == [2]


def test_x_is_to_the_right_and_y_is_down():
    # 24 * 1 / 2 = 12 to the right, 24 * 0.5 / 2 = 6 down.
    pixels, depth = project([(1.0, 0.5, 2.0)], EYE)
    assert pixels[0] == pytest.approx((43.5, 29.5))
    assert depth.tolist() == [2.0]


@pytest.mark.parametrize("z", [0.0, -1.0])
def test_points_that_are_not_in_front_have_no_pixel(z):
    pixels, depth = project([(1.0, 1.0, z), (0.0, 0.0, z), (0.0, 0.0, 1.0)], EYE)
    assert np.isnan(pixels[:2]).all()
    assert np.isfinite(pixels[2]).all()
    assert depth.tolist() == [z, z, 1.0]


def test_a_pixel_goes_back_along_its_ray_by_the_depth_on_the_axis():
    depth = np.full((48, 64), 2.0)
    points = back_project(depth, EYE)
    assert points.shape == (48, 64, 3)
    # Column 43, row 29: (11.5 / 24 * 2, 5.5 / 24 * 2, 2).
    assert points[29, 43] == pytest.approx((0.958333, 0.458333, 2.0), abs=1e-6)


def test_no_depth_gives_no_point():
    depth = np.full((48, 64), np.inf)
    depth[3, 4] = 1.0
    points = back_project(depth, EYE)
    assert np.isfinite(points[3, 4]).all()
    assert np.isnan(np.delete(points.reshape(-1, 3), 3 * 64 + 4, axis=0)).all()


def test_skew_is_respected_both_ways():
    skewed = CameraSpec("eye", "", width=40, height=40, matrix=(100.0, 10.0, 7.0, 0.0, 50.0, 5.0, 0.0, 0.0, 1.0))
    # u = (100 * 1 + 10 * 2 + 7 * 4) / 4, v = (50 * 2 + 5 * 4) / 4.
    pixels, _ = project([(1.0, 2.0, 4.0)], skewed)
    assert pixels[0] == pytest.approx((37.0, 30.0))
    assert back_project(np.full((40, 40), 4.0), skewed)[30, 37] == pytest.approx((1.0, 2.0, 4.0))


@given(st.integers(0, 63), st.integers(0, 47), st.floats(0.01, 1000.0))
def test_a_pixel_survives_the_way_to_space_and_back(u, v, distance):
    pixels, depth = project(back_project(np.full((48, 64), distance), EYE)[v, u][None], EYE)
    assert pixels[0] == pytest.approx((u, v), abs=1e-6)
    assert depth[0] == pytest.approx(distance)


def test_the_edges_of_the_image_are_half_a_pixel_outside_its_pixel_centres():
    clip = clip_from_optical(K, 64, 48, 0.1)
    # At 24 m a metre is a pixel: u = -0.5 and v = -0.5 lie 32 m to the left and 24 m up.
    corner = clip @ (-32.0, -24.0, 24.0, 1.0)
    assert corner[:2] / corner[3] == pytest.approx((-1.0, -1.0))


def test_clip_depth_is_1_at_the_near_plane_and_falls_to_0():
    clip = clip_from_optical(K, 64, 48, 0.5)
    near, far = clip @ (0.0, 0.0, 0.5, 1.0), clip @ (0.0, 0.0, 50.0, 1.0)
    assert near[2] / near[3] == pytest.approx(1.0)
    assert far[2] / far[3] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("point", "inside"),
    [
        ((0, 0, 1), [True] * 5),
        ((-2, 0, 1), [False, True, True, True, True]),
        ((2, 0, 1), [True, False, True, True, True]),
        ((0, -2, 1), [True, True, False, True, True]),
        ((0, 2, 1), [True, True, True, False, True]),
        ((0, 0, 0.05), [True, True, True, True, False]),
    ],
)
def test_each_plane_of_the_frustum_cuts_its_own_side(point, inside):
    assert ((frustum_planes(K, 64, 48, 0.1) @ (*point, 1.0)) >= 0).tolist() == inside
