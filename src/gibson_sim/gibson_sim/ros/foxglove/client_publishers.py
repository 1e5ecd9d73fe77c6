"""Publishes the messages of Foxglove clients on ROS topics."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.yaml_messages import fill
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.web.foxglove_server import JSON, ClientTopic, message_from_json

_DEPTH = 10
_COMMANDS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
"""Types of velocity commands: a robot is stopped when the client that drives it disconnects."""
_STOPS = 3
"""Number of zero velocity commands that are published then."""


class ClientPublishers:
    """The publishers of clients, one for each channel."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publishers: dict[tuple[int, int], tuple[ClientTopic, Any, Any]] = {}
        """Key of a channel -> topic, message class, publisher."""
        self._moving: set[tuple[int, int]] = set()
        """Channels whose last velocity command was not zero."""
        self._retired: list[Any] = []
        """Publishers of closed channels, which are destroyed later."""

    def advertise(self, topic: ClientTopic) -> None:
        """Creates the publisher of a client's channel.

        Raises:
            ConfigError: the type is not installed, or the topic exists with another type.
        """
        try:
            kind = message_class(topic.type_name)
            publisher = self._node.create_publisher(kind, topic.name, _DEPTH)
        except UNKNOWN:
            raise ConfigError(
                f"topic {quoted(topic.name)}: type {quoted(topic.type_name)} is not installed where the Foxglove server runs"
            ) from None
        except Exception as error:  # from rclpy: the topic name is invalid, or this process uses the topic with another type
            raise ConfigError(f"topic {quoted(topic.name)} cannot be published as {topic.type_name}: {error}") from error
        self._publishers[topic.key] = (topic, kind, publisher)

    def publish(self, key: tuple[int, int], data: bytes) -> None:
        """Publishes a message of a client. It is decoded first, so that no node receives an invalid message.

        Raises:
            ConfigError, MessageValueError: the message cannot be decoded.
        """
        if key not in self._publishers:
            return  # the channel was refused
        topic, kind, publisher = self._publishers[key]
        if topic.encoding == JSON:
            message = fill(kind(), message_from_json(data))
        else:
            try:
                message = deserialize_message(data, kind)
            except Exception as error:
                raise ConfigError(f"topic {quoted(topic.name)}: {len(data)} bytes are not a {topic.type_name}") from error
        if topic.type_name in _COMMANDS:
            (self._moving.add if _is_moving(message) else self._moving.discard)(key)
        publisher.publish(message)

    def unadvertise(self, key: tuple[int, int]) -> None:
        """Closes a channel; a robot that it drives is stopped."""
        if key not in self._publishers:
            return
        _, kind, publisher = self._publishers.pop(key)
        if key in self._moving:
            self._moving.discard(key)
            for _ in range(_STOPS):
                publisher.publish(kind())
        self._retired.append(publisher)

    def clean_up(self) -> None:
        """Destroys publishers of channels that were closed before; called periodically, so that their last messages have arrived."""
        for publisher in self._retired:
            self._node.destroy_publisher(publisher)
        self._retired = []

    def close(self) -> None:
        """Closes all channels; robots that clients drive are stopped."""
        for key in list(self._publishers):
            self.unadvertise(key)


def _is_moving(message: Any) -> bool:
    twist = getattr(message, "twist", message)
    return any(getattr(part, axis) != 0.0 for part in (twist.linear, twist.angular) for axis in "xyz")
