"""How an agent learns of its simulation's end, without a simulation."""

from __future__ import annotations

import json
from typing import Any

import pytest

from gibson_sim.agents import session as sessions
from gibson_sim.agents.folders import Folders
from gibson_sim.agents.session import AgentSession
from gibson_sim.errors import GibsonSimError
from gibson_sim.testing.headless_simulation import SimulationEndedError


class Dying:
    """A simulation that has ended by itself."""

    log = "physics  | [INFO] loaded\nphysics  | Fatal Python error: Segmentation fault"
    closed = 0
    is_usable = False

    def __init__(self, **settings: Any) -> None:
        self.given = settings

    def step(self, seconds: float) -> None:
        raise SimulationEndedError("the simulation has ended: the physics node was killed by SIGSEGV")

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> AgentSession:
    session = AgentSession(Folders([]), "1-101")
    monkeypatch.setattr(session, "_simulation", Dying())
    return session


def test_the_call_after_the_end_reports_it_with_the_tail_of_the_log(session: AgentSession) -> None:
    dying = session._simulation
    with pytest.raises(GibsonSimError) as caught:
        session.call("step", {"seconds": 1.0})
    assert str(caught.value) == (
        "the simulation has ended: the physics node was killed by SIGSEGV; the end of its log: physics | [INFO] loaded | "
        "physics | Fatal Python error: Segmentation fault; start_simulation starts another one"
    )
    assert isinstance(dying, Dying)
    assert dying.closed == 1
    with pytest.raises(GibsonSimError, match=r"no simulation runs .*killed by SIGSEGV.*: call start_simulation first"):
        session.call("step", {"seconds": 1.0})
    state = json.loads(session.call("get_state", {}).text)
    assert state["simulation"] == "none"
    assert "SIGSEGV" in state["last_simulation"]


def test_a_simulation_is_started_with_local_reach_and_checked_names(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}

    def start(**settings: Any) -> None:
        given.update(settings)
        raise SimulationEndedError("the simulation cannot start: no room")

    monkeypatch.setattr(sessions, "HeadlessSimulation", start)
    session = AgentSession(Folders([]), "3-4")
    with pytest.raises(GibsonSimError, match="cannot start: no room"):
        session.call(
            "start_simulation", {"scene": "flat", "robot": "left=gibson_bot, right=arm_bot", "time": "real", "cameras": False}
        )
    assert given == {
        "domains": "3-4", "reach": "local", "lockstep": False, "scene": "flat", "robot": "left=gibson_bot,right=arm_bot", "start": "",
        "seed": 0, "cameras": False,
    }  # fmt: skip
    given.clear()
    with pytest.raises(GibsonSimError, match="robot 'x' is neither a known name nor a file"):
        session.call("start_simulation", {"robot": "left=gibson_bot,right=x"})
    assert given == {}
