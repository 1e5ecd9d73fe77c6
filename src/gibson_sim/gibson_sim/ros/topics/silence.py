"""Reports once why a node receives no messages from a simulation; the usual cause is that time is paused."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from simulation_interfaces.msg import SimulationState

from gibson_sim.ros.client.simulation_client import SimulationClient

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
        self._report, self._otherwise, self._start_s = report, otherwise, now_s
        self._by_simulation = by_simulation
        self._simulation = SimulationClient(node)
        self._ended = False

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
        if (response := self._simulation.poll("get_simulation_state")) is not None:
            self._conclude(_HALTED.get(response.state.state, ""))
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
