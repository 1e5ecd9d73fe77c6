"""Subscribes to the answers of nodes without lockstep support: topics of any type, which is read from the ROS graph."""

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
class _AnswerTopic:
    """State of one topic."""

    subscription: Any = None
    kind: tuple[str, bool, bool] = ("", True, False)
    """Message type, and whether the subscription is reliable and latched."""
    problem: str = ""
    """Reason why no message can arrive; empty = one can."""


class AnswerSubscriptions:
    """Subscriptions to topics given by name; the types come from the ROS graph. Messages are received raw and not deserialized."""

    def __init__(
        self, node: Node, topics: Collection[str], on_message: Callable[[str], None], is_command: Callable[[str], bool]
    ) -> None:
        """Creates no subscription yet; see ``find``.

        Args:
            node: node of the subscriptions.
            topics: full names without the leading slash.
            on_message: called with the topic of each message.
            is_command: returns whether the node itself subscribes to a topic, given its full name; such topics are skipped here.
        """
        self._node, self._on_message, self._is_command = node, on_message, is_command
        self._topics = {topic: _AnswerTopic(problem=f"no publisher on {topic}") for topic in sorted(topics)}
        self._queried_ns: int | None = None
        self._complete = not topics

    def find(self, now_ns: int, *, again: bool = False) -> None:
        """Subscribes to topics that have appeared, at most once every ``_PERIOD_NS``; costs nothing once all are found.

        Args:
            now_ns: now, of any monotonic clock, ns.
            again: query all topics again, since a new publisher may have another type, reliability or durability.
        """
        if (again or not self._complete) and (self._queried_ns is None or now_ns - self._queried_ns > _PERIOD_NS):
            self._queried_ns = now_ns
            for topic, state in self._topics.items():
                self._update(topic, state)
            self._complete = all(not state.problem for state in self._topics.values())

    def is_matched(self, topic: str) -> bool:
        """Returns whether all present publishers of a topic are matched; a topic without publishers and subscribers counts as matched."""
        publishers = self._node.count_publishers(f"/{topic}")
        if self._is_command(f"/{topic}"):
            return True
        state = self._topics[topic]
        if state.subscription is None:
            return not publishers and not self._node.count_subscribers(f"/{topic}")
        return bool(state.subscription.handle.get_publisher_count() >= publishers)

    def problem(self, topic: str) -> str:
        """Returns the reason why no message of a topic can arrive, as text; empty = one can."""
        if not self._node.count_publishers(f"/{topic}"):
            return f"no publisher on {topic}"
        return "" if self._is_command(f"/{topic}") else self._topics[topic].problem

    def _update(self, topic: str, state: _AnswerTopic) -> None:
        if self._is_command(f"/{topic}"):
            self._end(state)
            state.problem = ""
            return
        publishers = self._node.get_publishers_info_by_topic(f"/{topic}")
        # Subscribers also report the type of a topic: with it, the first message of a later publisher is not lost.
        types = sorted({p.topic_type for p in publishers or self._node.get_subscriptions_info_by_topic(f"/{topic}")})
        state.problem = f"no publisher on {topic}"
        if len(types) > 1:
            state.problem = f"{topic} has several types, {', '.join(types)}; remap all but one"
        elif types:
            if publishers:
                state.problem = ""
            # The strictest QoS that all publishers offer: a latched goal arrives even if it was published before this subscription existed.
            profiles = [publisher.qos_profile for publisher in publishers]
            reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
            latched = bool(profiles) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles)
            self._subscribe(topic, state, (types[0], reliable, latched))

    def _subscribe(self, topic: str, state: _AnswerTopic, kind: tuple[str, bool, bool]) -> None:
        if state.subscription is not None and state.kind == kind:
            return
        self._end(state)
        try:
            message_type = message_class(kind[0])
        except UNKNOWN:
            state.problem = f"the type of {topic}, {quoted(kind[0])}, is not installed where the simulation runs"
            return
        profile = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if kind[1] else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if kind[2] else DurabilityPolicy.VOLATILE,
        )
        no_callbacks = SubscriptionEventCallbacks(use_default_callbacks=False)
        try:
            state.subscription = self._node.create_subscription(
                message_type, f"/{topic}", partial(self._receive, topic), profile, raw=True, event_callbacks=no_callbacks
            )
        except RuntimeError:  # a DDS participant can have a topic under one type only
            state.problem = f"the simulation itself uses {topic} with another type than {kind[0]}"
        else:
            state.kind = kind

    def _receive(self, topic: str, _: bytes) -> None:
        if not self._is_command(f"/{topic}"):
            self._on_message(topic)

    def _end(self, state: _AnswerTopic) -> None:
        if state.subscription is not None:
            self._node.destroy_subscription(state.subscription)
            state.subscription = None
