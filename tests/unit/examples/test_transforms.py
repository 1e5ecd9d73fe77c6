"""The tf buffer, and poses in the plane."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_examples.errors import SettingError, TransformError, TransformNotYetError
from gibson_examples.geometry import Pose2D, format_pose, parse_pose, planar
from gibson_examples.transforms import TransformBuffer

NONE = (0.0, 0.0, 0.0, 1.0)
LEFT = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""A quarter turn counter-clockwise."""


def test_product_of_two_poses_adds_the_second_in_the_frame_of_the_first() -> None:
    pose = Pose2D(1.0, 2.0, math.pi / 2) @ Pose2D(3.0, 0.5, 0.25)
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((0.5, 5.0, math.pi / 2 + 0.25))


def test_pose_times_its_inverse_is_nothing() -> None:
    pose = Pose2D(1.0, -2.0, 2.5)
    product = pose @ pose.inverse()
    assert (product.x, product.y, product.yaw) == pytest.approx((0.0, 0.0, 0.0))


def test_points_are_turned_before_they_are_moved() -> None:
    assert Pose2D(10.0, 0.0, math.pi / 2).transform([[1.0, 0.0]])[0] == pytest.approx([10.0, 1.0])


@pytest.mark.parametrize("text", ["", "1", "1,2,3,4", "1,two", "1,nan"])
def test_text_that_is_no_pose_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(SettingError, match=r"^goal is .*, must be x,y or x,y,yaw_deg"):
        parse_pose(text, "goal")


def test_pose_is_written_as_it_is_read() -> None:
    assert format_pose(parse_pose("1.5,-2,90", "goal")) == "1.50,-2.00,90"


def test_static_chain_is_the_product_of_its_links() -> None:
    buffer = TransformBuffer()
    buffer.set_static("base", "mast", (1.0, 0.0, 0.5), LEFT)
    buffer.set_static("mast", "lidar", (2.0, 0.0, 0.0), NONE)
    assert buffer.lookup("base", "lidar")[:3, 3] == pytest.approx([1.0, 2.0, 0.5])
    assert buffer.lookup("lidar", "base")[:3, 3] == pytest.approx([-2.0, 1.0, -0.5])


def test_two_branches_meet_in_their_common_parent() -> None:
    buffer = TransformBuffer()
    buffer.set_static("base", "left", (0.0, 1.0, 0.0), NONE)
    buffer.set_static("base", "right", (0.0, -1.0, 0.0), NONE)
    assert buffer.lookup("left", "right")[:3, 3] == pytest.approx([0.0, -2.0, 0.0])


def test_transform_between_two_stamps_is_in_proportion() -> None:
    buffer = TransformBuffer()
    buffer.add(1000, "odom", "base", (0.0, 0.0, 0.0), NONE)
    buffer.add(3000, "odom", "base", (4.0, 2.0, 0.0), LEFT)
    middle = planar(buffer.lookup("odom", "base", 2000))
    assert (middle.x, middle.y, middle.yaw) == pytest.approx((2.0, 1.0, math.pi / 4))


def test_rotation_between_two_stamps_takes_the_short_way_round() -> None:
    buffer = TransformBuffer()
    buffer.add(0, "odom", "base", (0.0, 0.0, 0.0), NONE)
    buffer.add(2, "odom", "base", (0.0, 0.0, 0.0), tuple(-q for q in LEFT))  # type: ignore[arg-type]
    assert planar(buffer.lookup("odom", "base", 1)).yaw == pytest.approx(math.pi / 4)


def test_future_is_not_known_yet_and_the_past_is_forgotten() -> None:
    buffer = TransformBuffer(seconds=1e-6)
    for stamp_ns in (0, 600, 1200, 1800):
        buffer.add(stamp_ns, "odom", "base", (float(stamp_ns), 0.0, 0.0), NONE)
    with pytest.raises(TransformNotYetError):
        buffer.lookup("odom", "base", 1801)
    with pytest.raises(TransformError, match="known from") as error:
        buffer.lookup("odom", "base", 600)
    assert not isinstance(error.value, TransformNotYetError)


def test_newest_transform_is_taken_without_a_stamp() -> None:
    buffer = TransformBuffer()
    buffer.add(5, "odom", "base", (1.0, 0.0, 0.0), NONE)
    buffer.add(9, "odom", "base", (2.0, 0.0, 0.0), NONE)
    assert buffer.lookup("odom", "base")[0, 3] == 2.0
    assert buffer.newest_ns("base") == 9


def test_jump_back_in_time_forgets_what_came_after() -> None:
    buffer = TransformBuffer()
    buffer.add(9_000, "odom", "base", (2.0, 0.0, 0.0), NONE)
    buffer.add(10, "odom", "base", (7.0, 0.0, 0.0), NONE)
    assert buffer.newest_ns("base") == 10
    assert buffer.lookup("odom", "base")[0, 3] == 7.0


def test_frames_without_connection_are_named() -> None:
    buffer = TransformBuffer()
    buffer.set_static("base", "lidar", (0.0, 0.0, 0.0), NONE)
    with pytest.raises(TransformNotYetError, match="'lidar' and 'odom' are not connected"):
        buffer.lookup("odom", "lidar")


def test_loop_of_frames_is_an_error_and_ends() -> None:
    buffer = TransformBuffer()
    buffer.set_static("a", "b", (0.0, 0.0, 0.0), NONE)
    buffer.set_static("b", "a", (0.0, 0.0, 0.0), NONE)
    with pytest.raises(TransformError, match="loop"):
        buffer.lookup("a", "c")


def test_matrices_are_rigid() -> None:
    buffer = TransformBuffer()
    buffer.add(0, "odom", "base", (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5))
    matrix = buffer.lookup("odom", "base")
    assert np.allclose(matrix[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
