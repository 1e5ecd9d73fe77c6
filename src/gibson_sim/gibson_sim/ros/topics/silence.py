"""Tells once why nothing comes to a node that waits for messages of a simulation: most often its time is paused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import GetSimulationState

SILENT_S = 3.0
"""Wall time without a message after which a node says what it waits for, s."""
_ANSWER_S = 5.0
"""Wall time for the simulation to tell its state, s."""
_TYPE = "simulation_interfaces/srv/GetSimulationState"
_STANDS = {SimulationState.STATE_PAUSED: "paused", SimulationState.STATE_STOPPED: "stopped"}


class SilenceNotice:
    """Asks the simulation for its state when nothing has come for a while, and tells what follows from it.

    Args:
        node: waits, and is spun by its owner.
        tell: is called at most once, with one line.
        otherwise: returns what to tell if time is not paused; None = nothing.
        now_s: wall time at which the waiting begins, s.
    """

    def __init__(self, node: Node, tell: Callable[[str], None], otherwise: Callable[[], str] | None, now_s: float) -> None:
        self._node, self._tell, self._otherwise, self._began_s = node, tell, otherwise, now_s
        self._answer: Any = None
        self._ended = False
        self._client: Any = None

    def end(self) -> None:
        """Ends the waiting: a message has come."""
        self._ended = True

    def check(self, now_s: float) -> None:
        """Tells what there is to tell at a wall time, s; to be called again and again while nothing comes."""
        waited_s = now_s - self._began_s
        if self._ended or waited_s < SILENT_S:
            return
        if self._client is None and (name := self._service()):
            self._client = self._node.create_client(GetSimulationState, name)
        if self._answer is None and self._client is not None and self._client.service_is_ready():
            self._answer = self._client.call_async(GetSimulationState.Request())
        if self._answer is not None and self._answer.done():
            self._conclude(_STANDS.get(self._answer.result().state.state, ""))
        elif waited_s > SILENT_S + _ANSWER_S:
            self._conclude("")

    def _service(self) -> str:
        """Returns the service that tells the state; "" = there is none."""
        offered = self._node.get_service_names_and_types()
        return next((name for name, types in offered if _TYPE in types and self._node.count_services(name)), "")

    def _conclude(self, stands: str) -> None:
        self._ended = True
        if stands:
            self._tell(
                f"the simulation is {stands}, so nothing moves and nothing is published; `gibson-sim play` starts its time"
            )
        elif self._otherwise is not None:
            self._tell(self._otherwise())
