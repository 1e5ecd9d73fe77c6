"""What `gibson-sim bench lockstep` makes of what it measured."""

from __future__ import annotations

import json

import pytest

from gibson_sim.bench.lockstep import BLOCKS, WARM_UP, LockstepReport, Turns, case_of, in_turns, rate_of, targets
from gibson_sim.bench.ros import Size


def _turns(physics: float, draw: float | None, processes: float) -> Turns:
    return Turns([physics] * 5, [] if draw is None else [draw] * 5, [processes] * 5)


def test_ticks_without_images_are_judged_by_their_rate_either_way() -> None:
    case = case_of(None, _turns(0.5, None, 1.25), _turns(0.5, None, 0.8))
    assert rate_of(case.lockstep) == pytest.approx(800.0)
    assert [(t.measured, t.met) for t in targets([case])] == [("800/s", False), ("1,250/s", True)]


def test_ticks_with_images_are_judged_by_what_the_processes_add() -> None:
    case = case_of(Size(64, 48), _turns(1.0, 9.0, 13.0), _turns(2.0, 18.0, 22.0))
    assert (case.physics.median, case.draw.median, case.one_process.median) == (1.0, 9.0, 10.0)
    assert [(t.measured, t.met) for t in targets([case])] == [("30 %", False), ("10 %", True)]


class _Machine:
    """Both sides of a measurement on a machine that becomes slower with every block; it notes whose turn it is."""

    def __init__(self) -> None:
        self.turns: list[str] = []
        self.now = 0

    def block(self, ticks: int, turns: Turns) -> None:
        self.turns.append("alone")
        turns.physics += [float(len(self.turns))] * ticks

    def others(self, ticks: int) -> list[int]:
        self.turns.append("others")
        times = [self.now]
        for tick in range(ticks):  # the first ones of a block are slow: they do not count
            self.now += round((100.0 if tick < WARM_UP else 2.0 * (len(self.turns) - 1)) * 1e6)
            times.append(self.now)
        return times


def test_both_sides_have_their_turns_and_first_blocks_and_first_ticks_do_not_count() -> None:
    machine = _Machine()
    turns = in_turns(machine, machine.others, 40)  # type: ignore[arg-type]
    assert machine.turns == ["alone", "others"] * (1 + BLOCKS)
    assert len(turns.physics) == len(turns.processes) == 40
    assert turns.physics[0] == 3.0
    assert turns.processes == pytest.approx([2.0 * ms for ms in turns.physics])


def test_a_report_is_json_with_both_ways() -> None:
    case = case_of(None, _turns(0.5, None, 1.25), _turns(0.5, None, 0.8))
    found = json.loads(json.dumps(LockstepReport("2026-01-01", "1", "m", 2, 0.0, "flat", (case,)).as_json()))["cases"][0]
    assert found["draw"]["median"] is None
    assert found["overhead"] == {"lockstep": pytest.approx(1.5), "pipelined": pytest.approx(0.6)}
    assert found["ticks_per_s"] == {"lockstep": pytest.approx(800.0), "pipelined": pytest.approx(1250.0)}
