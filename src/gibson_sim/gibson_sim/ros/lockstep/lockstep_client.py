"""The client side of lockstep: a renderer, a controller or a replay takes part by its ``LockstepParticipant``."""

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
"""Wall time within which the subscribers of a new publisher are discovered and matched, s."""
SETTLED_S = 1.0
"""Wall time without a new match after which discovery counts as complete, s."""


class LockstepParticipant:
    """Reports to a simulation in lockstep which ticks a node has done. Without lockstep ``tick_done`` has no subscriber: reports cost nothing.

    Publishes:
        tick_done (gibson_msgs/TickDone).
    """

    def __init__(self, node: Node, after: str = "", *, watches: bool = False) -> None:
        """Joins: the simulation waits for this participant from the next tick on.

        Args:
            node: the participant's node; it must have subscribed to what it waits for.
            after: topic whose ticks count; ``cameras`` = ticks at which a camera is due; empty = every tick.
            watches: it only watches, as a recorder does: time goes on without it if its node has gone.
        """
        self._messages: dict[tuple[str, ...], FastTickDone] = {}
        self.name = node.get_fully_qualified_name().lstrip("/")
        self._publisher = node.create_publisher(TickDone, names.TICK_DONE, qos.TICK_DONE)
        event = TickDone.WATCH if watches else TickDone.JOIN
        self._publisher.publish(TickDone(event=event, participant=self.name, after=after))

    @property
    def has_subscribers(self) -> bool:
        """Whether a simulation in lockstep, or a recorder, subscribes to ``tick_done``."""
        return bool(self._publisher.get_subscription_count())

    def tick_done(self, stamp: Any, sent: Sequence[str] = ()) -> None:
        """Reports a tick as done.

        Args:
            stamp: builtin_interfaces/Time of the message that began the tick.
            sent: topics on which commands were sent in this tick, once for each command: the tick ends when they have arrived.
        """
        if not self.has_subscribers:
            return
        message = self._messages.get(tuple(sent))
        if message is None:
            message = self._messages[tuple(sent)] = FastTickDone(TickDone.DONE, self.name, sent)
        self._publisher.publish(message.serialize(stamp.sec, stamp.nanosec))

    def leave(self) -> None:
        """Leaves: the simulation no longer waits for this participant. Returns once the simulation has it: the process may end then."""
        self._publisher.publish(TickDone(event=TickDone.LEAVE, participant=self.name))
        wait_until_acknowledged(self._publisher)


def is_in_lockstep(node: Node) -> bool:
    """Returns whether the simulation that publishes ``scene_state`` subscribes to ``tick_done``: recorders do so in any run."""

    def nodes(endpoints: Sequence[Any]) -> set[tuple[str, str]]:
        return {(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints}

    simulations = nodes(node.get_publishers_info_by_topic(node.resolve_topic_name(names.SCENE_STATE)))
    return bool(simulations & nodes(node.get_subscriptions_info_by_topic(node.resolve_topic_name(names.TICK_DONE))))


def wait_for_subscribers(node: Node) -> None:
    """Blocks until all subscribers of a node's topics are matched, at most ``DISCOVERY_TIMEOUT_S``: a new process discovers them one by one."""
    publishers = list(node.publishers)
    deadline, since, before = time.monotonic() + DISCOVERY_TIMEOUT_S, time.monotonic(), [-1]
    while time.monotonic() < min(deadline, since + SETTLED_S):
        counts = [publisher.get_subscription_count() for publisher in publishers]
        if counts != before or not all(is_fully_matched(node, publisher) for publisher in publishers):
            since, before = time.monotonic(), counts
        time.sleep(0.02)
