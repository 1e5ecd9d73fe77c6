"""The topics of the ROS graph as channels of the Foxglove server: bytes as they are, received while a client subscribes and no longer."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.topics import names
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.web.foxglove_server import FoxgloveServer, TopicInfo

_LARGE = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2")
_DEPTH, _LARGE_DEPTH = 100, 2
"""Lengths of queues, messages. A lost image matters less than one that comes late."""


class RelayedTopics:
    """Subscribes for clients.

    Args:
        node: subscribes.
        server: gets the messages.
        definitions: of the types.
        now_ns: returns the time of the clock that clients see, nanoseconds.
    """

    def __init__(self, node: Node, server: FoxgloveServer, definitions: MessageDefinitions, now_ns: Callable[[], int]) -> None:
        self._node, self._server, self._definitions, self._now_ns = node, server, definitions, now_ns
        self._known: dict[str, TopicInfo] = {}
        self._subscriptions: dict[str, Any] = {}
        self._unknown: set[str] = set()
        """Types that are not installed here."""

    def update(self) -> None:
        """Offers the topics that have publishers now."""
        found = {}
        for name, types in self._node.get_topic_names_and_types():
            if names.is_hidden(name) or not self._node.count_publishers(name):
                continue
            info = self._info(name, types)
            if info is not None:
                found[name] = info
        if found != self._known:
            self._known = found
            self._server.serve_topics(found.values())

    def _info(self, name: str, types: list[str]) -> TopicInfo | None:
        """Returns what clients are told of a topic; None, with one warning for each type, where its type is not installed."""
        for type_name in types:  # several where nodes disagree: the first that is known here
            try:
                message_class(type_name)
                return TopicInfo(name, type_name, self._definitions.full_text(type_name))
            except (*UNKNOWN, GibsonSimError):
                if type_name not in self._unknown:
                    self._unknown.add(type_name)
                    self._node.get_logger().warning(f"topics of type {type_name} are not served: the type is not installed here")
        return None

    def subscribe(self, topic: str) -> None:
        """Subscribes to a topic; anew for a further client of a latched one, which gets its last message by that."""
        if topic in self._subscriptions and not self._is_latched(topic):
            return
        self.unsubscribe(topic)
        info = self._known.get(topic)
        if info is None:
            return
        receive = partial(self._on_message, topic)
        self._subscriptions[topic] = self._node.create_subscription(
            message_class(info.type_name), topic, receive, self._profile(info), raw=True
        )

    def unsubscribe(self, topic: str) -> None:
        """Ends the subscription of a topic."""
        subscription = self._subscriptions.pop(topic, None)
        if subscription is not None:
            self._node.destroy_subscription(subscription)

    @property
    def subscribed(self) -> frozenset[str]:
        """Topics that are subscribed to."""
        return frozenset(self._subscriptions)

    def _on_message(self, topic: str, data: bytes) -> None:
        self._server.send(topic, data, self._now_ns())

    def _is_latched(self, topic: str) -> bool:
        publishers = self._node.get_publishers_info_by_topic(topic)
        return bool(publishers) and all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)

    def _profile(self, info: TopicInfo) -> QoSProfile:
        """Returns a profile that all publishers of a topic match: as latched as they are; reliable if they are, but for large messages."""
        publishers = self._node.get_publishers_info_by_topic(info.name)
        reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
        large = info.type_name in _LARGE
        return QoSProfile(
            depth=_LARGE_DEPTH if large else _DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable and not large else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self._is_latched(info.name) else DurabilityPolicy.VOLATILE,
        )
