"""Topics and frames that the parameter files for Nav2, slam_toolbox and robot_localization name, in a running simulation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs")

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import Imu, LaserScan  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

pytestmark = pytest.mark.ros
TYPES = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/map": "nav_msgs/msg/OccupancyGrid",
}
OF_NAV2 = {
    "/local_costmap/costmap_raw", "/local_costmap/published_footprint", "/global_costmap/costmap_raw", "/global_costmap/published_footprint",
}  # fmt: skip
TOPIC_KEYS = ("scan_topic", "odom_topic", "map_topic", "topic", "odom0", "imu0")
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module")
def simulation(ros_domain: int) -> Iterator[Launched]:
    launched = Launched("run", "--scene", "flat", "--robot", "gibson_bot_real", "--no-render", "--publish-map-tf")
    yield launched
    launched.stop()


def _values(part: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the key and the value of every parameter."""
    if isinstance(part, dict):
        for name, inner in part.items():
            yield from _values(inner, name)
    else:
        yield key, part


@pytest.fixture(scope="module")
def parameters(root: Path) -> list[tuple[str, Any]]:
    """Of all files."""
    folder = root / "ros_ws" / "src" / "gibson_examples" / "config"
    return [pair for file in sorted(folder.glob("*.yaml")) for pair in _values(yaml.safe_load(file.read_text()))]


def test_every_topic_is_published_with_its_type(
    simulation: Launched, parameters: list[tuple[str, Any]], listener: Listener
) -> None:
    named = {f"/{str(value).lstrip('/')}" for key, value in parameters if key in TOPIC_KEYS or key.endswith("_topic")} - OF_NAV2
    assert named == set(TYPES)
    for topic, kind in TYPES.items():
        listener.spin_until(lambda topic=topic: listener.node.count_publishers(topic) == 1, topic)  # type: ignore[misc]
        (publisher,) = listener.node.get_publishers_info_by_topic(topic)
        assert publisher.topic_type == kind
        # Nav2 reads odometry and the map reliably.
        assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_every_frame_is_in_tf_and_the_sensors_are_below_the_base(
    simulation: Launched, parameters: list[tuple[str, Any]], listener: Listener
) -> None:
    moving, fixed = listener.collect(TFMessage, "/tf"), listener.collect(TFMessage, "/tf_static", LATCHED)
    scans, imus = listener.collect(LaserScan, "/scan"), listener.collect(Imu, "/imu")
    odometry = listener.collect(Odometry, "/odom")
    listener.spin_until(lambda: bool(fixed and scans and imus and odometry) and len(moving) > 20, "messages")
    parents = {t.child_frame_id: t.header.frame_id for message in (*moving, *fixed) for t in message.transforms}
    frames = {value for key, value in parameters if key.endswith(("_frame", "_frame_id"))}
    assert frames == {"map", "odom", "base_footprint"}
    assert (parents["odom"], parents["base_footprint"]) == ("map", "odom")
    assert (odometry[0].header.frame_id, odometry[0].child_frame_id) == ("odom", "base_footprint")
    for frame in (scans[0].header.frame_id, imus[0].header.frame_id):
        while frame != "base_footprint":
            frame = parents[frame]
