"""Warns of publishers whose commands no robot receives: those of another message type, which DDS never matches and does not report."""

from __future__ import annotations

from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node

from gibson_sim.ros.topics import names
from gibson_sim.ros.topics.stamped_commands import StampedCommands
from gibson_sim.ros.wire.message_types import type_name_of

_TWISTS = {type_name_of(Twist): "twist", type_name_of(TwistStamped): "stamped"}
"""Type of velocity commands -> value of ``cmd_vel_type`` that receives it."""


class IncompatiblePublishers:
    """Logs a warning for each publisher whose message type a node does not receive, and for each that commands a robot that has gone."""

    def __init__(self, node: Node, stamped: StampedCommands | None) -> None:
        """Checks the topics that ``node`` subscribes to at the time of each check, and those with a second type in ``stamped``."""
        self._node, self._stamped = node, stamped
        self._reported: set[tuple[str, str, str]] = set()
        self._command_topics: set[str] = set()
        """Topics of velocity commands that the node has subscribed to, also those of robots that have gone."""

    def check(self) -> None:
        """Warns once of each incompatible publisher that has appeared since the last check."""
        types, incompatible = self._subscribed_types(), set()
        self._command_topics |= {topic for topic in types if _is_velocity_command(topic)}
        for topic in types.keys() | self._command_topics:
            for publisher in self._node.get_publishers_info_by_topic(topic):
                if publisher.topic_type not in types.get(topic, ()):
                    name = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
                    incompatible.add((topic, name, publisher.topic_type))
        for topic, name, type_name in sorted(incompatible - self._reported):
            received_types = sorted(types.get(topic, ()))
            if not received_types:
                self._node.get_logger().warning(
                    f"{topic}: {name} publishes commands, but the world has no robot that receives them; "
                    "`gibson-sim spawn gibson_bot --at X,Y` adds one"
                )
                continue
            self._node.get_logger().warning(
                f"{topic}: {name} publishes {type_name}, which is not received: this topic receives {' and '.join(received_types)}; "
                f"{_remedy(topic, type_name, received_types)}"
            )
        self._reported = incompatible

    def _subscribed_types(self) -> dict[str, set[str]]:
        """Returns topic -> names of the types that are received on it."""
        types: dict[str, set[str]] = {}
        for subscription in self._node.subscriptions:
            types.setdefault(subscription.topic_name, set()).add(type_name_of(subscription.msg_type))
        for topic, kind in ({} if self._stamped is None else self._stamped.types).items():
            types.setdefault(topic, set()).add(type_name_of(kind))
        return types


def _is_velocity_command(topic: str) -> bool:
    return topic.rpartition("/")[2] == names.CMD_VEL


def _remedy(topic: str, type_name: str, received_types: list[str]) -> str:
    if type_name in _TWISTS and _is_velocity_command(topic):
        return f"start the simulation with cmd_vel_type both or {_TWISTS[type_name]}, or publish {received_types[0]}"
    return f"publish {received_types[0]}"
