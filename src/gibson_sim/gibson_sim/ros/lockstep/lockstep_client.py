"""The client side of lockstep: a renderer, a controller or a replay participates by a ``LockstepParticipant``."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import is_fully_matched, wait_until_acknowledged
from gibson_sim.ros.wire.fast_publish import FastTickDone

DISCOVERY_TIMEOUT_S = 10.0
"""Timeout for the discovery and matching of the subscribers of a new publisher, s of wall time."""
SETTLED_S = 1.0
"""Time without a new match after which discovery counts as complete, s of wall time."""


class LockstepParticipant:
    """Reports the ticks that a node has finished to a simulation in lockstep.

    Without lockstep ``tick_done`` has no subscriber, and reports cost nothing.

    Publishes:
        tick_done (gibson_msgs/TickDone).
    """

    def __init__(self, node: Node, after: str = "", *, passive: bool = False) -> None:
        """Joins: the simulation waits for this participant from the next tick on.

        Args:
            node: node of the participant; it must have subscribed to the topics that it waits for.
            after: topic at whose ticks time waits for it; ``cameras`` = ticks at which a camera is due; empty = every tick.
            passive: the participant only observes, as a recorder does: time continues without it if its node is gone.
        """
        self._messages: dict[tuple[str, ...], FastTickDone] = {}
        self.name = node.get_fully_qualified_name().lstrip("/")
        self._publisher = node.create_publisher(TickDone, names.TICK_DONE, qos.TICK_DONE)
        event = TickDone.WATCH if passive else TickDone.JOIN
        self._publisher.publish(TickDone(event=event, participant=self.name, after=after))

    @property
    def has_subscribers(self) -> bool:
        """Whether a simulation in lockstep, or a recorder, subscribes to ``tick_done``."""
        return bool(self._publisher.get_subscription_count())

    def tick_done(self, stamp: Any, sent: Sequence[str] = ()) -> None:
        """Reports a tick as done.

        Args:
            stamp: builtin_interfaces/Time of the message that began the tick.
            sent: topic of each command that was sent in this tick: the tick ends when all of them have arrived.
        """
        if not self.has_subscribers:
            return
        message = self._messages.get(tuple(sent))
        if message is None:
            message = self._messages[tuple(sent)] = FastTickDone(TickDone.DONE, self.name, sent)
        self._publisher.publish(message.serialize(stamp.sec, stamp.nanosec))

    def leave(self) -> None:
        """Leaves: the simulation no longer waits for this participant. Returns once the report is acknowledged, so the process may end."""
        self._publisher.publish(TickDone(event=TickDone.LEAVE, participant=self.name))
        wait_until_acknowledged(self._publisher)


def is_in_lockstep(node: Node) -> bool:
    """Returns whether the node that publishes ``scene_state`` subscribes to ``tick_done``; other nodes, recorders, always may."""

    def nodes(endpoints: Sequence[Any]) -> set[tuple[str, str]]:
        return {(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints}

    simulations = nodes(node.get_publishers_info_by_topic(node.resolve_topic_name(names.SCENE_STATE)))
    return bool(simulations & nodes(node.get_subscriptions_info_by_topic(node.resolve_topic_name(names.TICK_DONE))))


def wait_for_subscribers(node: Node) -> None:
    """Blocks until all subscribers of a node's topics are matched, at most ``DISCOVERY_TIMEOUT_S``: a new process discovers them one by one."""
    publishers = list(node.publishers)
    deadline, changed, previous = time.monotonic() + DISCOVERY_TIMEOUT_S, time.monotonic(), [-1]
    while time.monotonic() < min(deadline, changed + SETTLED_S):
        counts = [publisher.get_subscription_count() for publisher in publishers]
        if counts != previous or not all(is_fully_matched(node, publisher) for publisher in publishers):
            changed, previous = time.monotonic(), counts
        time.sleep(0.02)
