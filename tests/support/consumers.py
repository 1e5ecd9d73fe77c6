"""What the nodes of common stacks subscribe to, and with which quality of service they really do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, JointState, LaserScan, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from support.clients import DEEP, LATCHED, stamp_ns, steps_of
from support.simulation import Listener

SYSTEM_DEFAULT = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
TF = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
CLOCK = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
COSTMAP = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
TICK = 4
"""Physics steps between two published states: 240 Hz and 60 Hz."""


@dataclass(frozen=True)
class Row:
    """One subscription of somebody."""

    who: str
    topic: str
    kind: Any
    qos: QoSProfile
    rate_hz: int = 0
    """Messages a second of simulation time; 0 = one, latched."""
    frame: str = ""
    child: str = ""
    tick: int = TICK
    """It is measured at multiples of so many physics steps."""
    placed: bool = False
    """Its consumer looks up where the robot was at the stamp."""
    rendered: bool = False

    @property
    def name(self) -> str:
        """Full name of the topic."""
        return self.topic if self.topic.startswith("/") else f"/{self.topic}"

    @property
    def type_name(self) -> str:
        """Name of the type on the graph."""
        package, _, _ = self.kind.__module__.partition(".")
        return f"{package}/msg/{self.kind.__name__}"

    def due_steps(self, until: int) -> set[int]:
        """Returns the physics steps, of 240 a second, at which a message is due."""
        ticks_per_s = 240 // self.tick
        return {-(-k * ticks_per_s // self.rate_hz) * self.tick for k in range(1, until * self.rate_hz // 240 + 2)}


SENSOR = qos_profile_sensor_data
STREAMS = (
    Row("tf2", "/tf", TFMessage, TF, 60, "odom", "base_footprint"),
    Row("Nav2 controller", "odom", Odometry, SYSTEM_DEFAULT, 60, "odom", "base_footprint"),
    Row("evaluation", "ground_truth/odom", Odometry, SYSTEM_DEFAULT, 60, "map", "base_footprint"),
    Row("robot_state_publisher", "joint_states", JointState, SYSTEM_DEFAULT, 60),
    Row("AMCL, slam_toolbox", "scan", LaserScan, SENSOR, 10, "base_scan", placed=True),
    Row("Nav2 costmap", "scan", LaserScan, COSTMAP, 10, "base_scan", placed=True),
    Row("robot_localization", "imu", Imu, SENSOR, 100, "base_link", tick=1),
    Row("docking", "bumper/wrench", WrenchStamped, SENSOR, 30, "base_link", placed=True),
    Row("rectifier", "camera/image_raw", Image, SENSOR, 10, "camera_optical_frame", placed=True, rendered=True),
    Row("visual SLAM", "camera/camera_info", CameraInfo, SYSTEM_DEFAULT, 10, "camera_optical_frame", rendered=True),
    Row("viewer", "camera/image_raw/compressed", CompressedImage, SENSOR, 10, "camera_optical_frame", rendered=True),
    Row("voxel layer", "camera/depth/image_raw", Image, SENSOR, 10, "camera_optical_frame", placed=True, rendered=True),
    Row("depth to scan", "camera/depth/camera_info", CameraInfo, SENSOR, 10, "camera_optical_frame", rendered=True),
    Row("obstacle layer", "camera/depth/points", PointCloud2, SENSOR, 10, "camera_optical_frame", placed=True, rendered=True),
)
"""Rows of messages that keep coming."""

LATCHED_ROWS = (
    Row("tf2", "/tf_static", TFMessage, LATCHED),
    Row("AMCL, global costmap", "map", OccupancyGrid, LATCHED, frame="map"),
    Row("rviz", "robot_description", String, LATCHED),
)


@dataclass
class Heard:
    """What a consumer heard, and what it could have known by then; times of sending are those of the machine's clock."""

    row: Row
    messages: list[Any] = field(default_factory=list)
    sent_ns: list[int] = field(default_factory=list)
    """Of ``messages``, one each."""
    clock: dict[int, int] = field(default_factory=dict)
    """Stamp of a /clock to when it was sent."""
    transforms: dict[int, int] = field(default_factory=dict)
    """Stamp of odom -> base to when it was sent."""
    types: list[str] = field(default_factory=list)
    """Of the topic, on the graph."""
    publishers: int = 0
    """Of the topic."""

    def keep(self, message: Any, info: dict[str, int]) -> None:
        """Takes a message, as a callback of a subscription."""
        self.messages.append(message)
        self.sent_ns.append(info["source_timestamp"])

    def is_whole(self, count: int) -> bool:
        """Returns whether so many messages came, two in a row with none lost between them, and then clock and transforms."""
        if len(self.messages) < count or min(max(self.clock), max(self.transforms)) <= stamp_ns(self.messages[count - 1]):
            return False
        steps = steps_of(self.messages)
        return not set(pairwise(steps)).isdisjoint(pairwise(sorted(self.row.due_steps(steps[-1]))))


def hear(listener: Listener, rows: Sequence[Row], count: int) -> dict[str, Heard]:
    """Returns, by who and what, ``count`` or more messages of each row, and the clock and transforms until then.

    Each row is received with its own quality of service.
    """
    node, clock, transforms = listener.node, {}, {}

    def keep_stamps(of: dict[int, int]) -> Callable[[Any, dict[str, int]], None]:
        return lambda message, info: of.update({stamp_ns(message): info["source_timestamp"]})

    node.create_subscription(Clock, "/clock", keep_stamps(clock), DEEP)
    node.create_subscription(TFMessage, "/tf", keep_stamps(transforms), DEEP)
    listener.spin_until(lambda: bool(clock and transforms), "clock and transforms")
    found = {f"{row.who}: {row.topic}": Heard(row, clock=clock, transforms=transforms) for row in rows}
    subscriptions = {
        who: node.create_subscription(heard.row.kind, heard.row.topic, heard.keep, heard.row.qos) for who, heard in found.items()
    }

    def complete() -> bool:
        # Who has enough goes, so that a slow machine has the more time for the others.
        for who in [who for who in subscriptions if found[who].is_whole(count)]:
            node.destroy_subscription(subscriptions.pop(who))
        return not subscriptions

    listener.spin_until(complete, f"{count} messages, two of them neighbours, for each of {', '.join(found)}")
    types = dict(node.get_topic_names_and_types())
    for heard in found.values():
        heard.types, heard.publishers = types[heard.row.name], node.count_publishers(heard.row.name)
    return found
