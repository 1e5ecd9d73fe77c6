"""Cases, targets and report of `gibson-sim bench lockstep`."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from gibson_sim_bench.lockstep import (
    BLOCKS,
    CONFIGURATIONS,
    LockstepReport,
    TickTimes,
    case_of,
    measure_interleaved,
    rate_of,
    targets,
)
from gibson_sim_bench.protocol import TICK_WARM_UP
from gibson_sim_bench.ros import Size


def _turns(physics: float, draw: float | None, **others: float) -> TickTimes:
    return TickTimes([physics] * 5, [] if draw is None else [draw] * 5, {name: [ms] * 5 for name, ms in others.items()})


def test_ticks_without_images_are_judged_by_their_rate_either_way() -> None:
    case = case_of(None, _turns(0.5, None, lockstep=1.25, pipelined=0.8))
    assert rate_of(case.lockstep) == pytest.approx(800.0)
    assert case.ros == pytest.approx(1.5)
    assert [(t.measured, t.met) for t in targets([case])] == [("800/s", False), ("1,250/s", True)]
    assert targets([case], substeps=4) == []  # that target is one of single physics steps


def test_ticks_with_images_are_judged_by_what_the_split_into_processes_adds() -> None:
    case = case_of(Size(64, 48), _turns(1.0, 7.0, one_process=10.0, lockstep=13.0, pipelined=11.0))
    assert (case.physics.median, case.draw.median, case.without_ros.median) == (1.0, 7.0, 8.0)
    assert case.ros == pytest.approx(0.625)
    assert [(t.measured, t.met) for t in targets([case])] == [("30 %", False), ("10 %", True)]


class _Machine:
    """All sides of a measurement on a machine that becomes slower with every turn; it notes whose turn it is."""

    def __init__(self) -> None:
        self.turns: list[str] = []
        self.now = 0

    def make_block(self, ticks: int, times: TickTimes) -> None:
        self.turns.append("alone")
        times.physics += [float(len(self.turns))] * ticks

    def with_ros(self, name: str) -> Callable[[int], list[int]]:
        def make(ticks: int) -> list[int]:
            self.turns.append(name)
            times = [self.now]
            for tick in range(ticks):  # the first ones of a block are slow: they do not count
                self.now += round((100.0 if tick < TICK_WARM_UP else float(len(self.turns))) * 1e6)
                times.append(self.now)
            return times

        return make


def test_all_sides_have_their_turns_and_first_blocks_and_first_ticks_do_not_count() -> None:
    machine = _Machine()
    turns = measure_interleaved(machine, {name: machine.with_ros(name) for name in CONFIGURATIONS}, 40)  # type: ignore[arg-type]
    assert machine.turns == ["alone", *CONFIGURATIONS] * (1 + BLOCKS)
    assert turns.physics[0] == 5.0
    for number, name in enumerate(CONFIGURATIONS, start=1):
        assert turns.with_ros[name] == pytest.approx([ms + number for ms in turns.physics])


def test_a_report_is_json_with_all_configurations() -> None:
    case = case_of(None, _turns(0.5, None, lockstep=1.25, pipelined=0.8))
    found = json.loads(json.dumps(LockstepReport("2026-01-01", "1", "m", 2, 0.0, "flat", (case,)).as_json()))["cases"][0]
    assert found["draw"]["median"] is None and found["one_process"]["median"] is None
    assert found["ros"] == pytest.approx(1.5)
    assert found["split"] == {"lockstep": None, "pipelined": None}
    assert found["ticks_per_s"] == {"lockstep": pytest.approx(800.0), "pipelined": pytest.approx(1250.0)}
