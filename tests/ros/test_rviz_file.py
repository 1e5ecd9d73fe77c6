"""The file for RViz: plugins and properties that RViz of Jazzy has; topics of a running simulation, with a matching quality of service."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from support.simulation import Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs")

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.egl]
POINTS = (
    "Alpha", "Color", "Color Transformer", "Decay Time", "Position Transformer", "Selectable", "Size (Pixels)", "Size (m)", "Style",
    "Use Fixed Frame",
)  # fmt: skip
ARROW = ("Alpha", "Axes Length", "Axes Radius", "Color", "Head Length", "Head Radius", "Shaft Length", "Shaft Radius", "Shape")
PROPERTIES = {
    "Grid": (
        "Alpha", "Cell Size", "Color", "Line Style", "Normal Cell Count", "Offset", "Plane", "Plane Cell Count", "Reference Frame",
    ),
    "Image": ("Max Value", "Median window", "Min Value", "Normalize Range"),
    "LaserScan": POINTS,
    "Map": ("Alpha", "Binary representation", "Binary threshold", "Color Scheme", "Draw Behind", "Update Topic", "Use Timestamp"),
    "Odometry": ("Angle Tolerance", "Covariance", "Keep", "Position Tolerance", "Shape"),
    "Path": ("Alpha", "Buffer Length", "Color", "Line Style", "Line Width", "Offset", "Pose Style"),
    "PointCloud2": POINTS,
    "Polygon": ("Alpha", "Color"),
    "Pose": ARROW,
    "PoseWithCovariance": (*ARROW, "Covariance"),
    "RobotModel": (
        "Alpha", "Collision Enabled", "Description File", "Description Source", "Description Topic", "Links", "Mass Properties",
        "TF Prefix", "Update Interval", "Visual Enabled",
    ),
    "TF": (
        "Filter (blacklist)", "Filter (whitelist)", "Frame Timeout", "Frames", "Marker Scale", "Show Arrows", "Show Axes", "Show Names",
        "Tree", "Update Interval",
    ),
}  # fmt: skip
"""Displays of rviz_default_plugins, and the names of their properties in its sources (rviz 14)."""
TYPES = {
    "Image": "sensor_msgs/msg/Image", "LaserScan": "sensor_msgs/msg/LaserScan", "Map": "nav_msgs/msg/OccupancyGrid",
    "Odometry": "nav_msgs/msg/Odometry", "PointCloud2": "sensor_msgs/msg/PointCloud2", "RobotModel": "std_msgs/msg/String",
}  # fmt: skip
TOOLS = ("FocusCamera", "Measure", "MoveCamera", "PublishPoint", "Select", "SetGoal", "SetInitialPose")
QOS = {"Depth", "Durability Policy", "Filter size", "History Policy", "Reliability Policy", "Value"}
OF_NAV2 = {
    "amcl_pose", "global_costmap/costmap", "goal_pose", "local_costmap/costmap", "local_costmap/published_footprint", "plan",
    "received_global_plan",
}  # fmt: skip


@pytest.fixture(scope="module")
def manager(root: Path) -> dict[str, Any]:
    """What the window shows."""
    document: dict[str, Any] = yaml.safe_load((root / "config" / "sim.rviz").read_text())["Visualization Manager"]
    return document


def _displays(part: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for display in part["Displays"]:
        if display["Class"] == "rviz_common/Group":
            yield from _displays(display)
        else:
            yield display


def _topic(display: dict[str, Any]) -> dict[str, Any] | None:
    return display.get("Topic") or display.get("Description Topic")


def test_plugins_and_properties_exist(manager: dict[str, Any]) -> None:
    for display in _displays(manager):
        package, _, kind = display["Class"].partition("/")
        assert package == "rviz_default_plugins"
        assert set(display) - {"Class", "Enabled", "Name", "Topic", "Value"} == set(PROPERTIES[kind]), display["Name"]
        assert display["Enabled"] == display["Value"]
    tools = [tool["Class"].partition("/")[2] for tool in manager["Tools"]]
    assert sorted(tools) == sorted(TOOLS)
    assert manager["Views"]["Current"]["Class"] == "rviz_default_plugins/Orbit"
    published = {tool["Topic"]["Value"] for tool in manager["Tools"] if "Topic" in tool}
    assert published == {"goal_pose", "initialpose", "clicked_point"}


def test_topics_are_relative_and_complete(manager: dict[str, Any]) -> None:
    """An absolute name would not follow RViz into the namespace of a robot."""
    for display in _displays(manager):
        topic = _topic(display)
        if topic is not None:
            assert set(topic) | {"Filter size"} == QOS
            assert not topic["Value"].startswith("/")


def test_every_topic_is_published_with_a_type_and_a_quality_that_match(
    manager: dict[str, Any], ros_domain: int, listener: Listener
) -> None:
    launched = Launched("run", "--scene", "flat")
    topics = {
        (topic["Value"], display["Class"].partition("/")[2], topic["Durability Policy"], topic["Reliability Policy"])
        for display in _displays(manager)
        if (topic := _topic(display)) is not None and topic["Value"] not in OF_NAV2
    }
    assert {name for name, *_ in topics} >= {
        "map",
        "robot_description",
        "scan",
        "odom",
        "camera/image_raw",
        "camera/depth/points",
    }
    for name, kind, durability, reliability in sorted(topics):
        wait_until(lambda name=name: listener.node.count_publishers(f"/{name}") > 0, f"publisher of {name}")  # type: ignore[misc]
        (publisher,) = listener.node.get_publishers_info_by_topic(f"/{name}")
        assert publisher.topic_type == TYPES[kind]
        profile = publisher.qos_profile
        # A reliable reader needs a reliable writer, one that wants the last message a latched one; RViz wants it wherever there is one.
        assert reliability == "Best Effort" or profile.reliability == ReliabilityPolicy.RELIABLE, name
        assert (durability == "Transient Local") == (profile.durability == DurabilityPolicy.TRANSIENT_LOCAL), name
    launched.stop()


def test_images_are_drawn_only_where_they_are_shown(manager: dict[str, Any]) -> None:
    """Only the camera's colours: a depth image or a cloud that nobody looks at would cost the renderer its time."""
    shown = {d["Topic"]["Value"] for d in _displays(manager) if d["Enabled"] and d["Class"].endswith(("/Image", "/PointCloud2"))}
    assert shown == {"camera/image_raw"}
