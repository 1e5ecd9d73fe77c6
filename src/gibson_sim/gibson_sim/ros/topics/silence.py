"""Reports once why a node receives no messages from a simulation; the usual cause is that time is paused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import GetSimulationState

from gibson_sim.ros.topics.discovery import offered_service

SILENT_S = 3.0
"""Time without a message after which the cause is reported, s of wall time."""
_ANSWER_S = 5.0
"""Timeout for the state of the simulation, s of wall time."""
_HALTED = {SimulationState.STATE_PAUSED: "paused", SimulationState.STATE_STOPPED: "stopped"}
"""States in which time does not pass -> text."""


class SilenceNotice:
    """Requests the state of the simulation after ``SILENT_S`` without a message, and reports the cause of the silence.

    Args:
        node: node that waits; its owner spins it.
        report: called at most once, with one line of text.
        otherwise: returns the text to report if time is not paused; None = no report then.
        now_s: wall time at which the wait starts, s.
        by_simulation: returns whether the simulation publishes the messages; if not, its state is not the cause of the silence.
    """

    def __init__(
        self,
        node: Node,
        report: Callable[[str], None],
        otherwise: Callable[[], str] | None,
        now_s: float,
        by_simulation: Callable[[], bool] = lambda: True,
    ) -> None:
        self._node, self._report, self._otherwise, self._start_s = node, report, otherwise, now_s
        self._by_simulation = by_simulation
        self._answer: Any = None
        self._ended = False
        self._client: Any = None

    def end(self) -> None:
        """Ends the wait: a message has arrived."""
        self._ended = True

    def check(self, now_s: float) -> None:
        """Continues the wait at a wall time, s; must be called repeatedly until a message arrives."""
        waited_s = now_s - self._start_s
        if self._ended or waited_s < SILENT_S:
            return
        if not self._by_simulation():
            self._conclude("")
            return
        if self._client is None and (name := offered_service(self._node, GetSimulationState)):
            self._client = self._node.create_client(GetSimulationState, name)
        if self._answer is None and self._client is not None and self._client.service_is_ready():
            self._answer = self._client.call_async(GetSimulationState.Request())
        if self._answer is not None and self._answer.done():
            self._conclude(_HALTED.get(self._answer.result().state.state, ""))
        elif waited_s > SILENT_S + _ANSWER_S:
            self._conclude("")

    def _conclude(self, halted: str) -> None:
        self._ended = True
        if halted:
            self._report(
                f"the simulation is {halted}, so nothing moves and nothing is published; `gibson-sim play` starts its time"
            )
        elif self._otherwise is not None:
            self._report(self._otherwise())
