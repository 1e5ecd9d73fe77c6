"""Conventions of rotations and frames, by hand, and round trips for all of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import (
    R_LINK_OPTICAL,
    camera_pose,
    invert,
    matrices_from_poses,
    matrix_from_pose,
    matrix_from_quat,
    pose_from_matrix,
    pose_from_xyz_rpy,
    quat_from_matrix,
    quat_from_rpy,
    transform_points,
    wrap_angle,
    yaw_from_quat,
)
from gibson_sim.types import Pose

HALF = math.sqrt(0.5)
QUARTER = math.pi / 2
angles = st.floats(-math.pi, math.pi)
coordinates = st.floats(-100.0, 100.0)
quats = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(c / math.hypot(*q) for c in q))
)
poses = st.builds(Pose, st.tuples(coordinates, coordinates, coordinates), quats)


def turned(quat, vector):
    return matrix_from_quat(quat) @ vector


@pytest.mark.parametrize(
    ("rpy", "quat"),
    [((QUARTER, 0, 0), (HALF, 0, 0, HALF)), ((0, QUARTER, 0), (0, HALF, 0, HALF)), ((0, 0, QUARTER), (0, 0, HALF, HALF))],
)
def test_roll_pitch_and_yaw_turn_about_x_y_and_z(rpy, quat):
    assert quat_from_rpy(*rpy) == pytest.approx(quat)


def test_rotations_are_right_handed():
    assert turned(quat_from_rpy(QUARTER, 0, 0), (0, 1, 0)) == pytest.approx((0, 0, 1))
    assert turned(quat_from_rpy(0, QUARTER, 0), (0, 0, 1)) == pytest.approx((1, 0, 0))
    assert turned(quat_from_rpy(0, 0, QUARTER), (1, 0, 0)) == pytest.approx((0, 1, 0))


def test_roll_comes_first_then_pitch_then_yaw_about_fixed_axes():
    # y: roll takes it to z, pitch takes z to x, yaw takes x to y.
    assert turned(quat_from_rpy(QUARTER, QUARTER, QUARTER), (0, 1, 0)) == pytest.approx((0, 1, 0))
    # y: roll takes it to z, pitch by 0 leaves it, yaw leaves z. The other order would give -x.
    assert turned(quat_from_rpy(QUARTER, 0, QUARTER), (0, 1, 0)) == pytest.approx((0, 0, 1))
    # x: pitch takes it to -z, yaw leaves -z. The other order would give y.
    assert turned(quat_from_rpy(0, QUARTER, QUARTER), (1, 0, 0)) == pytest.approx((0, 0, -1))


def test_the_optical_axes_are_forward_right_and_down_in_the_link():
    assert (R_LINK_OPTICAL @ (0, 0, 1)).tolist() == [1, 0, 0]
    assert (R_LINK_OPTICAL @ (1, 0, 0)).tolist() == [0, -1, 0]
    assert (R_LINK_OPTICAL @ (0, 1, 0)).tolist() == [0, 0, -1]
    assert np.linalg.det(R_LINK_OPTICAL) == pytest.approx(1.0)


def test_a_pose_turns_first_and_moves_then():
    matrix = matrix_from_pose(pose_from_xyz_rpy((1, 2, 3), (0, 0, QUARTER)))
    assert transform_points(matrix, [(1, 0, 0), (0, 1, 0)]) == pytest.approx(np.array([(1, 3, 3), (0, 2, 3)]))


def test_many_poses_give_the_matrices_of_each():
    several = [pose_from_xyz_rpy((1, 2, 3), (0.1, 0.2, 0.3)), Pose(), pose_from_xyz_rpy((-1, 0, 4), (3, 1, -2))]
    stacked = matrices_from_poses([p.position for p in several], [p.quat_xyzw for p in several])
    np.testing.assert_allclose(stacked, [matrix_from_pose(p) for p in several], atol=1e-15)


def test_no_poses_give_no_matrices():
    assert matrices_from_poses(np.zeros((0, 3)), np.zeros((0, 4))).shape == (0, 4, 4)


def test_points_may_be_scaled():
    assert transform_points(np.diag([2.0, 3.0, 4.0, 1.0]), [(1, 1, 1)]).tolist() == [[2, 3, 4]]


@pytest.mark.parametrize("axis", range(3))
def test_the_quaternion_of_half_a_turn_about_an_axis_is_found(axis):
    rotation = -np.eye(3)
    rotation[axis, axis] = 1.0
    expected = [0.0] * 4
    expected[axis] = 1.0
    assert np.abs(quat_from_matrix(rotation)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("angle", "expected"), [(0, 0), (3 * QUARTER, -QUARTER), (-3 * QUARTER, QUARTER), (math.pi, math.pi), (-math.pi, math.pi)]
)
def test_angles_are_wrapped_to_half_a_turn(angle, expected):
    assert wrap_angle(angle) == pytest.approx(expected)


@pytest.mark.parametrize("yaw", [0.0, 0.5, -2.0, math.pi])
def test_yaw_is_the_heading(yaw):
    assert yaw_from_quat((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))) == pytest.approx(yaw)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), angles)
def test_yaw_of_roll_pitch_yaw_is_the_yaw(roll, pitch, yaw):
    assert abs(wrap_angle(yaw_from_quat(quat_from_rpy(roll, pitch, yaw)) - yaw)) < 1e-9


@given(quats)
def test_a_quaternion_survives_the_matrix_up_to_its_sign(quat):
    back = quat_from_matrix(matrix_from_quat(quat))
    assert back[3] >= 0.0
    assert abs(np.dot(back, quat)) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(matrix_from_quat(back), matrix_from_quat(quat), atol=1e-9)


@given(quats)
def test_the_matrix_of_a_quaternion_is_a_rotation(quat):
    rotation = matrix_from_quat(quat)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(angles, angles, angles)
def test_roll_pitch_yaw_is_the_product_of_three_rotations(roll, pitch, yaw):
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    np.testing.assert_allclose(matrix_from_quat(quat_from_rpy(roll, pitch, yaw)), about_z @ about_y @ about_x, atol=1e-12)


@given(poses)
def test_a_pose_survives_the_matrix(pose):
    back = pose_from_matrix(matrix_from_pose(pose))
    assert back.position == pytest.approx(pose.position)
    np.testing.assert_allclose(matrix_from_pose(back), matrix_from_pose(pose), atol=1e-9)


@given(poses)
def test_the_inverse_undoes_the_transform(pose):
    matrix = matrix_from_pose(pose)
    np.testing.assert_allclose(invert(matrix) @ matrix, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(matrix @ invert(matrix), np.eye(4), atol=1e-9)


@pytest.mark.parametrize(("look_at", "image_y"), [((1.0, 2.0, 0.0), (0.0, -1.0, 0.0)), ((1.0, 2.0, 9.0), (0.0, 1.0, 0.0))])
def test_a_camera_that_looks_straight_down_or_up_has_the_worlds_x_to_the_right(
    look_at: tuple[float, float, float], image_y: tuple[float, float, float]
) -> None:
    T_world_optical = matrix_from_pose(camera_pose((1.0, 2.0, 3.0), look_at))
    np.testing.assert_allclose(T_world_optical[:3, 0], (1.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(T_world_optical[:3, 1], image_y, atol=1e-12)
    np.testing.assert_allclose(T_world_optical[:3, 3], (1.0, 2.0, 3.0))


@pytest.mark.parametrize("look_at", [(1.0, 2.0, 3.0), (1.0, math.nan, 0.0), (math.inf, 0.0, 0.0)])
def test_a_camera_that_looks_nowhere_is_refused(look_at: tuple[float, float, float]) -> None:
    with pytest.raises(ConfigError, match="must be another point, with finite coordinates"):
        camera_pose((1.0, 2.0, 3.0), look_at)
