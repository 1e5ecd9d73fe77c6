"""Takes messages of many topics as bytes, all that wait at once, without an executor between."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections import deque
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


class Losses:
    """Gaps in the sequence numbers of topics that have one publisher.

    A publisher numbers all it sends, whoever listens. Where several publish on a topic their numbers cannot be told apart, so
    nothing is known of it from then on.
    """

    def __init__(self) -> None:
        self._last: dict[str, int] = {}
        self._lost: dict[str, int] = {}
        self._mixed: set[str] = set()

    def note(self, topic: str, number: int | None) -> None:
        """Takes the number of a message that came; None = this middleware has none."""
        if number is None or topic in self._mixed:
            return
        last = self._last.get(topic)
        self._last[topic] = number
        self._lost.setdefault(topic, 0)
        # A lower number is one of a new publisher, which began anew.
        if last is not None and number > last + 1:
            self._lost[topic] += number - last - 1

    def note_publishers(self, topic: str, count: int) -> None:
        """Takes how many publish on a topic now."""
        if count > 1 and topic not in self._mixed:
            self._mixed.add(topic)
            self._lost.pop(topic, None)

    def counts(self) -> dict[str, int]:
        """Returns the lost messages of each topic of which that is known."""
        return dict(sorted(self._lost.items()))


DEPTH = 2000
"""Messages of a topic that may wait: the disk may stand still for seconds."""
LARGE_DEPTH = 200
LATCHED_TRANSFORMS = 100
"""Messages that a replay of latched transforms keeps for late joiners: each sender has its own."""
HOLD_S = 0.02
"""So long messages are held back, wall time: what was sent before them on another topic may come after them."""
_LARGE = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2")
"""Types of which fewer wait, since each message is large."""


class Taken(NamedTuple):
    """A message that came."""

    sent_ns: int
    """When it was published, nanoseconds of wall time; never after it came, where the publisher's clock is ahead of ours."""
    topic: str
    data: bytes
    """CDR, with its four bytes of encapsulation."""


class Intake:
    """Subscriptions of a hidden node that no executor knows: a turn of one costs more than to take what waits on forty topics."""

    def __init__(self, owner: Node) -> None:
        """Makes the node, beside its owner."""
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
        self._losses = Losses()
        self._held: list[Taken] = []
        self._sent_ns: dict[str, int] = {}
        self._rounds: deque[tuple[float, int]] = deque()
        """When something was held (monotonic clock), and when the newest of it was sent."""
        self._until_ns = 0

    def subscribe(self, topic: str, type_name: str, profile: QoSProfile) -> None:
        """Subscribes to a topic.

        Raises:
            RecordError: the type is not installed here.
        """
        assert self._node is not None, "the intake is closed"
        try:
            message_type = message_class(type_name)
        except UNKNOWN:
            raise RecordError(f"its type {type_name} is not installed here") from None
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        subscription = self._node.create_subscription(message_type, topic, _ignore, profile, raw=True, event_callbacks=silent)
        self._subscriptions[topic] = subscription
        kind = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST
        try:
            self._lost_events[topic] = rclpy_implementation.EventHandle(subscription.handle, kind)
        except rclpy_implementation.UnsupportedEventTypeError:
            pass  # a middleware that does not say; the sequence numbers may

    def take(self, *, all_of_it: bool = False) -> list[Taken]:
        """Returns what came, in the order in which it was sent, but for what was sent just now.

        Args:
            all_of_it: hold nothing back.
        """
        now = time.monotonic()
        # What was sent before a message of an earlier round has come by now, and is read in this one.
        while self._rounds and self._rounds[0][0] <= now - HOLD_S:
            self._until_ns = self._rounds.popleft()[1]
        for topic, subscription in self._subscriptions.items():
            handle, message_type = subscription.handle, subscription.msg_type
            while (message := handle.take_message(message_type, True)) is not None:
                data, info = message
                self._losses.note(topic, info["publication_sequence_number"])
                sent, came = info["source_timestamp"], info["received_timestamp"]
                # A wall clock may be set back; the messages of a topic keep their order.
                sent = max(min(sent or came, came or sent), self._sent_ns.get(topic, 0))
                self._sent_ns[topic] = sent
                self._held.append(Taken(sent, topic, data))
        self._held.sort(key=_sent)
        if self._held:
            self._rounds.append((now, self._held[-1].sent_ns))
        count = len(self._held) if all_of_it else bisect_right(self._held, self._until_ns, key=_sent)
        taken, self._held = self._held[:count], self._held[count:]
        return taken

    def count_publishers(self) -> dict[str, tuple[int, int]]:
        """Looks who publishes; returns, of topics with publishers that we cannot hear, how many are heard and how many there are.

        Of topics with several publishers it is not known any more what was lost.
        """
        unheard = {}
        for topic, subscription in self._subscriptions.items():
            heard, there = subscription.handle.get_publisher_count(), self._owner.count_publishers(topic)
            self._losses.note_publishers(topic, max(heard, there))
            if heard < there:
                unheard[topic] = heard, there
        return unheard

    def forget_losses(self) -> None:
        """Counts losses from now on."""
        self._losses = Losses()
        self._lost_before = self._lost_messages_until_now()

    def lost(self) -> dict[str, int]:
        """Returns how many messages never came, of each topic of which that is known."""
        return self._losses.counts()

    def reported_lost(self) -> dict[str, int]:
        """Returns how many messages the middleware reports as lost, of topics with such."""
        found = {topic: count - self._lost_before.get(topic, 0) for topic, count in self._lost_messages_until_now().items()}
        return {topic: count for topic, count in sorted(found.items()) if count}

    def _lost_messages_until_now(self) -> dict[str, int]:
        for topic, event in self._lost_events.items():
            with event:
                status = event.take_event()
            if status is not None:
                self._lost_messages[topic] = max(self._lost_messages.get(topic, 0), status.total_count)
        return dict(self._lost_messages)

    def close(self) -> None:
        """Ends the subscriptions; a second time does nothing."""
        node, self._node = self._node, None
        if node is not None:
            self._subscriptions.clear()
            self._lost_events.clear()
            node.destroy_node()


def recording_profile(publishers: list[Any], type_name: str) -> QoSProfile:
    """Returns a profile as reliable and as latched as all publishers of a topic allow, with room for many messages."""
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
    """Returns the quality of service with which a replay publishes a topic; the graph does not tell how many its publishers keep."""
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    depth = (LATCHED_TRANSFORMS if type_name == TF else 1) if latched else TopicQos().depth
    return replace(TopicQos.of(profile), depth=depth)


def _ignore(_: Any) -> None:
    """Stands where rclpy wants a callback: no executor calls it."""


def _sent(taken: Taken) -> int:
    return taken.sent_ns
