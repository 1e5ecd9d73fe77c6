"""The robots of a ROS graph, as a page shows and drives them: poses, scans, plans, estimates, commands."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Protocol

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan

from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.ros.client.requests import flat_pose
from gibson_sim.ros.topics import names
from gibson_sim.ros.web.transform_tree import TransformTree
from gibson_sim.types import WORLD_FRAME, Pose
from gibson_sim.web.requests import Drive, Goal

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_MOST_POINTS = 400
"""Points of a scan and of a path that a page gets."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_RADIUS_M = 0.25
"""Radius of a robot's arrow on the map, m."""
Points = list[tuple[float, float]]


class GraphNode(Protocol):
    """A node whose graph has robots."""

    def subscribe(self, kind: Any, topic: str, callback: Any, profile: Any) -> Any:
        """Subscribes to a topic, and returns the subscription; a message that cannot be shown is left out."""

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any) -> Any:
        """As ``rclpy.node.Node`` has it; so have the following."""

    def destroy_publisher(self, publisher: Any) -> bool:  # noqa: D102
        ...

    def destroy_subscription(self, subscription: Any) -> bool:  # noqa: D102
        ...

    def count_publishers(self, topic_name: str) -> int:  # noqa: D102
        ...

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[Any]:  # noqa: D102
        ...

    def stamp(self) -> Any:
        """Returns the time now: of the simulation where there is one."""


def robots_in(graph: list[tuple[str, list[str]]]) -> set[str]:
    """Returns the namespaces in which a robot publishes odometry; "" = none. ``graph``: (topic, types), as rclpy returns them."""
    suffix = f"/{names.ODOM}"
    found = {name.removesuffix(suffix).strip("/") for name, types in graph if _ODOMETRY in types and name.endswith(suffix)}
    return {name for name in found if not name.endswith("ground_truth")}


