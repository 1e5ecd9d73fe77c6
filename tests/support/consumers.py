"""What the nodes of common stacks subscribe to, and with which quality of service they really do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu, JointState, LaserScan, PointCloud2
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from support.clients import DEEP, LATCHED, stamp_ns
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


def hear(listener: Listener, row: Row, count: int) -> Heard:
    """Returns ``count`` messages of a row, received with its own quality of service, and the clock and transforms until then."""
    heard = Heard(row)

    def on_message(message: Any, info: dict[str, int]) -> None:
        heard.messages.append(message)
        heard.sent_ns.append(info["source_timestamp"])

    def on_clock(message: Clock, info: dict[str, int]) -> None:
        heard.clock[stamp_ns(message)] = info["source_timestamp"]

    def on_tf(message: TFMessage, info: dict[str, int]) -> None:
        heard.transforms[stamp_ns(message)] = info["source_timestamp"]

    node = listener.node
    node.create_subscription(Clock, "/clock", on_clock, DEEP)
    node.create_subscription(TFMessage, "/tf", on_tf, DEEP)
    listener.spin_until(lambda: bool(heard.clock and heard.transforms), "clock and transforms")
    node.create_subscription(row.kind, row.topic, on_message, row.qos)

    def complete() -> bool:
        if len(heard.messages) < count:
            return False
        last = stamp_ns(heard.messages[count - 1])
        return max(heard.clock) > last and max(heard.transforms) > last

    listener.spin_until(complete, f"{count} messages on {row.topic} for {row.who}")
    heard.types = dict(node.get_topic_names_and_types())[row.name]
    heard.publishers = node.count_publishers(row.name)
    return heard
