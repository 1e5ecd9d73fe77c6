"""Hand-packed messages against the same messages serialised by rclpy: bit for bit, except padding."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from nav_msgs.msg import Odometry as RosOdometry  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_msgs.msg import SceneState as RosSceneState, TickDone  # noqa: E402
from gibson_sim.robots.drives.odometry_errors import OdometryCovariance  # noqa: E402
from gibson_sim.ros import conversions  # noqa: E402
from gibson_sim.ros.wire.fast_publish import (  # noqa: E402
    FastClock,
    FastImu,
    FastJointStates,
    FastOdometry,
    FastSceneState,
    FastTf,
    FastTickDone,
)
from gibson_sim.types import JointStates, Odometry, Pose, SceneState  # noqa: E402
from support.messages import ground_truth_to_msg, joint_states_to_msg, odometry_to_msg  # noqa: E402

pytestmark = pytest.mark.ros
STAMP_NS = 12_345_678_901
HALF = 0.5**0.5


def _same(message: object, data: bytes) -> None:
    """Compares all bytes except padding.

    Between fields, and behind the last one where an array is empty, rclpy leaves whatever was in memory. We leave zeros, and nothing.
    """
    wanted = serialize_message(message)[: len(data)]
    assert len(data) == len(wanted)
    assert deserialize_message(data, type(message)) == message
    for i in [i for i, (ours, theirs) in enumerate(zip(data, wanted, strict=True)) if ours != theirs]:
        assert data[i] == 0
        assert deserialize_message(data[:i] + b"\xff" + data[i + 1 :], type(message)) == message, f"byte {i} counts"


@pytest.mark.parametrize("stamp_ns", [0, 999_999_999, STAMP_NS])
def test_clock_is_bit_equal(stamp_ns: int) -> None:
    _same(Clock(clock=conversions.time_to_msg(stamp_ns)), FastClock().serialize(stamp_ns))


@pytest.mark.parametrize(
    "frames", [[], [("odom", "base_footprint")], [("a", "b"), ("ab", "wheel_left"), ("abc", "é"), ("", "d")]]
)
def test_tf_is_bit_equal_whatever_the_length_of_the_names(frames: list[tuple[str, str]]) -> None:
    poses = [Pose((1.5 + i, -2.0, 0.25), (0.0, 0.0, HALF, HALF)) for i in range(len(frames))]
    transforms = [conversions.transform_to_msg(STAMP_NS, *frame, pose) for frame, pose in zip(frames, poses, strict=True)]
    rows = [[*pose.position, *pose.quat_xyzw] for pose in poses]
    _same(TFMessage(transforms=transforms), FastTf(frames).serialize(STAMP_NS, rows))


def test_transforms_keep_no_number_of_the_message_before() -> None:
    fast = FastTf([("odom", "base")])
    fast.serialize(1, [[9.0] * 7])
    pose = Pose((1.0, 2.0, 3.0))
    message = TFMessage(transforms=[conversions.transform_to_msg(STAMP_NS, "odom", "base", pose)])
    _same(message, fast.serialize(STAMP_NS, [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]]))


def test_another_number_of_transforms_is_refused() -> None:
    with pytest.raises(ValueError, match="2 poses"):
        FastTf([("odom", "base")]).serialize(0, [[0.0] * 7, [0.0] * 7])


@pytest.mark.parametrize("child", ["base", "base_footprint", "robot_17/base_link"])
def test_odometry_is_bit_equal(child: str) -> None:
    odometry = Odometry(1.0, 2.0, 0.0, 0.4, -0.1)
    covariance = OdometryCovariance((1.0, 0.1, 0.2, 0.1, 2.0, 0.3, 0.2, 0.3, 3.0), (4.0, 0.4, 0.5, 0.4, 5.0, 0.6, 0.5, 0.6, 6.0))
    message = odometry_to_msg(odometry, STAMP_NS, "odom", child, covariance)
    assert message.pose.covariance[[0, 1, 5, 7, 11, 35]].tolist() == [1.0, 0.1, 0.2, 2.0, 0.3, 3.0]
    assert message.twist.covariance[[14, 21, 28]].min() >= 1e6
    both = map(conversions.planar_covariance, covariance)
    values = (1.0, 2.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.4, 0.0, 0.0), (0.0, 0.0, -0.1)
    data = FastOdometry("odom", child).serialize(STAMP_NS, *values, *both)
    _same(message, data)
    assert deserialize_message(data, RosOdometry).twist.twist.angular.z == -0.1


def test_ground_truth_is_bit_equal() -> None:
    pose, linear, angular = Pose((1.0, 2.0, 3.0), (HALF, 0.0, 0.0, HALF)), np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])
    message = ground_truth_to_msg(pose, linear, angular, STAMP_NS, "base_footprint")
    data = FastOdometry("map", "base_footprint").serialize(STAMP_NS, pose.position, pose.quat_xyzw, linear, angular)
    _same(message, data)


@pytest.mark.parametrize("count", [0, 1, 2, 7])
def test_joint_states_are_bit_equal(count: int) -> None:
    names = tuple(f"joint_{10**i}" for i in range(count))
    joints = JointStates(names, *(np.arange(count) + offset for offset in (0.5, 10.5, 20.5)))
    message = joint_states_to_msg(joints, STAMP_NS)
    assert isinstance(message, JointState)
    _same(message, FastJointStates(names).serialize(STAMP_NS, joints))


def test_another_number_of_joints_is_refused() -> None:
    with pytest.raises(ValueError, match="1 joints"):
        FastJointStates(("a", "b")).serialize(0, JointStates(("a",), np.zeros(1), np.zeros(1), np.zeros(1)))


def test_imu_is_bit_equal() -> None:
    message = Imu(header=conversions.header_to_msg(STAMP_NS, "imu_link"))
    message.orientation.z = message.orientation.w = HALF
    message.angular_velocity.x, message.linear_acceleration.z = 0.25, 9.81
    message.orientation_covariance = np.arange(9.0)
    message.angular_velocity_covariance = 0.5 * np.eye(3).ravel()
    message.linear_acceleration_covariance = 2.0 * np.eye(3).ravel()
    fast = FastImu("imu_link", range(9))
    _same(message, fast.serialize(STAMP_NS, (0.0, 0.0, HALF, HALF), (0.25, 0.0, 0.0), (0.0, 0.0, 9.81), 0.5, 2.0))


@pytest.mark.parametrize("due", [(), (0,), (3, 1, 2)])
@pytest.mark.parametrize("links", [0, 1, 3])
def test_scene_state_is_bit_equal(links: int, due: tuple[int, ...]) -> None:
    rows = np.arange(13.0 * links).reshape(links, 13)
    names = tuple(f"robot/link_{i}" for i in range(links))
    state = SceneState(STAMP_NS, 77, 5, names, rows[:, :3], rows[:, 3:7], rows[:, 7:])
    message = conversions.scene_state_to_msg(state, due, 2, 2**40)
    assert isinstance(message, RosSceneState)
    _same(message, FastSceneState("map", links).serialize(state, due, 2, 2**40))


@pytest.mark.parametrize("sent", [(), ("/cmd_vel",), ("/left/cmd_vel", "/inputs_at", "/inputs_at")])
@pytest.mark.parametrize("name", ["a", "left/controller"])
def test_a_tick_that_is_done_is_bit_equal(name: str, sent: tuple[str, ...]) -> None:
    message = TickDone(event=TickDone.DONE, participant=name, stamp=conversions.time_to_msg(STAMP_NS))
    message.sent = list(sent)
    stamp = message.stamp
    _same(message, FastTickDone(TickDone.DONE, name, sent).serialize(stamp.sec, stamp.nanosec))


def test_state_with_another_number_of_links_is_refused() -> None:
    state = SceneState(0, 0, 0, ("a/b",), np.zeros((1, 3)), np.zeros((1, 4)), np.zeros((1, 6)))
    with pytest.raises(ValueError, match="2 links"):
        FastSceneState("map", 2).serialize(state, ())