class Robot:
    """One robot: its namespace, what it says of where it is, and its commands."""

    def __init__(self, node: GraphNode, name: str) -> None:
        """Subscribes to its topics; ``name`` is its namespace, "" = none."""
        self.name = name
        self.path: Points = []
        """The plan, map frame, m."""
        self.estimate: dict[str, float] | None = None
        """Pose of a localiser: x, y (m), and its ellipse of 2 sigma: major, minor (m), angle (rad)."""
        self._node, self._prefix = node, f"/{name}/" if name else "/"
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._scan: LaserScan | None = None
        self._stamped = False
        self._publishers: dict[str, Any] = {}
        self._subscriptions = [
            node.subscribe(Odometry, self._prefix + names.ODOM, partial(setattr, self, "_odometry"), _NEWEST),
            node.subscribe(Odometry, self._prefix + names.GROUND_TRUTH, partial(setattr, self, "_truth"), _NEWEST),
            node.subscribe(LaserScan, self._prefix + names.SCAN, partial(setattr, self, "_scan"), _NEWEST),
            node.subscribe(Path, f"{self._prefix}plan", self._on_path, _NEWEST),
            node.subscribe(PoseWithCovarianceStamped, f"{self._prefix}amcl_pose", self._on_estimate, _LATCHED),
        ]

    def close(self) -> None:
        """Ends its subscriptions."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)

    @property
    def is_there(self) -> bool:
        """Whether it still publishes its odometry."""
        return self._node.count_publishers(self._prefix + names.ODOM) > 0

    def choose_type(self) -> None:
        """Sends TwistStamped where all subscribers of the topic of commands want it."""
        wanted = {info.topic_type for info in self._node.get_subscriptions_info_by_topic(self._prefix + names.CMD_VEL)}
        stamped = wanted == {"geometry_msgs/msg/TwistStamped"}
        if stamped != self._stamped and names.CMD_VEL in self._publishers:
            self._node.destroy_publisher(self._publishers.pop(names.CMD_VEL))
        self._stamped = stamped

    def drive(self, command: Drive) -> None:
        """Publishes a velocity command."""
        publisher = self._publisher(TwistStamped if self._stamped else Twist, names.CMD_VEL, 10)
        msg = TwistStamped() if self._stamped else Twist()
        twist = msg.twist if self._stamped else msg
        twist.linear.x, twist.linear.y, twist.angular.z = command.linear, command.lateral, command.angular
        if self._stamped:
            msg.header.stamp = self._node.stamp()
        publisher.publish(msg)

    def advertise(self) -> None:
        """Makes the publishers of goals and initial poses, so that a click finds its subscribers matched."""
        self._publisher(PoseStamped, "goal_pose", 1)
        self._publisher(PoseWithCovarianceStamped, "initialpose", 1)

    def send(self, goal: Goal) -> tuple[bool, str]:
        """Publishes a goal or an initial pose; returns whether it has subscribers, and what to say."""
        pose = flat_pose(goal.x, goal.y, 0.0, goal.yaw)
        if goal.kind == "goal":
            topic, msg = "goal_pose", PoseStamped(pose=pose)
            publisher = self._publisher(PoseStamped, topic, 1)
        else:
            topic, msg = "initialpose", PoseWithCovarianceStamped()
            msg.pose.pose = pose
            msg.pose.covariance[0] = msg.pose.covariance[7] = 0.25
            msg.pose.covariance[35] = math.radians(15.0) ** 2
            publisher = self._publisher(PoseWithCovarianceStamped, topic, 1)
        msg.header.frame_id, msg.header.stamp = WORLD_FRAME, self._node.stamp()
        publisher.publish(msg)
        heard = publisher.get_subscription_count() > 0
        topic = (self._prefix + topic).lstrip("/")
        return heard, f"sent to {topic}" if heard else f"{topic} has no subscriber: no navigation stack runs"

    def _publisher(self, kind: Any, topic: str, depth: int) -> Any:
        if topic not in self._publishers:
            self._publishers[topic] = self._node.create_publisher(kind, self._prefix + topic, depth)
        return self._publishers[topic]

    def _on_path(self, msg: Path) -> None:
        points = [(p.pose.position.x, p.pose.position.y) for p in msg.poses]
        self.path = _finite(points[:: max(1, len(points) // _MOST_POINTS)])

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        p, c = msg.pose.pose.position, msg.pose.covariance
        self.estimate = None
        covariance = np.array([[c[0], c[1]], [c[6], c[7]]])
        if not np.isfinite(covariance).all() or not math.isfinite(p.x + p.y):
            return
        values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
        minor, major = (2.0 * np.sqrt(np.maximum(values, 0.0))).tolist()
        found = {"x": p.x, "y": p.y, "major": major, "minor": minor, "angle": math.atan2(axes[1, 1], axes[0, 1])}
        if all(map(math.isfinite, found.values())):
            self.estimate = found

    def shown(self, tree: TransformTree) -> tuple[dict[str, Any], Points] | None:
        """Returns what a page shows of it, and where the rays of its newest scan end, map frame, m; None = it has said nothing yet."""
        T_map_base = self._pose(tree)
        if T_map_base is None:
            return None
        values = {
            "x": float(T_map_base[0, 3]),
            "y": float(T_map_base[1, 3]),
            "yaw": math.atan2(T_map_base[1, 0], T_map_base[0, 0]),
            "radius": _RADIUS_M,
            "speed": self._speed,
        }
        if not all(map(math.isfinite, values.values())):
            return None
        return {"name": self.name or "robot", "namespace": self.name, **values}, _finite(self._scan_points(tree, T_map_base))

    def _pose(self, tree: TransformTree) -> Mat4 | None:
        """Returns T_map_base: by tf where that knows the map, else the simulation's truth, else its odometry."""
        if self._odometry is None:
            return None
        T_map_base = tree.between(WORLD_FRAME, self._odometry.child_frame_id)
        return T_map_base if T_map_base is not None else _matrix((self._truth or self._odometry).pose.pose)

    @property
    def _speed(self) -> float:
        """Speed by its odometry, m/s."""
        if self._odometry is None:
            return 0.0
        linear = self._odometry.twist.twist.linear
        return math.hypot(linear.x, linear.y)

    def _scan_points(self, tree: TransformTree, T_map_base: Mat4) -> Points:
        scan, odometry = self._scan, self._odometry
        if scan is None or odometry is None or not len(scan.ranges):
            return []
        T_base_scan = tree.between(odometry.child_frame_id, scan.header.frame_id)
        if T_base_scan is None:
            return []
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        step = max(1, len(ranges) // _MOST_POINTS)
        angles = (scan.angle_min + scan.angle_increment * np.arange(len(ranges)))[::step]
        ranges = ranges[::step]
        good = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        ranges, angles = ranges[good], angles[good]
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros_like(ranges), np.ones_like(ranges)])
        placed = (T_map_base @ T_base_scan @ points)[:2].T
        return [(round(x, 3), round(y, 3)) for x, y in placed.tolist()]


def _matrix(pose: Any) -> Mat4:
    p, q = pose.position, pose.orientation
    return matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))


def _finite(points: Points) -> Points:
    """Returns the points that JSON can hold."""
    return [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]
