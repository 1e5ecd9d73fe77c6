"""Areas and normals of triangles."""

from __future__ import annotations

import numpy as np

from gibson_sim.geometry.triangle_meshes import areas_of, spread_over, unit_normals

CORNERS = np.array(
    [
        [[0, 0, 5], [3, 0, 5], [0, 4, 5]],
        [[0, 0, 5], [0, 4, 5], [3, 0, 5]],
        [[1, 0, 0], [1, 2, 0], [1, 0, 2]],
        [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
    ],
    dtype=np.float64,
)


def test_areas_are_half_of_the_base_times_the_height() -> None:
    np.testing.assert_allclose(areas_of(CORNERS), [6.0, 6.0, 2.0, 0.0])


def test_normals_point_to_where_the_corners_are_counter_clockwise() -> None:
    np.testing.assert_array_equal(unit_normals(CORNERS), [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, 0]])


def test_tiny_triangles_have_normals_too() -> None:
    np.testing.assert_allclose(unit_normals(CORNERS[:1] * 1e-30), [[0, 0, 1]])


def test_no_triangles_have_no_normals() -> None:
    assert unit_normals(np.zeros((0, 3, 3))).shape == (0, 3)
    assert areas_of(np.zeros((0, 3, 3))).shape == (0,)


def test_points_are_spread_over_triangles_by_their_area() -> None:
    points, owner = spread_over(CORNERS, 4000, np.random.default_rng(0))
    # 6, 6, 2 and 0 of 14 square metres; the standard deviation of each count is at most 32.
    np.testing.assert_allclose(np.bincount(owner, minlength=4), [1714, 1714, 571, 0], atol=130)
    np.testing.assert_allclose(points[owner == 0].mean(axis=0), [1.0, 4 / 3, 5.0], atol=0.1)
    assert (points[owner < 2] @ [4.0, 3.0, 0.0] <= 12.0 + 1e-9).all()


def test_no_points_are_spread_over_triangles_without_area() -> None:
    points, owner = spread_over(CORNERS[3:], 10, np.random.default_rng(0))
    assert (points.shape, owner.shape) == ((0, 3), (0,))
