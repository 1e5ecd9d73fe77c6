"""Positions and optical flow, computed by hand, for bodies and cameras that move on separate links."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_matrix, quat_from_rpy
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import OUTPUTS, CameraSpec, Frame, Pose, Quat, SceneState, Vec3
from render.drawing import AHEAD, EYE, box, draw, plate, scene, state

pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

CAMERA = replace(EYE, outputs=OUTPUTS)
"""Focal length 32 px, the middle at (31.5, 31.5): a point (x, y, z) is at u = 31.5 - 32 y / x, v = 31.5 - 32 z / x."""
WALL = box((5.5, 0.0, 0.0), size=(1.0, 6.0, 6.0))
"""Its front is 5 m ahead and covers 38 x 38 pixels, so that there is nothing at the edge of the image."""
PLATE = replace(box((0.0, 0.0, 0.0), size=(0.002, 1.0, 1.0)), link="a")
"""On a link; instance 2, after the wall."""
HALF = math.sqrt(0.5)
LEFT_TURN = (0.0, 0.0, HALF, HALF)
"""The link's x axis points to the world's +y, its y axis to -x."""


def _at(position: Vec3, quat: Quat = (0.0, 0.0, 0.0, 1.0)) -> SceneState:
    return state(("a",), [position], [quat])


def _see(now: SceneState, before: SceneState | None, camera: CameraSpec = CAMERA) -> Frame:
    with Renderer(scene(WALL, PLATE, links=now.links)) as renderer:
        return renderer.render(now, [camera], before)[0]


def _columns_and_rows(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.nonzero(frame.instance == 2)
    return columns, rows


def test_flow_of_a_plate_that_moved_sideways_and_up() -> None:
    frame = _see(_at((2.001, 0.0, 0.0)), _at((2.001, 0.25, -0.125)))
    # Its front is 2 m ahead. It came from 0.25 m to the left and 0.125 m below: 32 * 0.25 / 2 = 4 px right, 2 px up.
    flow = frame.flow[frame.instance == 2]
    assert len(flow) > 200
    np.testing.assert_allclose(flow, np.broadcast_to([4.0, -2.0], flow.shape), atol=0.005)


def test_flow_of_a_plate_that_comes_nearer_points_away_from_the_middle() -> None:
    frame = _see(_at((2.001, 0.0, 0.0)), _at((2.501, 0.0, 0.0)))
    # A point at u now was at 31.5 + (u - 31.5) * 2 / 2.5.
    columns, rows = _columns_and_rows(frame)
    expected = 0.2 * np.stack([columns - 31.5, rows - 31.5], axis=1)
    np.testing.assert_allclose(frame.flow[rows, columns], expected, atol=0.005)
    assert np.abs(expected).max() > 1.0


def test_flow_of_a_plate_that_turned_about_the_axis_of_the_camera() -> None:
    angle = 0.1
    frame = _see(_at((2.001, 0.0, 0.0), quat_from_rpy(angle, 0.0, 0.0)), _at((2.001, 0.0, 0.0)))
    columns, rows = _columns_and_rows(frame)
    # Roll is from +y (left) to +z (up): clockwise in the image, whose v points down.
    right, down = columns - 31.5, rows - 31.5
    c, s = math.cos(angle), math.sin(angle)
    was = np.stack([c * right + s * down, -s * right + c * down], axis=1)
    expected = np.stack([right, down], axis=1) - was
    np.testing.assert_allclose(frame.flow[rows, columns], expected, atol=0.005)
    assert np.abs(expected).max() > 0.7


def test_flow_of_a_plate_that_turned_out_of_the_image_plane() -> None:
    # It stood across the axis, 2 m ahead, and has turned by 30 degrees about the vertical.
    angle = math.radians(30.0)
    frame = _see(_at((2.0, 0.0, 0.0), quat_from_rpy(0.0, 0.0, angle)), _at((2.0, 0.0, 0.0)))
    columns, rows = _columns_and_rows(frame)
    depth = frame.depth[rows, columns].astype(np.float64)
    here = np.stack([depth, (31.5 - columns) * depth / 32, (31.5 - rows) * depth / 32], axis=1) - [2.0, 0.0, 0.0]
    c, s = math.cos(angle), math.sin(angle)
    there = here @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) + [2.0, 0.0, 0.0]  # transposed: turned back
    was = np.stack([31.5 - 32 * there[:, 1] / there[:, 0], 31.5 - 32 * there[:, 2] / there[:, 0]], axis=1)
    expected = np.stack([columns, rows], axis=1) - was
    np.testing.assert_allclose(frame.flow[rows, columns], expected, atol=0.01)
    assert np.abs(expected[:, 0]).max() > 1.0


def test_flow_of_a_static_surface_is_zero_and_of_the_background_nan() -> None:
    frame = _see(_at((2.001, 0.0, 0.0)), _at((2.001, 0.25, 0.0)))
    wall, nothing = frame.instance == 1, frame.instance == 0
    assert wall.sum() > 500 and nothing.sum() > 1_000
    assert np.abs(frame.flow[wall]).max() < 1e-3
    assert np.isnan(frame.flow[nothing]).all()
    assert np.isfinite(frame.flow[~nothing]).all()


@pytest.mark.parametrize("before", [None, _at((2.001, 0.0, 0.0))])
def test_without_a_state_before_nothing_has_moved(before: SceneState | None) -> None:
    frame = _see(_at((2.001, 0.0, 0.0)), before)
    assert np.abs(frame.flow[frame.instance > 0]).max() < 1e-3
    assert np.isnan(frame.flow[frame.instance == 0]).all()


def test_a_plate_that_was_behind_the_camera_has_an_unknown_flow() -> None:
    frame = _see(_at((2.001, 0.0, 0.0)), _at((-1.0, 0.0, 0.0)))
    assert np.isnan(frame.flow[frame.instance == 2]).all()
    assert np.isfinite(frame.flow[frame.instance == 1]).all()


@pytest.mark.parametrize(("moved", "expected"), [((0.0, 0.25, 0.0), 1.6), ((0.0, -0.5, 0.0), -3.2)])
def test_flow_of_a_wall_under_a_camera_that_moved_sideways(moved: Vec3, expected: float) -> None:
    # The camera rides on the plate's link, below it, and moved to the left: the wall 5 m ahead went right by 32 * 0.25 / 5 px.
    camera = replace(CAMERA, link="a", pose=replace(AHEAD, position=(0.1, 0.0, 0.0)))
    frame = _see(_at(tuple(m - 0.1 * (k == 0) for k, m in enumerate(moved))), _at((-0.1, 0.0, 0.0)), camera)
    flow = frame.flow[frame.instance == 1]
    assert len(flow) > 1_000
    np.testing.assert_allclose(flow, np.broadcast_to([expected, 0.0], flow.shape), atol=0.005)


def test_a_thing_on_the_cameras_own_link_has_no_flow() -> None:
    camera = replace(CAMERA, link="a", pose=replace(AHEAD, position=(-1.0, 0.0, 0.0)))
    frame = _see(_at((0.3, 0.2, 0.1), quat_from_rpy(0.1, 0.2, 0.3)), _at((0.0, 0.0, 0.0)), camera)
    assert (frame.instance == 2).sum() > 200
    assert np.abs(frame.flow[frame.instance == 2]).max() < 1e-3
    assert np.abs(frame.flow[frame.instance == 1]).max() > 3.0


def test_flow_of_a_camera_that_turned_to_the_left() -> None:
    # A turn by an angle moves what is at tan(a) to tan(a - angle), whatever its distance; the middle row stays a row.
    angle = 0.05
    camera = replace(CAMERA, link="a", height=63, matrix=(32.0, 0.0, 31.5, 0.0, 32.0, 31.0, 0.0, 0.0, 1.0))
    frame = _see(_at((0.1, 0.0, 0.0), quat_from_rpy(0.0, 0.0, angle)), _at((0.1, 0.0, 0.0)), camera)
    columns = np.flatnonzero(frame.instance[31] == 1)
    was = 31.5 + 32 * np.tan(np.arctan((columns - 31.5) / 32) - angle)
    assert len(columns) > 30
    np.testing.assert_allclose(frame.flow[31, columns, 0], columns - was, atol=0.01)
    np.testing.assert_allclose(frame.flow[31, columns, 1], 0.0, atol=0.01)


def test_positions_are_in_the_world_frame() -> None:
    # The camera stands at (1, 2, 3) and looks along +y; the plate's front is 2 m ahead, at y = 4, and +x is to its right.
    link = _at((1.0, 2.0, 3.0), LEFT_TURN)
    camera = replace(CAMERA, link="a", pose=AHEAD)
    with Renderer(scene(box((1.0, 4.5, 3.0), size=(8.0, 1.0, 8.0)), links=("a",))) as renderer:
        frame = renderer.render(link, [camera])[0]
    # Pixel (10, 20): 21.5 px left and 11.5 px above the middle, each 2 / 32 m.
    assert frame.position[20, 10] == pytest.approx((1.0 - 21.5 / 16, 4.0, 3.0 + 11.5 / 16), abs=1e-3)
    assert frame.position[40, 63] == pytest.approx((1.0 + 31.5 / 16, 4.0, 3.0 - 8.5 / 16), abs=1e-3)
    assert frame.normal_world[20, 10] == pytest.approx((0.0, -1.0, 0.0), abs=1e-3)
    assert frame.normal[20, 10] == pytest.approx((0.0, 0.0, -1.0), abs=1e-3)


def test_world_normals_of_a_turned_thing_are_its_own_under_any_camera() -> None:
    quat = quat_from_rpy(0.3, -0.2, 0.4)
    front = matrix_from_pose(Pose(quat_xyzw=quat))[:3, :3] @ [-1.0, 0.0, 0.0]
    for pose in (AHEAD, replace(AHEAD, position=(0.3, 0.4, -0.2))):
        frame = _see(_at((2.0, 0.0, 0.0), quat), None, replace(CAMERA, pose=pose))
        there = frame.instance == 2
        faces = frame.normal_world[there]
        near = faces @ front > 0.9  # its 2 mm sides may be seen too
        assert near.mean() > 0.95
        np.testing.assert_allclose(faces[near], np.broadcast_to(front, faces[near].shape), atol=2e-4)


def test_nothing_has_no_position_and_a_zero_normal() -> None:
    # Askew, so that no zero of the rotation turns an infinity into NaN.
    askew = matrix_from_pose(Pose(quat_xyzw=quat_from_rpy(0.4, 0.2, 0.1))) @ matrix_from_pose(AHEAD)
    frame = draw(plate((3.0, 0.0, 0.0)), camera=replace(CAMERA, pose=pose_from_matrix(askew)))
    nothing = frame.instance == 0
    assert nothing.any() and not nothing.all()
    assert np.isnan(frame.position[nothing]).all()
    assert not frame.normal[nothing].any() and not frame.normal_world[nothing].any()


@pytest.mark.parametrize(("far", "seen"), [(3.5, True), (2.5, False)])
def test_beyond_far_there_is_no_position(far: float, seen: bool) -> None:
    frame = draw(plate((3.0, 0.0, 0.0), side=1.0), camera=replace(CAMERA, far=far))
    assert np.isfinite(frame.depth[32, 32]) == seen
    assert np.isfinite(frame.position[32, 32]).all() == seen
