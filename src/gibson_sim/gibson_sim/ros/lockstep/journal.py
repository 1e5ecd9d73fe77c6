"""The journal of a run: all commands and requests that changed the simulation, each with the step at which it took effect.

A replay sends them with these steps, so that each takes effect at the same step again.
"""

from __future__ import annotations

import heapq
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from gibson_msgs.msg import Input
from gibson_sim.quoting import clipped, quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class, type_name_of
from gibson_sim.standard.requests import EPOCH_REQUESTS
from gibson_sim.standard.simulator import Simulator

logger = logging.getLogger(__name__)
_MAX_LENGTH = 300
"""Largest length of the reason why an input cannot be read, characters."""


@dataclass(order=True, slots=True)
class _ScheduledInput:
    """An input of a replay that waits for its step."""

    epoch: int
    step: int
    number: int
    """Number in order of arrival."""
    name: str = field(compare=False)
    message: Any = field(compare=False)


class Journal:
    """Publishes the inputs of a run, and schedules those of a replay.

    Publishes:
        inputs (gibson_msgs/Input): every command and request that changed the simulation, with the first step at which it is in effect.
        time_control (gibson_msgs/Input): every request that changed only how time passes, such as a pause; a replay leaves it out.

    Subscribes:
        inputs_at (gibson_msgs/Input): inputs to apply at their step; a late one is applied immediately, with a warning.
    """

    def __init__(self, node: Node, simulator: Simulator, on_received: Callable[[str], None]) -> None:
        """Creates the topics; ``on_received`` is called with the topic of each input that arrives."""
        self._simulator, self._on_received = simulator, on_received
        self._publisher = node.create_publisher(Input, names.INPUTS, **qos.overridable(qos.INPUTS))
        self._timing_publisher = node.create_publisher(Input, names.TIME_CONTROL, **qos.overridable(qos.INPUTS))
        self._topic = node.resolve_topic_name(names.INPUTS_AT)
        node.create_subscription(Input, names.INPUTS_AT, self._on_input, qos.INPUTS_AT)
        self._scheduled: list[_ScheduledInput] = []
        """Heap, by epoch, step and number."""
        self._count = 0
        self.late = 0
        """Number of inputs that arrived after their step."""

    def record(self, name: str, message: Any) -> None:
        """Publishes a command that takes effect at the next step, if ``inputs`` has subscribers."""
        if self._publisher.get_subscription_count():
            self._publisher.publish(self._input(name, message))

    def entry(self, name: str, request: Any, *, timing_only: bool) -> Callable[[], None]:
        """Returns a function that publishes a request, with the present step as the one at which it takes effect.

        Args:
            name: full name of the service.
            request: its request.
            timing_only: whether it changes only how time passes.
        """
        if timing_only:
            return partial(self._timing_publisher.publish, self._input(name, request))
        # Before the first step the recorder may be on its way: it receives the latched messages.
        is_wanted = self._publisher.get_subscription_count() or (self._simulator.epoch, self._simulator.epoch_step) == (0, 0)
        return partial(self._publisher.publish, self._input(name, request)) if is_wanted else lambda: None

    def _input(self, name: str, message: Any) -> Input:
        simulator, type_name = self._simulator, type_name_of(type(message))
        world = simulator.world
        header = conversions.header_to_msg(0 if world is None else world.stamp_ns, "")
        out = Input(header=header, epoch=simulator.epoch, step=simulator.epoch_step, name=name, type=type_name)
        out.data = serialize_message(message)
        return out

    def _on_input(self, msg: Any) -> None:
        try:
            message = deserialize_message(bytes(msg.data), message_class(msg.type))
        except (*UNKNOWN, RuntimeError) as error:
            text = "an input for %s is ignored: its type %s or its data cannot be read: %s"
            logger.warning(text, quoted(msg.name), quoted(msg.type), clipped(str(error), _MAX_LENGTH))
        else:
            self._count += 1
            heapq.heappush(self._scheduled, _ScheduledInput(msg.epoch, msg.step, self._count, msg.name, message))
        self._on_received(self._topic)

    def pop_due(self) -> list[tuple[str, Any]]:
        """Removes the scheduled inputs that are due at the next step; returns (name, message or request) of each, in order."""
        if not self._scheduled:
            return []
        now = self._simulator.epoch, self._simulator.epoch_step
        due = []
        while self._scheduled and (self._scheduled[0].epoch, self._scheduled[0].step) <= now:
            item = heapq.heappop(self._scheduled)
            if (item.epoch, item.step) < now:
                self.late += 1
                logger.warning("an input for %s arrived after its step %d of epoch %d", quoted(item.name), item.step, item.epoch)
            due.append((item.name, item.message))
            if item.name.endswith(EPOCH_REQUESTS):
                break  # the inputs after it may belong to the next epoch
        return due
