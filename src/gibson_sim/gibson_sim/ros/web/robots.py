"""Shows and drives the robots of a ROS graph for a page: poses, scans, plans, estimates, joints, commands."""

from __future__ import annotations

import math
import time
from functools import partial
from pathlib import Path as FilePath
from typing import Any, Protocol

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from gibson_sim.description.urdf import parse_urdf
from gibson_sim.errors import GibsonSimError
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose
from gibson_sim.quoting import quoted
from gibson_sim.ros.client.simulation_client import flat_pose
from gibson_sim.ros.topics import names
from gibson_sim.ros.web.transform_tree import TransformTree
from gibson_sim.types import NS_PER_S, WORLD_FRAME, Pose
from gibson_sim.web.requests import Drive, Goal, InitialPose

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_LATCHED_MANY = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_MAX_POINTS = 400
"""Maximum number of points of a scan or a path that are sent to a page, approximately."""
_JOINTS_PERIOD_NS = NS_PER_S // 5
"""Period at which the positions of joints are read, ns of wall time."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_RADIUS_M = 0.25
"""Radius of a robot's arrow on the map, m."""
Points = list[tuple[float, float]]


class GraphNode(Protocol):
    """The methods of a node that this package uses."""

    def subscribe(self, kind: Any, topic: str, callback: Any, profile: Any, *, raw: bool = False) -> Any:
        """Subscribes to a topic, and returns the subscription; messages that cannot be shown are skipped."""

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any) -> Any:
        """Creates a publisher, as ``rclpy.node.Node`` does; the following methods also are those of ``rclpy.node.Node``."""

    def destroy_publisher(self, publisher: Any) -> bool:  # noqa: D102
        ...

    def destroy_subscription(self, subscription: Any) -> bool:  # noqa: D102
        ...

    def count_publishers(self, topic_name: str) -> int:  # noqa: D102
        ...

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[Any]:  # noqa: D102
        ...

    def stamp(self) -> Any:
        """Returns the present time: simulation time if there is a /clock."""


def robots_in(graph: list[tuple[str, list[str]]]) -> set[str]:
    """Returns the namespaces in which robots publish odometry; empty = no namespace. ``graph`` has (topic, types), as rclpy returns them."""
    suffix = f"/{names.ODOM}"
    namespaces = {name.removesuffix(suffix).strip("/") for name, types in graph if _ODOMETRY in types and name.endswith(suffix)}
    return {name for name in namespaces if not name.endswith("ground_truth")}


