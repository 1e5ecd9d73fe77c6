"""Bodies appear where a pinhole camera projects them, at their depth along the axis."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.formats.mesh import Material
from gibson_sim.geometry.projections import back_project, project
from gibson_sim.geometry.transforms import invert, matrix_from_pose, transform_points
from render.drawing import BLUE, EYE, GREEN, RED, box, draw, draw_mesh, eye_at, facing_quad, middle, plate, quad, where

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]


def test_a_box_of_1_m_centred_3_m_ahead_begins_at_2_5_m():
    assert draw(box((3.0, 0.0, 0.0))).depth[32, 32] == pytest.approx(2.5, abs=1e-3)


def test_a_box_covers_the_pixels_that_its_front_face_does():
    # Half the width is 0.5 m / 2.5 m * 32 px = 6.4 px: the pixels 26 to 37 have their centres within 31.5 +- 6.4.
    seen = np.isfinite(draw(box((3.0, 0.0, 0.0))).depth)
    expected = np.zeros((64, 64), dtype=bool)
    expected[26:38, 26:38] = True
    np.testing.assert_array_equal(seen, expected)


def test_depth_is_along_the_axis_and_not_along_the_ray():
    # At the edge of a front face as wide as the image the ray is 1.4 times as long as the depth.
    depth = draw(box((3.0, 0.0, 0.0), size=(1.0, 8.0, 8.0))).depth
    np.testing.assert_allclose(depth, 2.5, atol=1e-3)


@pytest.mark.parametrize("point", [(3.0, 1.1, 1.7), (3.0, -1.3, 0.9), (4.0, 2.2, -0.7), (2.5, -0.6, -1.9)])
def test_a_small_thing_appears_where_the_intrinsics_say(point):
    # Robot frame: u grows to the right, -y; v grows downwards, -z.
    x, y, z = point
    expected = (31.5 - 32.0 * y / x, 31.5 - 32.0 * z / x)
    frame = draw(plate(point, RED))
    assert middle(where(frame, 0)) == pytest.approx(expected, abs=0.6)
    assert middle(np.isfinite(frame.depth)) == pytest.approx(expected, abs=0.6)


def test_a_wide_image_has_the_same_focal_length_in_both_directions():
    # 40 rows, 90 degrees: 20 px; the middle is (49.5, 19.5); the point is 2 m left and 0.5 m up in 4 m.
    frame = draw(plate((4.0, 2.0, 0.5), RED, 0.5), camera=replace(EYE, width=100, height=40))
    assert frame.rgb.shape == (40, 100, 3)
    assert frame.depth.shape == (40, 100)
    assert middle(where(frame, 0)) == pytest.approx((39.5, 17.0), abs=0.6)


def test_a_narrow_view_has_a_long_focal_length():
    # tan(15 deg) = 0.26795: 32 / 0.26795 = 119.43 px, times 0.5 / 4 gives 14.93 px.
    frame = draw(plate((4.0, 0.5, -0.5), RED), camera=replace(EYE, fov_y=math.radians(30.0)))
    assert middle(where(frame, 0)) == pytest.approx((16.57, 46.43), abs=0.6)


def test_higher_objects_are_in_the_upper_rows():
    frame = draw(box((3.0, 0.0, 0.7), RED), box((3.0, 0.0, -0.7), BLUE))
    assert np.nonzero(where(frame, 0))[0].max() < 32 <= np.nonzero(where(frame, 2))[0].min()


def test_objects_to_the_left_are_in_the_left_columns():
    frame = draw(box((3.0, 0.7, 0.0), GREEN), box((3.0, -0.7, 0.0), BLUE))
    assert np.nonzero(where(frame, 1))[1].max() < 32 <= np.nonzero(where(frame, 2))[1].min()


def test_nearer_objects_hide_those_behind_them_in_any_drawing_order():
    near, far = plate((2.0, 0.0, 0.0), RED, 1.0), plate((4.0, 0.0, 0.0), BLUE, 1.0)
    for order in ((near, far), (far, near)):
        frame = draw(*order)
        assert frame.depth[32, 32] == pytest.approx(1.999, abs=1e-4)
        assert not where(frame, 2).any()


def test_objects_behind_the_camera_are_not_drawn():
    assert np.isposinf(draw(box((-3.0, 0.0, 0.0))).depth).all()


def test_a_camera_that_moves_to_the_right_sees_things_move_to_the_left():
    before = middle(where(draw(plate((3.0, 0.0, 0.0), RED)), 0))
    after = middle(where(draw(plate((3.0, 0.0, 0.0), RED), camera=eye_at((0.0, -0.75, 0.0))), 0))
    # 0.75 m / 3 m * 32 px = 8 px.
    assert after == pytest.approx((before[0] - 8.0, before[1]), abs=0.6)


def test_a_camera_with_any_pose_sees_a_point_where_it_projects():
    camera = eye_at((-2.0, 1.5, 1.2), look_at=(1.0, 0.3, 0.1))
    points = [(1.0, 1.0, 0.6), (0.7, -0.6, -0.4)]
    frame = draw(box(points[0], RED, (0.1, 0.1, 0.1)), box(points[1], BLUE, (0.1, 0.1, 0.1)), camera=camera)
    expected, _ = project(transform_points(invert(matrix_from_pose(camera.pose)), points), camera)
    assert middle(where(frame, 0)) == pytest.approx(tuple(expected[0]), abs=0.6)
    assert middle(where(frame, 2)) == pytest.approx(tuple(expected[1]), abs=0.6)


def test_the_depth_of_a_slanted_plane_lies_on_the_plane():
    # The plane x + 0.5 y + 0.8 z = 3 of the world: in the optical frame z - 0.5 x - 0.8 y = 3.
    def corner(y, z):
        return (3.0 - 0.5 * y - 0.8 * z, y, z)

    mesh = quad([corner(1.5, 1.5), corner(-1.5, 1.5), corner(-1.5, -1.5), corner(1.5, -1.5)], Material())
    camera = replace(EYE, width=160, height=120)
    depth = draw_mesh(mesh, camera=camera).depth
    seen = np.isfinite(depth)
    assert seen.sum() > 4000
    x, y, z = back_project(depth, camera)[seen].T
    distance = (z - 0.5 * x - 0.8 * y - 3.0) / math.sqrt(1.0 + 0.25 + 0.64)
    assert np.abs(distance).max() < 1e-3


def test_depth_is_infinite_where_nothing_is():
    depth = draw(box((3.0, 0.0, 0.0))).depth
    assert depth.dtype == np.float32
    assert np.isposinf(depth[0, 0])


def test_depth_is_infinite_in_an_empty_scene():
    assert np.isposinf(draw().depth).all()


@pytest.mark.parametrize(("far", "expected"), [(6.0, 4.999), (4.0, np.inf)])
def test_depth_is_infinite_beyond_far(far, expected):
    depth = draw(plate((5.0, 0.0, 0.0)), camera=replace(EYE, far=far)).depth
    assert depth[32, 32] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(("near", "expected"), [(0.5, 0.799), (0.9, np.inf)])
def test_objects_before_the_near_plane_are_not_drawn(near, expected):
    frame = draw(plate((0.8, 0.0, 0.0), RED), camera=replace(EYE, near=near))
    assert frame.depth[32, 32] == pytest.approx(expected, abs=1e-4)
    assert where(frame, 0).any() == np.isfinite(expected)


def test_far_depth_keeps_millimetres_with_a_near_plane_of_5_cm():
    depth = draw_mesh(facing_quad(80.0, 100.0, Material()), camera=replace(EYE, near=0.05)).depth
    np.testing.assert_allclose(depth, 80.0, atol=1e-3)
