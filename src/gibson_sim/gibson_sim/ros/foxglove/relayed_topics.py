"""Relays topics of the ROS graph to channels of the Foxglove server: serialized messages, subscribed to only while a client is."""

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
"""Queue lengths of subscriptions, messages; short for large messages, since a lost image matters less than a late one."""


class RelayedTopics:
    """Subscribes to topics for clients.

    Args:
        node: node of the subscriptions.
        server: server that gets the messages.
        definitions: definitions of the message types.
        now_ns: returns the time shown to clients, ns.
    """

    def __init__(self, node: Node, server: FoxgloveServer, definitions: MessageDefinitions, now_ns: Callable[[], int]) -> None:
        self._node, self._server, self._definitions, self._now_ns = node, server, definitions, now_ns
        self._known: dict[str, TopicInfo] = {}
        self._subscriptions: dict[str, Any] = {}
        self._unknown: set[str] = set()
        """Types that are not installed."""

    def update(self) -> None:
        """Offers the topics that have publishers now to clients."""
        topics = {}
        for name, types in self._node.get_topic_names_and_types():
            if names.is_hidden(name) or not self._node.count_publishers(name):
                continue
            info = self._info(name, types)
            if info is not None:
                topics[name] = info
        if topics != self._known:
            self._known = topics
            self._server.serve_topics(topics.values())

    def _info(self, name: str, types: list[str]) -> TopicInfo | None:
        """Returns the description of a topic for clients; None, with one warning per type, if its type is not installed."""
        for type_name in types:  # several if nodes disagree: uses the first installed one
            try:
                message_class(type_name)
                return TopicInfo(name, type_name, self._definitions.full_text(type_name))
            except (*UNKNOWN, GibsonSimError):
                if type_name not in self._unknown:
                    self._unknown.add(type_name)
                    self._node.get_logger().warning(
                        f"topics of type {type_name} are not served: the type is not installed where the Foxglove server runs"
                    )
        return None

    def subscribe(self, topic: str) -> None:
        """Subscribes to a topic; for another client of a latched topic it subscribes again, so that the client gets the last message."""
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
        """Topics with a subscription."""
        return frozenset(self._subscriptions)

    def _on_message(self, topic: str, data: bytes) -> None:
        self._server.send(topic, data, self._now_ns())

    def _is_latched(self, topic: str) -> bool:
        publishers = self._node.get_publishers_info_by_topic(topic)
        return bool(publishers) and all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)

    def _profile(self, info: TopicInfo) -> QoSProfile:
        """Returns the strictest QoS profile that matches all publishers of a topic, but best effort for large messages."""
        publishers = self._node.get_publishers_info_by_topic(info.name)
        reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
        large = info.type_name in _LARGE
        return QoSProfile(
            depth=_LARGE_DEPTH if large else _DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable and not large else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if self._is_latched(info.name) else DurabilityPolicy.VOLATILE,
        )
