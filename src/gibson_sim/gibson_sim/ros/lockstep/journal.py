"""What comes from outside and changes the simulation: written down at the step that obeys it, and taken back in at exactly that step."""

from __future__ import annotations

import heapq
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from gibson_msgs.msg import Input
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class, type_name_of
from gibson_sim.standard.requests import EPOCH_REQUESTS
from gibson_sim.standard.simulator import Simulator

logger = logging.getLogger(__name__)


@dataclass(order=True, slots=True)
class _Planned:
    """An input that waits for its step."""

    epoch: int
    step: int
    number: int
    name: str = field(compare=False)
    message: Any = field(compare=False)


class Journal:
    """The inputs of a run.

    Publishes:
        inputs (gibson_msgs/Input): every command and request that changed the simulation, with the step that was the first to obey.

    Subscribes:
        inputs_at (gibson_msgs/Input): inputs to obey at their step; one whose step is over is obeyed at once, with a warning.
    """

    def __init__(self, node: Node, simulator: Simulator, received: Callable[[str], None]) -> None:
        """Starts to listen; ``received`` is called with the topic when something arrived on ``inputs_at``."""
        self._simulator, self._received = simulator, received
        self._publisher = node.create_publisher(Input, names.INPUTS, **qos.overridable(qos.INPUTS))
        self._topic = node.resolve_topic_name(names.INPUTS_AT)
        node.create_subscription(Input, names.INPUTS_AT, self._on_input, qos.INPUTS_AT)
        self._planned: list[_Planned] = []
        self._count = 0
        self.late = 0
        """Inputs that came after their step."""

    def note(self, name: str, message: Any) -> None:
        """Publishes an input that the next step obeys, if anybody wants to know."""
        if not self._publisher.get_subscription_count():
            return
        simulator, type_name = self._simulator, type_name_of(type(message))
        world = simulator.world
        header = conversions.header_to_msg(0 if world is None else world.stamp_ns, "")
        out = Input(header=header, epoch=simulator.epoch, step=simulator.epoch_step, name=name, type=type_name)
        out.data = serialize_message(message)
        self._publisher.publish(out)

    def _on_input(self, msg: Any) -> None:
        try:
            message = deserialize_message(bytes(msg.data), message_class(msg.type))
        except (*UNKNOWN, RuntimeError) as error:
            logger.warning("an input for %s is left out, its type %r or its data cannot be read: %s", msg.name, msg.type, error)
        else:
            self._count += 1
            heapq.heappush(self._planned, _Planned(msg.epoch, msg.step, self._count, msg.name, message))
        self._received(self._topic)

    def due(self) -> list[tuple[str, Any]]:
        """Returns (name, message or request) of the planned inputs that the next step obeys, in their order."""
        if not self._planned:
            return []
        now = self._simulator.epoch, self._simulator.epoch_step
        found = []
        while self._planned and (self._planned[0].epoch, self._planned[0].step) <= now:
            planned = heapq.heappop(self._planned)
            if (planned.epoch, planned.step) < now:
                self.late += 1
                logger.warning("an input for %s came after its step %d of epoch %d", planned.name, planned.step, planned.epoch)
            found.append((planned.name, planned.message))
            if planned.name.endswith(EPOCH_REQUESTS):
                break  # what comes behind it may belong to the time after
        return found
