"""Receives serialized messages of many topics without an executor, all queued messages in one call."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.bags.metadata import TopicQos
from gibson_sim.bags.recording import TF
from gibson_sim.errors import RecordError
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class

DEPTH = 2000
"""Queue length of a subscription, messages: the disk may block for seconds."""
LARGE_DEPTH = 200
"""Queue length of a subscription to ``_LARGE`` messages."""
LATCHED_TRANSFORMS = 100
"""Queue length with which latched transforms are replayed, messages: each publisher has its own latched message."""
HOLD_S = 0.02
"""Time for which messages are held back, s of wall time: earlier messages of other topics may arrive after them."""
_LARGE = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2")


class ReceivedMessage(NamedTuple):
    """A serialized message with its time of publication."""

    sent_ns: int
    """Time of publication, ns of wall time; at most the time of arrival, since the publisher's clock may be ahead of ours."""
    topic: str
    data: bytes
    """CDR, with the encapsulation header of four bytes."""


class RawSubscriptions:
    """Subscriptions of a hidden node that no executor spins: one iteration of an executor costs more than polling forty topics."""

    def __init__(self, owner: Node) -> None:
        """Creates the hidden node, in the owner's namespace and context."""
        self._owner = owner
        self._node: Node | None = Node(
            f"_{owner.get_name()}_intake",
            namespace=owner.get_namespace(),
            context=owner.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._subscriptions: dict[str, Any] = {}
        self._lost_events: dict[str, Any] = {}
        self._lost_messages: dict[str, int] = {}
        self._lost_before: dict[str, int] = {}
        self._losses = LossCounter()
        self._held: list[ReceivedMessage] = []
        self._sent_ns: dict[str, int] = {}
        """Topic -> time of publication of its newest message, ns."""
        self._rounds: deque[tuple[float, int]] = deque()
        """Time of each call of ``receive`` (monotonic clock, s), and time of publication of the newest held message then, ns."""
        self._until_ns = 0
        """Time up to which all published messages have arrived, ns."""

    def subscribe(self, topic: str, type_name: str, profile: QoSProfile) -> None:
        """Subscribes to a topic.

        Raises:
            RecordError: the type is not installed.
        """
        assert self._node is not None, "the subscriptions are closed"
        try:
            message_type = message_class(type_name)
        except UNKNOWN:
            raise RecordError(f"its type {type_name} is not installed here") from None
        no_callbacks = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self._node.create_subscription(
            message_type, topic, _unused, profile, raw=True, event_callbacks=no_callbacks
        )
        self._subscriptions[topic] = subscription
        kind = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST
        try:
            self._lost_events[topic] = rclpy_implementation.EventHandle(subscription.handle, kind)
        except rclpy_implementation.UnsupportedEventTypeError:
            pass  # the middleware does not report losses; sequence numbers may show them

    def receive(self, *, flush: bool = False) -> list[ReceivedMessage]:
        """Returns the messages that arrived, in the order in which they were sent, except those of the last ``HOLD_S``.

        Args:
            flush: return all messages, also those of the last ``HOLD_S``.
        """
        now = time.monotonic()
        # Messages sent before those of an earlier call have arrived by now, and are read in this call.
        while self._rounds and self._rounds[0][0] <= now - HOLD_S:
            self._until_ns = self._rounds.popleft()[1]
        for topic, subscription in self._subscriptions.items():
            handle, message_type = subscription.handle, subscription.msg_type
            while (message := handle.take_message(message_type, True)) is not None:
                data, info = message
                self._losses.add(topic, info["publication_sequence_number"])
                sent, arrived = info["source_timestamp"], info["received_timestamp"]
                # A wall clock may be set back; the messages of a topic keep their order.
                sent = max(min(sent or arrived, arrived or sent), self._sent_ns.get(topic, 0))
                self._sent_ns[topic] = sent
                self._held.append(ReceivedMessage(sent, topic, data))
        self._held.sort(key=_sent_ns)
        if self._held:
            self._rounds.append((now, self._held[-1].sent_ns))
        count = len(self._held) if flush else bisect_right(self._held, self._until_ns, key=_sent_ns)
        received, self._held = self._held[:count], self._held[count:]
        return received

    def silent(self, topics: Iterable[str]) -> list[str]:
        """Returns the topics of which no message has arrived yet, in order."""
        return sorted(topic for topic in topics if topic in self._subscriptions and topic not in self._sent_ns)

    def unmatched_publishers(self) -> dict[str, tuple[int, int]]:
        """Returns topic -> number of matched publishers and of discovered ones, for topics with unmatched publishers.

        Removes topics with several publishers from ``lost``.
        """
        unmatched = {}
        for topic, subscription in self._subscriptions.items():
            matched, discovered = subscription.handle.get_publisher_count(), self._owner.count_publishers(topic)
            self._losses.set_publisher_count(topic, max(matched, discovered))
            if matched < discovered:
                unmatched[topic] = matched, discovered
        return unmatched

    def reset_losses(self) -> None:
        """Restarts the loss counts at 0."""
        self._losses = LossCounter()
        self._lost_before = self._total_lost()

    def lost(self) -> dict[str, int]:
        """Returns the number of lost messages of each topic, if it is known."""
        return self._losses.counts()

    def reported_lost(self) -> dict[str, int]:
        """Returns the number of messages that the middleware reports as lost, for topics with any."""
        counts = {topic: count - self._lost_before.get(topic, 0) for topic, count in self._total_lost().items()}
        return {topic: count for topic, count in sorted(counts.items()) if count}

    def _total_lost(self) -> dict[str, int]:
        """Returns the number of messages of each topic that the middleware has ever reported as lost."""
        for topic, event in self._lost_events.items():
            with event:
                status = event.take_event()
            if status is not None:
                self._lost_messages[topic] = max(self._lost_messages.get(topic, 0), status.total_count)
        return dict(self._lost_messages)

    def close(self) -> None:
        """Destroys the subscriptions; a second call does nothing."""
        node, self._node = self._node, None
        if node is not None:
            self._subscriptions.clear()
            self._lost_events.clear()
            node.destroy_node()


class LossCounter:
    """Counts gaps in the sequence numbers of topics that have one publisher.

    A publisher numbers all its messages, with or without subscribers. If a topic has several publishers, their numbers cannot be
    distinguished, and its losses are unknown from then on.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._mixed: set[str] = set()

    def add(self, topic: str, number: int | None) -> None:
        """Adds the sequence number of a message that arrived; None = the middleware does not provide it."""
        if number is None or topic in self._mixed:
            return
        last = self._last.get(topic)
        self._last[topic] = number
        self._lost.setdefault(topic, 0)
        # A lower number is from a new publisher, which starts at the beginning.
        if last is not None and number > last + 1:
            self._lost[topic] += number - last - 1

    def set_publisher_count(self, topic: str, count: int) -> None:
        """Sets the present number of a topic's publishers."""
        if count > 1 and topic not in self._mixed:
            self._mixed.add(topic)
            self._lost.pop(topic, None)

    def counts(self) -> dict[str, int]:
        """Returns the number of lost messages of each topic, if it is known."""
        return dict(sorted(self._lost.items()))


def recording_profile(publishers: list[Any], type_name: str) -> QoSProfile:
    """Returns the strictest QoS profile that matches all publishers of a topic, with a long queue."""
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=LARGE_DEPTH if type_name in _LARGE else DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def offered_qos(profile: QoSProfile, type_name: str) -> TopicQos:
    """Returns the QoS with which a replay publishes a topic; the ROS graph does not contain the queue lengths of publishers."""
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    depth = (LATCHED_TRANSFORMS if type_name == TF else 1) if latched else TopicQos().depth
    return replace(TopicQos.of(profile), depth=depth)


def _unused(_: Any) -> None:
    """Does nothing: the callback that rclpy requires, which no executor calls."""


def _sent_ns(message: ReceivedMessage) -> int:
    return message.sent_ns
