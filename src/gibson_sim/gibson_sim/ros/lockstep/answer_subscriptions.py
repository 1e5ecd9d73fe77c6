"""Receives the messages by which lockstep knows nodes that know nothing of it: of any topic, of whatever type its publishers have."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.quoting import quoted
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.types import NS_PER_S

_DEPTH = 100
_PERIOD_NS = NS_PER_S // 10
"""Wall time between two queries of the graph, ns."""


@dataclass(slots=True)
class _Received:
    """A topic."""

    subscription: Any = None
    kind: tuple[str, bool, bool] = ("", True, False)
    """Type, and whether the subscription is reliable and latched."""
    problem: str = ""
    """Why no message can arrive."""


class AnswerSubscriptions:
    """Subscriptions to topics by name alone: the types are those that the graph tells. Messages arrive as bytes, which nobody reads."""

    def __init__(
        self, node: Node, topics: Collection[str], on_message: Callable[[str], None], is_command: Callable[[str], bool]
    ) -> None:
        """Subscribes to nothing yet.

        Args:
            node: that subscribes.
            topics: full names without the leading slash.
            on_message: is called with the topic of each message.
            is_command: whether the node itself subscribes to a topic, given its full name: then this does not.
        """
        self._node, self._on_message, self._is_command = node, on_message, is_command
        self._topics = {topic: _Received(problem=f"no publisher on {topic}") for topic in sorted(topics)}
        self._looked_ns: int | None = None
        self._complete = not topics

    def find(self, now_ns: int, *, again: bool = False) -> None:
        """Subscribes to topics that have appeared, now and then; costs nothing once all are found.

        Args:
            now_ns: now, of any steady clock.
            again: look at all topics again: a publisher may have come with another type, reliability or durability.
        """
        if (again or not self._complete) and (self._looked_ns is None or now_ns - self._looked_ns > _PERIOD_NS):
            self._looked_ns = now_ns
            for topic, received in self._topics.items():
                self._update(topic, received)
            self._complete = all(not received.problem for received in self._topics.values())

    def is_matched(self, topic: str) -> bool:
        """Returns whether the messages of all present publishers of a topic arrive here; a topic that nobody has yet counts as matched."""
        publishers = self._node.count_publishers(f"/{topic}")
        if self._is_command(f"/{topic}"):
            return True
        received = self._topics[topic]
        if received.subscription is None:
            return not publishers and not self._node.count_subscribers(f"/{topic}")
        return bool(received.subscription.handle.get_publisher_count() >= publishers)

    def problem(self, topic: str) -> str:
        """Returns why no message of a topic can arrive, in words; empty = one can."""
        if not self._node.count_publishers(f"/{topic}"):
            return f"no publisher on {topic}"
        return "" if self._is_command(f"/{topic}") else self._topics[topic].problem

    def _update(self, topic: str, received: _Received) -> None:
        if self._is_command(f"/{topic}"):
            self._end(received)
            received.problem = ""
            return
        publishers = self._node.get_publishers_info_by_topic(f"/{topic}")
        # Who waits for a topic tells its type as well: what comes first on it is not lost then.
        types = sorted({p.topic_type for p in publishers or self._node.get_subscriptions_info_by_topic(f"/{topic}")})
        received.problem = f"no publisher on {topic}"
        if len(types) > 1:
            received.problem = f"{topic} has several types, {', '.join(types)}; remap all but one"
        elif types:
            if publishers:
                received.problem = ""
            # As much as all publishers offer: a latched goal arrives though it was published before this subscription was there.
            profiles = [publisher.qos_profile for publisher in publishers]
            reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
            latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
            self._subscribe(topic, received, (types[0], reliable, latched))

    def _subscribe(self, topic: str, received: _Received, kind: tuple[str, bool, bool]) -> None:
        if received.subscription is not None and received.kind == kind:
            return
        self._end(received)
        try:
            message_type = message_class(kind[0])
        except UNKNOWN:
            received.problem = f"the type of {topic}, {quoted(kind[0])}, is not installed where the simulation runs"
            return
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if kind[1] else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if kind[2] else DurabilityPolicy.VOLATILE,
        )
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)
        try:
            received.subscription = self._node.create_subscription(
                message_type, f"/{topic}", partial(self._receive, topic), profile, raw=True, event_callbacks=silent
            )
        except RuntimeError:  # a DDS participant has a topic under one type
            received.problem = f"the simulation itself has {topic} under another type than {kind[0]}"
        else:
            received.kind = kind

    def _receive(self, topic: str, _: bytes) -> None:
        if not self._is_command(f"/{topic}"):
            self._on_message(topic)

    def _end(self, received: _Received) -> None:
        if received.subscription is not None:
            self._node.destroy_subscription(received.subscription)
            received.subscription = None
