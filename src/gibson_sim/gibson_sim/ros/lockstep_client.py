"""Taking part in lockstep: a renderer, a controller, a replay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.ros import names, qos


class LockstepParticipant:
    """Tells a simulation in lockstep that a node has done its part of a tick; without lockstep nobody listens, and it costs nothing.

    Publishes:
        tick_done (gibson_msgs/TickDone).
    """

    def __init__(self, node: Node, after: str = "", name: str = "") -> None:
        """Takes part from the next tick on.

        Args:
            node: who takes part; it must listen to what it waits for by now.
            after: topic whose ticks count; ``cameras`` = ticks at which a camera is due; empty = every tick.
            name: unique among the participants; empty = the name of the node.
        """
        self.name = name or node.get_name()
        self._publisher = node.create_publisher(TickDone, names.TICK_DONE, qos.TICK_DONE)
        self._publisher.publish(TickDone(event=TickDone.JOIN, participant=self.name, after=after))

    def done(self, stamp: Any, sent: Sequence[str] = ()) -> None:
        """Says that a tick is done.

        Args:
            stamp: builtin_interfaces/Time, that of what the tick was known by.
            sent: topics on which commands were sent in this tick, once for each command: they count before time goes on.
        """
        if self._publisher.get_subscription_count():
            message = TickDone(event=TickDone.DONE, participant=self.name, stamp=stamp)
            message.sent = list(sent)
            self._publisher.publish(message)

    def leave(self) -> None:
        """Takes part no longer."""
        self._publisher.publish(TickDone(event=TickDone.LEAVE, participant=self.name))
