"""What `gibson-sim bench lockstep` makes of what it measured."""

from __future__ import annotations

import json

import pytest

from gibson_sim.bench.lockstep import LockstepReport, case_of, rate_of, targets
from gibson_sim.bench.ros import Size, spread

NOTHING = spread([])


def _heard(tick_ms: float) -> dict[str, list[int]]:
    return {"tick_ns": [round(k * tick_ms * 1e6) for k in range(20)]}


def test_ticks_without_images_are_judged_by_their_rate_either_way() -> None:
    case = case_of(None, (spread([0.4]), NOTHING, spread([0.5])), _heard(1.25), _heard(0.8))
    assert rate_of(case.lockstep) == pytest.approx(800.0)
    assert [(t.measured, t.met) for t in targets([case])] == [("800/s", False), ("1,250/s", True)]


def test_ticks_with_images_are_judged_by_what_the_processes_add() -> None:
    case = case_of(Size(64, 48), (spread([1.0]), spread([9.0]), spread([10.0])), _heard(13.0), _heard(11.0))
    assert [(t.measured, t.met) for t in targets([case])] == [("30 %", False), ("10 %", True)]


def test_a_report_is_json_with_both_ways() -> None:
    case = case_of(None, (spread([0.4]), NOTHING, spread([0.5])), _heard(1.25), _heard(0.8))
    found = json.loads(json.dumps(LockstepReport("2026-01-01", "1", "m", 2, 0.0, "flat", (case,)).as_json()))["cases"][0]
    assert found["draw"]["median"] is None
    assert found["ticks_per_s"] == {"lockstep": pytest.approx(800.0), "pipelined": pytest.approx(1250.0)}
