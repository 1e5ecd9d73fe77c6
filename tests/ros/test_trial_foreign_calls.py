"""Runs of trials with stacks that change the world themselves: the calls are found, named as the cause, and fail the run."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from support.scenes import write_room
from support.simulation import require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from gibson_sim.trials.execution import execute  # noqa: E402
from gibson_sim.trials.judging import judge  # noqa: E402
from gibson_sim.trials.records import Person, PlacedObject, RunSpec  # noqa: E402
from gibson_sim.trials.scenario.spec import Scenario, StackSpec, Status  # noqa: E402

pytestmark = pytest.mark.ros
STACKS = Path(__file__).parents[1] / "support" / "stacks"
DOMAINS = range(30, 50)


@pytest.mark.parametrize(
    ("how", "end", "what", "key"),
    [
        ("teleport", "reached", "called /set_entity_state of 'robot'; the", "set_entity_state"),
        (
            "steps",
            "reached",
            "called /set_entity_state of 'robot', and later /set_entity_state 59 times; the",
            "set_entity_state",
        ),
        ("pause", "simulation failed", "called /set_simulation_state (pause); the", "set_simulation_state"),
    ],
)
def test_stack_that_changes_the_world_fails_and_its_call_is_the_cause(
    tmp_path: Path, how: str, end: str, what: str, key: str
) -> None:
    """The things and the person that the trial itself spawns and moves are no foreign calls."""
    room = str(write_room(tmp_path / "room"))
    stack = StackSpec((sys.executable, "cheat.py", how), folder=STACKS, status=Status("status"))
    scenario = Scenario("t", Path("t.yaml"), (room,), stack)
    run = replace(
        RunSpec(1, room, "gibson_bot", 3, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0, 0.18),
        things=(PlacedObject("box", "box_cardboard", (1.0, 1.0, 0.3)),),
        people=(Person("anna", ((-1.0, -1.0), (1.0, -1.0)), 0.8, 0.25, 1.75),),
    )
    outcome = execute(scenario, run, tmp_path / "run", domains=DOMAINS)
    assert outcome.end == end, (outcome.detail, (tmp_path / "run" / "simulation.log").read_text())
    result = judge(scenario, run, outcome, tmp_path / "run")
    assert not result.passed
    assert result.cause is not None and result.cause.kind == "foreign call"
    assert (
        f"foreign call: node '/cheat' {what} scenario does not allow it (key stack.allowed_calls: [{key}])" in result.cause.text
    )

    allowed = judge(replace(scenario, stack=replace(stack, allowed_calls=(key,))), run, outcome, tmp_path / "run")
    assert allowed.passed == (how != "pause"), "judged as if it had driven there"
    assert allowed.cause is None or allowed.cause.kind != "foreign call"


def test_stack_that_pauses_the_recording_fails(tmp_path: Path) -> None:
    pytest.importorskip("rosbag2_interfaces")
    room = str(write_room(tmp_path / "room"))
    stack = StackSpec((sys.executable, "cheat.py", "record"), folder=STACKS, status=Status("status"))
    scenario = Scenario("t", Path("t.yaml"), (room,), stack)
    run = RunSpec(1, room, "gibson_bot", 3, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0, 0.18)
    outcome = execute(scenario, run, tmp_path / "run", domains=DOMAINS)
    result = judge(scenario, run, outcome, tmp_path / "run")
    failed = {verdict.name: verdict.text for verdict in result.verdicts if not verdict.passed}
    assert failed["run"].startswith("the bag lacks "), outcome
    assert "recording was paused, by node '/cheat', or messages were lost" in failed["run"]
