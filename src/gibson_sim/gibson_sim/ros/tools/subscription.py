"""A subscription whose QoS profile follows the publishers of its topic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.ros.wire.message_types import type_name_of

_CHECK_S = 0.1
"""Period in which newly discovered publishers are checked, s of wall time."""
_DEPTH = 100
"""Number of received messages that wait for the callback, the newest ones."""


class AdaptiveSubscription:
    """Receives the messages of all publishers of a topic, also of those that are discovered after it was created.

    Until a publisher is discovered, it requests what all publishers offer: best effort, not latched. Then it subscribes again, as the publishers
    offer; and once more if a later one offers less. It does not request more than before: latched messages would be received twice.

    Args:
        node: node that subscribes; its owner spins it.
        message_type: class of the messages; publishers of other types are ignored.
        topic: full name of the topic.
        callback: called with each message, or with its serialized bytes if ``raw``.
        raw: whether messages stay serialized.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, callback: Callable[[Any], None], *, raw: bool) -> None:
        self._node, self._message_type, self._topic, self._callback, self._raw = node, message_type, topic, callback, raw
        self._type_name = type_name_of(message_type)
        self._early: list[Any] = []
        offered = self._offered()
        self._has_publisher = bool(offered)
        self._profile = relaxed(_STRICTEST, offered) if offered else _WEAKEST
        self._subscription = self._subscribe()
        self._timer = node.create_timer(_CHECK_S, self._check, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _offered(self) -> list[QoSProfile]:
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        return [info.qos_profile for info in publishers if info.topic_type == self._type_name]

    def _receive(self, message: Any) -> None:
        if self._has_publisher:
            self._callback(message)
        else:
            self._early.append(message)

    def _take_messages(self) -> None:
        """Receives the messages that wait for the executor; they would be lost with the subscription."""
        with self._subscription.handle:
            while (taken := self._subscription.handle.take_message(self._message_type, self._raw)) is not None:
                self._receive(taken[0])

    def _check(self) -> None:
        """Subscribes again if the discovered publishers require another profile."""
        offered, required = self._offered(), self._profile
        if offered:
            required = relaxed(self._profile if self._has_publisher else _STRICTEST, offered)
        if required != self._profile:
            self._take_messages()
            self._node.destroy_subscription(self._subscription)
            self._profile = required
            self._subscription = self._subscribe()
        self._has_publisher = self._has_publisher or bool(offered)
        early, self._early = self._early, []
        if required.durability != DurabilityPolicy.TRANSIENT_LOCAL:  # latched messages are received again
            for message in early:
                self._callback(message)

    def _subscribe(self) -> Any:
        # The default callbacks would warn of incompatible publishers, which `_check` handles.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        return self._node.create_subscription(
            self._message_type, self._topic, self._receive, self._profile, raw=self._raw, event_callbacks=events
        )


def relaxed(requested: QoSProfile, offered: Iterable[QoSProfile]) -> QoSProfile:
    """Returns a requested profile, made compatible with all offered ones."""
    profiles = (requested, *offered)
    return _profile(
        reliable=all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles),
        latched=all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in profiles),
    )


def _profile(*, reliable: bool, latched: bool) -> QoSProfile:
    return QoSProfile(
        depth=_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


_STRICTEST, _WEAKEST = _profile(reliable=True, latched=True), _profile(reliable=False, latched=False)