class Robot:
    """One robot: its pose, scan, plan and estimate, and its commands."""

    def __init__(self, node: GraphNode, name: str) -> None:
        """Subscribes to the topics of the robot; ``name`` is its namespace, empty = none."""
        self.name = name
        self.path: Points = []
        """Planned path, map frame, m."""
        self.estimate: dict[str, float] | None = None
        """Estimated position x, y (m) and 2-sigma ellipse (major, minor in m, angle in rad) from localisation; None = none."""
        self._node, self._prefix = node, f"/{name}/" if name else "/"
        self._odometry: Odometry | None = None
        self._truth: Odometry | None = None
        self._scan: LaserScan | None = None
        self._stamped = False
        self._publishers: dict[str, Any] = {}
        self._static = TransformTree()
        """Fixed transforms of a robot that publishes them in its namespace."""
        self.joints = RobotJoints(node, self._prefix)
        """Its joints that a page shows and moves."""
        self._subscriptions = [
            node.subscribe(Odometry, self._prefix + names.ODOM, partial(setattr, self, "_odometry"), _NEWEST),
            node.subscribe(Odometry, self._prefix + names.GROUND_TRUTH, partial(setattr, self, "_truth"), _NEWEST),
            node.subscribe(LaserScan, self._prefix + names.SCAN, partial(setattr, self, "_scan"), _NEWEST),
            node.subscribe(Path, f"{self._prefix}plan", self._on_path, _NEWEST),
            node.subscribe(PoseWithCovarianceStamped, f"{self._prefix}amcl_pose", self._on_estimate, _LATCHED),
        ]
        if name:
            topic = self._prefix + names.TF_STATIC.lstrip("/")
            self._subscriptions.append(node.subscribe(TFMessage, topic, self._static.add, _LATCHED_MANY))

    def close(self) -> None:
        """Destroys the subscriptions and publishers."""
        self.joints.close()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)

    @property
    def is_present(self) -> bool:
        """Whether the odometry of the robot has a publisher."""
        return self._node.count_publishers(self._prefix + names.ODOM) > 0

    def choose_type(self) -> None:
        """Selects TwistStamped for commands if all subscribers of cmd_vel use it, otherwise Twist."""
        subscribed = {info.topic_type for info in self._node.get_subscriptions_info_by_topic(self._prefix + names.CMD_VEL)}
        stamped = subscribed == {"geometry_msgs/msg/TwistStamped"}
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
        """Creates the publishers of goals and initial poses early, so that subscribers are matched before the first click."""
        self._publisher(PoseStamped, "goal_pose", 1)
        self._publisher(PoseWithCovarianceStamped, "initialpose", 1)

    def send(self, goal: Goal) -> tuple[bool, str]:
        """Publishes a goal or an initial pose; returns whether the topic has subscribers, and a text for the page."""
        pose = flat_pose(goal.x, goal.y, goal.z, goal.yaw)
        if not isinstance(goal, InitialPose):
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
        has_subscribers = publisher.get_subscription_count() > 0
        topic = (self._prefix + topic).lstrip("/")
        return has_subscribers, f"sent to {topic}" if has_subscribers else f"{topic} has no subscriber: no navigation stack runs"

    def _publisher(self, kind: Any, topic: str, depth: int) -> Any:
        if topic not in self._publishers:
            self._publishers[topic] = self._node.create_publisher(kind, self._prefix + topic, depth)
        return self._publishers[topic]

    def _on_path(self, msg: Path) -> None:
        points = [(p.pose.position.x, p.pose.position.y) for p in msg.poses]
        self.path = _finite(points[:: max(1, len(points) // _MAX_POINTS)])

    def _on_estimate(self, msg: PoseWithCovarianceStamped) -> None:
        p, c = msg.pose.pose.position, msg.pose.covariance
        self.estimate = None
        covariance = np.array([[c[0], c[1]], [c[6], c[7]]])
        if not np.isfinite(covariance).all() or not math.isfinite(p.x + p.y):
            return
        values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
        minor, major = (2.0 * np.sqrt(np.maximum(values, 0.0))).tolist()
        estimate = {"x": p.x, "y": p.y, "major": major, "minor": minor, "angle": math.atan2(axes[1, 1], axes[0, 1])}
        if all(map(math.isfinite, estimate.values())):
            self.estimate = estimate

    def page_values(self, tree: TransformTree) -> tuple[dict[str, Any], Points] | None:
        """Returns the values for the page, and the points of the newest scan, map frame, m; None = the pose is unknown."""
        T_map_base = self._pose(tree)
        if T_map_base is None:
            return None
        values = {
            "x": float(T_map_base[0, 3]),
            "y": float(T_map_base[1, 3]),
            "z": float(T_map_base[2, 3]),
            "yaw": math.atan2(T_map_base[1, 0], T_map_base[0, 0]),
            "radius": _RADIUS_M,
            "speed": self._speed,
        }
        if not all(map(math.isfinite, values.values())):
            return None
        return {"name": self.name or "robot", "namespace": self.name, **values}, _finite(self._scan_points(tree, T_map_base))

    def _pose(self, tree: TransformTree) -> Mat4 | None:
        """Returns T_map_base from tf if it has the map frame, otherwise from ground truth, otherwise from odometry."""
        if self._odometry is None:
            return None
        T_map_base = tree.between(WORLD_FRAME, self._odometry.child_frame_id)
        return T_map_base if T_map_base is not None else _matrix((self._truth or self._odometry).pose.pose)

    @property
    def _speed(self) -> float:
        """Horizontal speed from odometry, m/s."""
        if self._odometry is None:
            return 0.0
        linear = self._odometry.twist.twist.linear
        return math.hypot(linear.x, linear.y)

    def _scan_points(self, tree: TransformTree, T_map_base: Mat4) -> Points:
        scan, odometry = self._scan, self._odometry
        if scan is None or odometry is None or not len(scan.ranges):
            return []
        frames = (odometry.child_frame_id, scan.header.frame_id)
        T_base_scan = tree.between(*frames)
        if T_base_scan is None:
            T_base_scan = self._static.between(*frames)
        if T_base_scan is None:
            return []
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        step = max(1, len(ranges) // _MAX_POINTS)
        angles = (scan.angle_min + scan.angle_increment * np.arange(len(ranges)))[::step]
        ranges = ranges[::step]
        valid = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        ranges, angles = ranges[valid], angles[valid]
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), np.zeros_like(ranges), np.ones_like(ranges)])
        map_points = (T_map_base @ T_base_scan @ points)[:2].T
        return [(round(x, 3), round(y, 3)) for x, y in map_points.tolist()]


class RobotJoints:
    """The joints of one robot that a page shows and moves: those with position limits.

    Subscribes:
        robot_description (std_msgs/String): names and limits of the joints.
        joint_states (sensor_msgs/JointState): positions, deserialized a few times a second, and only for a robot with such joints.

    Publishes:
        joint_command (sensor_msgs/JointState): the position of a joint that a page moves; created with the first one.

    Args:
        node: node of the subscriptions, with ``subscribe``.
        prefix: namespace of the robot with slashes, such as ``/left/``.
    """

    def __init__(self, node: Any, prefix: str) -> None:
        self._node, self._prefix = node, prefix
        self._limits: dict[str, tuple[float, float, str]] = {}
        """Joint -> lower and upper limit, rad or m, and the unit."""
        self._positions: dict[str, float] = {}
        self._next_ns = 0
        self._publisher: Any = None
        self._subscriptions = [
            node.subscribe(String, prefix + names.ROBOT_DESCRIPTION, self._on_description, _LATCHED),
            node.subscribe(JointState, prefix + names.JOINT_STATES, self._on_states, _NEWEST, raw=True),
        ]

    def close(self) -> None:
        """Destroys the subscriptions and the publisher."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        if self._publisher is not None:
            self._node.destroy_publisher(self._publisher)

    def page_values(self) -> list[dict[str, Any]]:
        """Returns the values for the page: name, limits, position and unit of each joint."""
        return [
            {"name": name, "lower": lower, "upper": upper, "unit": unit, "position": self._positions[name]}
            for name, (lower, upper, unit) in self._limits.items()
            if name in self._positions
        ]

    def move(self, joint: str, position: float) -> tuple[bool, str]:
        """Commands the position of a joint, rad or m, within its limits; returns whether it was sent, and a text for the page."""
        if joint not in self._limits:
            return False, f"{quoted(joint)} is not a joint with limits of this robot"
        if self._publisher is None:
            self._publisher = self._node.create_publisher(JointState, self._prefix + names.JOINT_COMMAND, 10)
        lower, upper, _ = self._limits[joint]
        if not self._node.count_subscribers(self._prefix + names.JOINT_COMMAND):
            return (
                False,
                f"{(self._prefix + names.JOINT_COMMAND).lstrip('/')} has no subscriber: the robot takes no positions of joints",
            )
        self._publisher.publish(JointState(name=[joint], position=[min(max(position, lower), upper)]))
        return True, ""

    def _on_description(self, msg: String) -> None:
        try:
            model = parse_urdf(msg.data, FilePath(f"{self._prefix}{names.ROBOT_DESCRIPTION}"), _no_mesh)
        except GibsonSimError as error:
            raise ValueError(str(error)) from error
        self._limits = {
            joint.name: (joint.lower, joint.upper, "m" if joint.kind == "prismatic" else "rad")
            for joint in model.joints
            if joint.is_bounded and joint.has_motor and math.isfinite(joint.lower) and math.isfinite(joint.upper)
        }

    def _on_states(self, data: bytes) -> None:
        now = time.monotonic_ns()
        if not self._limits or now < self._next_ns:
            return
        self._next_ns = now + _JOINTS_PERIOD_NS
        msg = deserialize_message(data, JointState)
        self._positions.update(
            (name, round(position, 3)) for name, position in zip(msg.name, msg.position, strict=False) if math.isfinite(position)
        )


def _no_mesh(name: str, source: FilePath) -> None:
    """Finds no mesh: only joints are read."""


def _matrix(pose: Any) -> Mat4:
    p, q = pose.position, pose.orientation
    return matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))


def _finite(points: Points) -> Points:
    """Returns the finite points, since JSON has no other numbers."""
    return [(x, y) for x, y in points if math.isfinite(x) and math.isfinite(y)]
