"""The joints of a robot that a page shows and moves: those with position limits."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from gibson_sim.description.urdf import parse_urdf
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.topics import names
from gibson_sim.types import NS_PER_S

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_PERIOD_NS = NS_PER_S // 5
"""Period at which positions are read, ns of wall time."""


class RobotJoints:
    """The joints of one robot.

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
            model = parse_urdf(msg.data, Path(f"{self._prefix}{names.ROBOT_DESCRIPTION}"), _no_mesh)
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
        self._next_ns = now + _PERIOD_NS
        msg = deserialize_message(data, JointState)
        self._positions.update(
            (name, round(position, 3)) for name, position in zip(msg.name, msg.position, strict=False) if math.isfinite(position)
        )


def _no_mesh(name: str, source: Path) -> None:
    """Finds no mesh: only joints are read."""
