"""What the trial did not do itself: requests in the journal that are not of the planned run fail it, unless the scenario allows them."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gibson_sim.trials.execution.walking import person_pose
from gibson_sim.trials.foreign_calls import JournalEntry, foreign_calls
from gibson_sim.trials.judging import judge
from gibson_sim.trials.records import Outcome, Person, PlacedObject, RunResult
from gibson_sim.trials.scenario.spec import Scenario
from support.run_bags import Run, messages, ns, planned, scenario

ANNA = Person("anna", ((0.0, 0.0), (3.0, 4.0), (3.0, 9.0)), 0.8, 0.25, 1.75)
RUN = planned(things=(PlacedObject("box", "box_cardboard", (1.0, 1.0, 0.3)),), people=(ANNA,), closed_doors=("way",))
NS = 10**9


class Cdr:
    """Writes CDR as in the standard: little endian, values aligned to their sizes after the encapsulation header of 4 bytes."""

    def __init__(self) -> None:
        self.data = b""

    def add(self, code: str, *values: float) -> Cdr:
        for value in values:
            self.data += bytes(-len(self.data) % struct.calcsize(code)) + struct.pack(f"<{code}", value)
        return self

    def text(self, text: str) -> Cdr:
        self.add("I", len(text) + 1)
        self.data += text.encode() + b"\0"
        return self

    @property
    def message(self) -> bytes:
        return b"\0\1\0\0" + self.data


def move(
    entity: str, x: float, y: float, yaw: float = 0.0, *, speed: float = 0.0, push: float = 0.0, frame: str = "map"
) -> bytes:
    """A request of SetEntityState: entity; header, pose, twist and acceleration."""
    cdr = Cdr().text(entity).add("I", 0, 0).text(frame).add("d", x, y, 0.0)
    cdr.add("d", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return cdr.add("d", speed, *[0.0] * 5, push, *[0.0] * 5).message


def joints(*names: str) -> bytes:
    """A JointState: header, names, positions, no velocities, no efforts."""
    cdr = Cdr().add("I", 0, 0).text("").add("I", len(names))
    for name in names:
        cdr.text(name)
    return cdr.add("I", len(names)).add("d", *[0.0] * len(names)).add("I", 0, 0).message


def state(number: int) -> bytes:
    return Cdr().add("B", number).message


def entry(name: str, data: bytes, t: float = 0.0, step: int = 0) -> JournalEntry:
    return JournalEntry(round(t * NS), step, name, data)


SPAWN_BOX = entry("/spawn_entity", Cdr().text("box").add("B", 0).text("box_cardboard").message)
SPAWN_ANNA = entry("/spawn_entity", Cdr().text("anna").add("B", 0).text("").message)
DOORS = entry("/object_joint_command", joints("way/hinge", "way/latch"))
PLAY = entry("/set_simulation_state", state(1))
SET_UP = [SPAWN_BOX, SPAWN_ANNA, DOORS, PLAY]


def found(
    entries: Sequence[JournalEntry], *allowed: str, callers: dict[str, list[str]] | None = None, goal_ns: int = 0
) -> str | None:
    usual = scenario()
    spec: Scenario = replace(usual, stack=replace(usual.stack, allowed_calls=allowed))
    calls = foreign_calls(spec, RUN, Outcome("reached", "", True, goal_ns, callers=callers or {}), entries)
    return None if calls is None else calls.what.partition("; the scenario")[0]


def walked(t: float, late: float = 0.0, **changes: Any) -> JournalEntry:
    return entry("/set_entity_state", move("anna", *person_pose(ANNA, t), **changes), t + late, 7)


STEPS = [walked(tick / 30.0) for tick in range(600)]
"""The requests of 20 s, every other tick of 60 Hz."""


def test_requests_of_the_trial_are_not_foreign() -> None:
    assert found([*SET_UP, *STEPS, entry("/cmd_vel", b"")]) is None
    there_and_back = [walked(tick / 30.0) for tick in range(3000)]  # 18 m at 0.8 m/s: after 22.5 s she begins again
    assert found([*SET_UP, *there_and_back]) is None
    assert found([*SET_UP, walked(2.0, late=0.7), walked(2.0 + 1 / 30, late=9.0)]) is None, "a busy machine moves her late"


def test_person_who_stands_is_placed_again_and_again() -> None:
    stands = replace(ANNA, path=((1.0, 2.0),))
    steps = [entry("/set_entity_state", move("anna", 1.0, 2.0), tick / 30.0, 7) for tick in range(600)]
    assert foreign_calls(scenario(), replace(RUN, people=(stands,)), Outcome("reached", "", True, 0), steps) is None


@pytest.mark.parametrize(
    "cheat",
    [
        walked(10.0 - 9.5, late=9.5),
        walked(10.0),
        walked(10.0 - 1 / 30, late=1 / 30),
        walked(10.0 + 1 / 60, speed=50.0),
        walked(10.0 + 1 / 60, push=50.0),
        walked(10.0 + 1 / 60, frame="robot"),
        walked(10.5, late=-0.4),
    ],
    ids=["sent back", "twice", "a tick back", "with a velocity", "with an acceleration", "in another frame", "ahead"],
)
def test_person_is_moved_only_as_planned(cheat: JournalEntry) -> None:
    """Its own request of 10 s has come when another node moves the person."""
    entries = [*SET_UP, *STEPS[:301], cheat, *STEPS[301:]]
    assert found(entries) == "foreign call: a node other than the trial's called /set_entity_state of 'anna'"


def test_person_walks_again_after_a_reset_that_the_scenario_allows() -> None:
    entries = [*SET_UP, *STEPS, entry("/reset_simulation", state(0), 20.0, 7), *STEPS]
    assert found(entries, "reset_simulation") is None


@pytest.mark.parametrize(
    ("foreign", "what"),
    [
        (entry("/set_entity_state", move("robot", 1.0, 2.0), 1.2, 7), "/set_entity_state of 'robot'"),
        (entry("/set_entity_state", move("anna", 1.0, 2.0), 1.2, 7), "/set_entity_state of 'anna'"),
        (entry("/set_entity_state", move("anna", *person_pose(ANNA, 1.2)[:2], 3.0), 1.2, 7), "/set_entity_state of 'anna'"),
        (entry("/spawn_entity", Cdr().text("chair").message), "/spawn_entity of 'chair'"),
        (SPAWN_BOX, "/spawn_entity of 'box'"),
        (replace(SPAWN_BOX, step=9), "/spawn_entity of 'box'"),
        (entry("/spawn_entities", Cdr().add("I", 3).message), "/spawn_entities of 3 entities"),
        (entry("/delete_entity", Cdr().text("box").message), "/delete_entity of 'box'"),
        (entry("/set_simulation_state", state(0)), "/set_simulation_state (stop)"),
        (PLAY, "/set_simulation_state (play)"),
        (entry("/set_simulation_state", state(2)), "/set_simulation_state (pause)"),
        (entry("/set_simulation_state", state(3)), "/set_simulation_state (quit)"),
        (entry("/reset_simulation", state(0)), "/reset_simulation"),
        (entry("/load_world", Cdr().text("house").text("").message), "/load_world of 'house'"),
        (entry("/unload_world", b"\0\1\0\0\0"), "/unload_world"),
        (entry("/step_simulation", Cdr().add("Q", 12).message), "/step_simulation (12 steps)"),
        (entry("/simulate_steps", Cdr().add("Q", 12).message), "/simulate_steps (12 steps)"),
        (
            entry("/physics/set_parameters", Cdr().add("I", 1).text("rate").add("B", 3, 0).add("q", 0).add("d", 0.5).message),
            "/physics/set_parameters (rate 0.5)",
        ),
        (DOORS, "/object_joint_command of 'way/hinge' and 1 more"),
        (entry("/object_joint_command", joints("fridge/door")), "/object_joint_command of 'fridge/door'"),
        (entry("/set_entity_state", b""), "/set_entity_state"),
        (entry("/delete_entity", b"\0\1\0\0\xff\xff\xff\xff"), "/delete_entity"),
    ],
)
def test_every_other_request_is_foreign(foreign: JournalEntry, what: str) -> None:
    assert found([*SET_UP, foreign]) == f"foreign call: a node other than the trial's called {what}"
    assert found([*SET_UP, foreign], foreign.kind) is None, "the scenario allows it"


def test_callers_are_named_and_calls_counted() -> None:
    moves = [entry("/set_entity_state", move("robot", 0.1 * k, 0.0), 1.0 + k, 7) for k in range(60)]
    pause = entry("/set_simulation_state", state(2), 70.0, 7)
    text = found([pause, *SET_UP, *moves], callers={"set_entity_state": ["/a", "/b/c"]})
    assert text == (
        "foreign call: node '/a' or node '/b/c' called /set_entity_state of 'robot', and later /set_entity_state 59 times, "
        "/set_simulation_state 1 time"
    )


def call_at(t: float, name: str, data: bytes) -> Any:
    make = messages()
    return replace(make.input(t), name=name, type="", step=9, data=np.frombuffer(data, dtype=np.uint8))


def judged(folder: Path, *calls: tuple[float, str, bytes], allowed: tuple[str, ...] = (), **outcome: Any) -> RunResult:
    run = Run(extra=[(t, "/inputs", call_at(t, name, data)) for t, name, data in calls])
    spec = scenario(folder)
    spec = replace(spec, stack=replace(spec.stack, allowed_calls=allowed))
    return judge(spec, planned(), run.outcome(**outcome), run.write(folder))


def test_run_fails_and_the_call_is_its_cause(tmp_path: Path) -> None:
    """It drives at 0.5 m/s from x = 1: after 1.2 s it is at 1.6."""
    teleport = (1.2, "/set_entity_state", move("robot", 6.0, 2.0))
    result = judged(tmp_path, teleport, callers={"set_entity_state": ["/cheat"]})
    text = (
        "foreign call: node '/cheat' called /set_entity_state of 'robot'; the scenario does not allow it "
        "(key stack.allowed_calls: [set_entity_state])"
    )
    assert [(v.name, v.text) for v in result.verdicts if not v.passed] == [("run", text)]
    assert result.cause is not None
    assert (result.cause.kind, result.cause.time) == ("foreign call", 1.2)
    assert result.cause.text == f"after 1.2 s, at (1.60, 2.00): {text}"
    assert RunResult.from_json(result.to_json()).outcome.callers == {"set_entity_state": ["/cheat"]}


def test_allowed_call_is_judged_as_before(tmp_path: Path) -> None:
    assert judged(tmp_path, (1.2, "/set_entity_state", move("robot", 6.0, 2.0)), allowed=("set_entity_state",)).passed


def test_call_before_the_goal_counts_and_earlier_events_are_not_the_cause(tmp_path: Path) -> None:
    result = judged(tmp_path, (-0.5, "/reset_simulation", state(0)), (11.0, "/reset_simulation", state(0)))
    assert result.cause is not None
    assert result.cause.text.startswith("0.5 s before the goal, at (1.00, 2.00): foreign call: a node")
    assert ", and later /reset_simulation 1 time; " in result.cause.text


def test_call_is_the_cause_of_a_run_without_a_goal(tmp_path: Path) -> None:
    result = judged(tmp_path, (1.2, "/unload_world", b"\0\1\0\0\0"), end="never ready", goal_ns=-1)
    assert not result.passed
    assert result.cause is not None and result.cause.kind == "foreign call"


def test_pause_that_the_trial_node_received_counts_once_whether_or_not_the_bag_has_it(tmp_path: Path) -> None:
    told = [[ns(1.2), 9, "/set_simulation_state", state(2).hex()]]
    for number, calls in enumerate(([], [(1.2, "/set_simulation_state", state(2))])):
        result = judged(tmp_path / str(number), *calls, end="simulation failed", time_calls=told)
        assert result.cause is not None and result.cause.kind == "foreign call"
        assert "called /set_simulation_state (pause); the scenario" in result.cause.text
