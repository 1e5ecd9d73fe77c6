"""The node, fed by hand: messages in the order and at the times that a busy machine may bring."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from support.simulation import require

require("rclpy", "nav_msgs", "tf2_msgs")

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_examples import conversions  # noqa: E402
from gibson_examples.errors import MapError, SettingError  # noqa: E402
from gibson_examples.geometry import Pose2D  # noqa: E402
from gibson_examples.node import NavigateNode  # noqa: E402
from gibson_examples.pure_pursuit import Velocity  # noqa: E402
from support.fed_node import FedNode  # noqa: E402
from unit.examples.drawing import empty_room, ranges_at  # noqa: E402

pytestmark = pytest.mark.ros
ROOM = empty_room(6.0, 4.0)
START = Pose2D(2.0, 2.0, 0.0)
MS = 1_000_000


def map_msg() -> Any:
    msg = OccupancyGrid()
    msg.header.frame_id = "map"
    msg.info.resolution, (msg.info.height, msg.info.width) = ROOM.resolution, ROOM.shape
    msg.info.origin.orientation.w = 1.0
    msg.data = array("b", ROOM.occupancy.tobytes())
    return msg


Feed = Callable[..., FedNode]


class Fed:
    """The node, and a robot in a room whose odometry began at 2, 2."""

    def __init__(self, feed: Feed, **parameters: Any) -> None:
        self.node = feed(NavigateNode, **parameters)
        static = TransformStamped(child_frame_id="base_scan")
        static.header.frame_id = "base_footprint"
        static.transform.translation.z, static.transform.rotation.w = 0.16, 1.0
        self.node.receive("/tf_static", TFMessage(transforms=[static]))

    @property
    def sent(self) -> list[Any]:
        """Its commands."""
        return self.node.sent("cmd_vel")

    @property
    def tfs(self) -> list[Any]:
        return self.node.sent("/tf")

    @property
    def status(self) -> str:
        return str(self.node.sent("navigation/status")[-1].data)

    def map(self) -> None:
        self.node.receive("map", map_msg())

    def tf(self, ms: int, odom: Pose2D) -> None:
        self.node.receive("/tf", TFMessage(transforms=[conversions.transform_msg(odom, ms * MS, "odom", "base_footprint")]))

    def odometry(self, ms: int) -> None:
        msg = Odometry()
        msg.header.stamp = conversions.time_msg(ms * MS)
        self.node.receive("odom", msg)

    def scan(self, ms: int, odom: Pose2D) -> None:
        ranges = ranges_at(ROOM, START @ odom)
        msg = LaserScan(angle_increment=2 * math.pi / len(ranges), range_min=0.1, range_max=12.0)
        msg.header.stamp, msg.header.frame_id = conversions.time_msg(ms * MS), "base_scan"
        msg.ranges = array("f", ranges.astype(np.float32).tobytes())
        self.node.receive("scan", msg)

    def initial_pose(self) -> None:
        msg = PoseWithCovarianceStamped()
        msg.pose.pose.position.x = msg.pose.pose.position.y = 2.0
        msg.pose.pose.orientation.w = 1.0
        self.node.receive("initialpose", msg)

    def goal(self, x: float) -> None:
        self.node.receive("goal_pose", conversions.goal_msg(Pose2D(x, 2.0, 0.0), 0, "map"))


def velocities(fed: Fed) -> list[tuple[float, float]]:
    return [(msg.linear.x, msg.angular.z) for msg in fed.sent]


def drive(fed: Fed, *, scan_first: bool = False) -> None:
    """Drives straight on for a second, at 0.2 m/s, with twenty transforms and ten scans."""
    for ms in range(50, 1001, 50):
        odom = Pose2D(0.0002 * ms, 0.0, 0.0)
        fed.odometry(ms)
        for what in (fed.scan, fed.tf) if scan_first else (fed.tf, fed.scan):
            if what == fed.tf or ms % 100 == 0:
                what(ms, odom)


@pytest.fixture
def fed(feed: Feed) -> Fed:
    fed = Fed(feed, initial_pose="2,2,0", goal="4,2,0")
    fed.map()
    return fed


HERE = Pose2D(0.0, 0.0, 0.0)


def test_robot_drives_once_map_scan_odometry_and_tf_are_there(fed: Fed) -> None:
    fed.odometry(100)
    fed.tf(100, HERE)
    assert velocities(fed) == [(0.0, 0.0)], "it stands still until it knows where it is"
    fed.scan(100, HERE)
    fed.tf(200, HERE)
    assert fed.sent[-1].linear.x > 0.0


def test_scan_waits_for_the_transform_of_its_time(fed: Fed) -> None:
    fed.tf(100, HERE)
    fed.scan(150, HERE)
    assert fed.tfs == []
    fed.tf(200, HERE)
    assert conversions.stamp_ns(fed.tfs[0].transforms[0].header.stamp) == 350 * MS  # 0.2 s ahead


def test_scans_that_always_come_before_their_transforms_are_used_all_the_same(fed: Fed) -> None:
    for ms in range(0, 2000, 100):
        fed.scan(ms + 300, HERE)
        fed.tf(ms, HERE)
    assert len(fed.tfs) >= 15


def test_transform_from_map_to_odom_is_where_odometry_began(fed: Fed) -> None:
    for k in range(12):
        odom = Pose2D(0.04 * k, 0.0, 0.0)
        fed.tf(100 * k, odom)
        fed.scan(100 * k, odom)
    transform = fed.tfs[-1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "odom")
    assert (transform.transform.translation.x, transform.transform.translation.y) == pytest.approx((2.0, 2.0), abs=0.05)


def test_robot_stops_when_scans_stay_away(fed: Fed) -> None:
    fed.tf(100, HERE)
    fed.scan(100, HERE)
    for ms in range(150, 701, 50):
        fed.odometry(ms)
        fed.tf(ms, HERE)
    assert fed.sent[-1].linear.x > 0.0
    fed.odometry(750)
    fed.tf(750, HERE)
    assert (fed.sent[-1].linear.x, fed.sent[-1].angular.z) == (0.0, 0.0)


def test_commands_come_at_twenty_hertz_of_the_robots_time(fed: Fed) -> None:
    fed.odometry(0)
    fed.tf(0, HERE)
    fed.scan(0, HERE)
    fed.node.forget()
    for ms in range(10, 501, 10):
        fed.tf(ms, HERE)
    assert len(fed.sent) == 10


def test_the_first_command_comes_at_a_whole_period(fed: Fed) -> None:
    for ms in (16, 33):
        fed.tf(ms, HERE)
    assert fed.sent == []
    fed.tf(50, HERE)
    assert velocities(fed) == [(0.0, 0.0)]


def test_a_period_begins_with_a_new_goal(fed: Fed) -> None:
    fed.tf(50, HERE)
    fed.tf(80, HERE)
    fed.goal(3.0)
    fed.node.forget()
    fed.tf(120, HERE)
    assert fed.sent == []
    fed.tf(130, HERE)
    assert len(fed.sent) == 1


def test_a_command_does_not_depend_on_whether_the_scan_of_its_time_is_there(feed: Feed) -> None:
    drives = []
    for scan_first in (False, True):
        fed = Fed(feed, initial_pose="2,2,0", goal="4,3,0")
        fed.map()
        drive(fed, scan_first=scan_first)
        drives.append((velocities(fed), [conversions.stamp_ns(tf.transforms[0].header.stamp) for tf in fed.tfs]))
    assert drives[0] == drives[1]
    assert drives[0][0][-1][0] > 0.0, "it drives"
    assert drives[0][1] == [ms * MS + 200 * MS for ms in range(100, 1001, 100)], "each scan is answered by a transform"


def test_a_drive_after_a_reset_repeats_the_first_one(feed: Feed) -> None:
    fed = Fed(feed)
    fed.map()
    drives = []
    for _ in range(2):
        fed.node.forget()
        fed.initial_pose()
        fed.goal(4.0)
        drive(fed)
        drives.append(velocities(fed))
    assert drives[0] == drives[1]
    assert drives[0][0] == (0.0, 0.0), "not localised after the reset"
    assert drives[0][-1][0] > 0.0


def test_requests_that_wait_for_the_map_are_answered_when_it_arrives(feed: Feed) -> None:
    fed = Fed(feed, initial_pose="2,2,0", goal="4,2,0")
    fed.tf(50, HERE)
    fed.scan(50, HERE)
    assert (fed.sent, fed.tfs) == ([], [])
    fed.map()
    assert (velocities(fed), len(fed.tfs)) == ([(0.0, 0.0)], 1)


def test_jump_back_in_time_restarts_localisation(fed: Fed) -> None:
    fed.tf(5000, Pose2D(1.0, 0.0, 0.0))
    fed.scan(5000, Pose2D(1.0, 0.0, 0.0))
    fed.tf(0, HERE)
    fed.scan(0, HERE)
    translation = fed.tfs[-1].transforms[0].transform.translation
    assert (translation.x, translation.y) == pytest.approx((2.0, 2.0), abs=0.15)


def test_goal_in_another_frame_is_ignored(fed: Fed) -> None:
    goal = PoseStamped()
    goal.header.frame_id, goal.pose.orientation.w = "odom", 1.0
    fed.node.receive("goal_pose", goal)
    assert "goal_pose is in frame 'odom', must be in 'map'; it is ignored" in fed.node.lines
    drive(fed)
    assert fed.status == "driving 4.00,2.00,0"


def test_initial_pose_by_topic_starts_the_robot(feed: Feed) -> None:
    fed = Fed(feed, goal="4,2,0", stamped=True)
    fed.map()
    fed.odometry(0)
    fed.tf(0, HERE)
    fed.scan(0, HERE)
    assert fed.status == "waiting for initialpose"
    fed.initial_pose()
    fed.odometry(50)
    fed.scan(50, HERE)
    fed.tf(50, HERE)
    fed.tf(100, HERE)
    assert fed.sent[-1].twist.linear.x > 0.0
    assert conversions.stamp_ns(fed.sent[-1].header.stamp) == 100 * MS


def test_wrong_goal_is_refused_at_the_start(feed: Feed) -> None:
    with pytest.raises(SettingError, match="parameter goal is 'kitchen'"):
        Fed(feed, goal="kitchen")


def test_goal_that_is_read_as_a_number_is_refused_in_one_line(feed: Feed) -> None:
    with pytest.raises(SettingError, match=r"^parameter goal is 7\.4, must be of type str"):
        Fed(feed, goal=7.4)


def test_map_that_is_turned_is_refused() -> None:
    msg = map_msg()
    msg.info.origin.orientation.z, msg.info.origin.orientation.w = math.sin(0.5), math.cos(0.5)
    with pytest.raises(MapError, match=r"turned by 57\.3 degrees"):
        conversions.grid_from(msg)


def test_map_with_missing_cells_is_refused() -> None:
    msg = map_msg()
    msg.data = array("b", [0, 0])
    with pytest.raises(MapError, match="2 cells, but it says 120 x 80"):
        conversions.grid_from(msg)


def test_pose_without_rotation_is_refused_with_the_remedy() -> None:
    msg = PoseStamped()
    msg.pose.orientation.w = 0.0
    with pytest.raises(SettingError, match="send w = 1"):
        conversions.pose_from(msg.pose)


def test_path_looks_along_its_way() -> None:
    msg = conversions.path_msg(np.column_stack([np.zeros(9), np.arange(9) * 0.05]), 0, "map")
    assert len(msg.poses) == 3
    assert msg.poses[1].pose.position.y == pytest.approx(0.2)
    assert msg.poses[1].pose.orientation.z == pytest.approx(math.sqrt(0.5))


def test_velocity_becomes_a_twist() -> None:
    twist = conversions.twist_msg(Velocity(0.25, -0.5), 0, "base", stamped=False)
    assert (twist.linear.x, twist.angular.z) == (0.25, -0.5)
