"""Messages of a node that waits for messages in vain."""

from __future__ import annotations

from typing import Any

import pytest

from support.simulation import require

require("rclpy", "simulation_interfaces")

from rclpy.task import Future  # noqa: E402
from simulation_interfaces.msg import SimulationState  # noqa: E402
from simulation_interfaces.srv import GetSimulationState  # noqa: E402

from gibson_sim.ros.topics.silence import SilenceNotice  # noqa: E402

pytestmark = pytest.mark.ros


class Graph:
    """A node in a graph with a simulation in some state; None = with none."""

    def __init__(self, state: int | None) -> None:
        self._state = state

    def get_service_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [("/a", ["std_srvs/srv/Trigger"]), ("/get_simulation_state", ["simulation_interfaces/srv/GetSimulationState"])]

    def count_services(self, name: str) -> int:
        return int(self._state is not None)

    def create_client(self, kind: Any, name: str) -> Graph:
        assert (kind, name) == (GetSimulationState, "/get_simulation_state")
        return self

    def service_is_ready(self) -> bool:
        return True

    def call_async(self, request: Any) -> Any:
        response = GetSimulationState.Response()
        response.state.state = self._state
        future: Any = Future()
        future.set_result(response)
        return future


def _told(state: int | None, *at_s: float, by_simulation: bool = True) -> list[str]:
    """Returns what is told if nothing comes, after looks at these times, s; the waiting begins at 100 s."""
    told: list[str] = []
    graph: Any = Graph(state)
    notice = SilenceNotice(graph, told.append, lambda: "waiting", 100.0, lambda: by_simulation)
    for now_s in at_s:
        notice.check(now_s)
    return told


def test_a_paused_simulation_is_reported_once() -> None:
    assert _told(SimulationState.STATE_PAUSED, 102.9) == []
    told = _told(SimulationState.STATE_PAUSED, 103.1, 104.0, 110.0)
    assert len(told) == 1 and told[0].startswith("the simulation is paused") and "`gibson-sim play`" in told[0]


def test_a_playing_simulation_and_none_have_their_own_reason() -> None:
    assert _told(SimulationState.STATE_PLAYING, 103.1, 110.0) == ["waiting"]
    assert _told(None, 103.1, 107.9) == []
    assert _told(None, 103.1, 108.1, 110.0) == ["waiting"]


def test_a_paused_simulation_is_not_the_reason_for_the_silence_of_another_node() -> None:
    assert _told(SimulationState.STATE_PAUSED, 102.9, by_simulation=False) == []
    assert _told(SimulationState.STATE_PAUSED, 103.1, 104.0, by_simulation=False) == ["waiting"]
    assert _told(None, 103.1, by_simulation=False) == ["waiting"]


def test_nothing_is_reported_once_a_message_has_arrived() -> None:
    told: list[str] = []
    graph: Any = Graph(SimulationState.STATE_PAUSED)
    notice = SilenceNotice(graph, told.append, None, 0.0)
    notice.end()
    notice.check(60.0)
    assert told == []
