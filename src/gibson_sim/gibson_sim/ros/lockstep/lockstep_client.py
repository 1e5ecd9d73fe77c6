"""Taking part in lockstep: a renderer, a controller, a replay."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.matching import reaches_all
from gibson_sim.ros.wire.fast_publish import FastTickDone

MATCHING_S, SETTLED_S = 10.0, 1.0
"""Within so long those who listen to a new publisher are known and can hear it; nobody has come for so long."""


def wait_for_readers(node: Node) -> None:
    """Returns once all who listen to a topic of a node can hear it, or after a while: a new process hears of the others one by one."""
    publishers = list(node.publishers)
    deadline, since, before = time.monotonic() + MATCHING_S, time.monotonic(), [-1]
    while time.monotonic() < min(deadline, since + SETTLED_S):
        readers = [publisher.get_subscription_count() for publisher in publishers]
        if readers != before or not all(reaches_all(node, publisher) for publisher in publishers):
            since, before = time.monotonic(), readers
        time.sleep(0.02)


class LockstepParticipant:
    """Tells a simulation in lockstep that a node has done its part of a tick; without lockstep nobody listens, and it costs nothing.

    Publishes:
        tick_done (gibson_msgs/TickDone).
    """

    def __init__(self, node: Node, after: str = "", *, watches: bool = False) -> None:
        """Takes part from the next tick on.

        Args:
            node: who takes part; it must listen to what it waits for by now.
            after: topic whose ticks count; ``cameras`` = ticks at which a camera is due; empty = every tick.
            watches: it has no part in what happens: time goes on without it where its node has gone.
        """
        self._messages: dict[tuple[str, ...], FastTickDone] = {}
        self.name = node.get_fully_qualified_name().lstrip("/")
        self._publisher = node.create_publisher(TickDone, names.TICK_DONE, qos.TICK_DONE)
        event = TickDone.WATCH if watches else TickDone.JOIN
        self._publisher.publish(TickDone(event=event, participant=self.name, after=after))

    @property
    def has_subscribers(self) -> bool:
        """Whether a simulation in lockstep listens."""
        return bool(self._publisher.get_subscription_count())

    def done(self, stamp: Any, sent: Sequence[str] = ()) -> None:
        """Says that a tick is done.

        Args:
            stamp: builtin_interfaces/Time, that of what the tick was known by.
            sent: topics on which commands were sent in this tick, once for each command: they count before time goes on.
        """
        if not self.has_subscribers:
            return
        message = self._messages.get(tuple(sent))
        if message is None:
            message = self._messages[tuple(sent)] = FastTickDone(TickDone.DONE, self.name, sent)
        self._publisher.publish(message.serialize(stamp.sec, stamp.nanosec))

    def leave(self) -> None:
        """Takes part no longer."""
        self._publisher.publish(TickDone(event=TickDone.LEAVE, participant=self.name))
