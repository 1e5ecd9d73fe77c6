"""``gibson-sim bench learning``: what it measures, what it refuses, and its table."""

from __future__ import annotations

import pytest

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim_bench.learning import (
    ONE_RENDERER,
    PROCESSES,
    LearningPlan,
    LearningReport,
    LearningRow,
    _row,
    measure,
    report_text,
)


@pytest.mark.parametrize(
    "plan",
    [LearningPlan(observations=("smell",)), LearningPlan(environments=(0,)), LearningPlan(seconds=0.0)],
    ids=["observation", "environments", "seconds"],
)
def test_a_plan_that_cannot_be_measured_is_refused(plan: LearningPlan) -> None:
    with pytest.raises(ConfigError, match="must be of state, rgbd, 1 or more, and above 0"):
        measure(plan)


def test_an_unknown_task_is_refused() -> None:
    with pytest.raises(GibsonSimError, match="'fly'"):
        measure(LearningPlan(task="fly"))


def test_a_row_counts_the_steps_of_all_environments_and_begins_new_episodes() -> None:
    begun: list[int] = []
    made: list[None] = []
    row = _row(
        LearningPlan(seconds=0.05),
        PROCESSES,
        "state",
        3,
        lambda: begun.append(len(made)),
        lambda: made.append(None),
        lambda: 0.002 * len(made),
    )
    # One step before the time begins, then an episode every 100 steps.
    assert begun == [0, *range(1, len(made), 100)]
    # 2 ms of processor time a step of three environments.
    assert row.processor_ms == pytest.approx(2.0 / 3.0)
    assert row.steps_per_s <= 3 * (len(made) - 1) / 0.05


def test_the_table_names_each_configuration() -> None:
    rows = (LearningRow(PROCESSES, "state", 2, 812.4, 2.346), LearningRow(ONE_RENDERER, "rgbd", 4, 305.0, 4.1))
    text = report_text(LearningReport("2026-11-25T10:00:00", "0.1.0", "two cores", 2, 0.1, LearningPlan(), rows), markdown=True)
    assert "| state | 2 | a process each | 812 | 2.35 |" in text
    assert "| rgbd | 4 | one process, one renderer | 305 | 4.10 |" in text
    assert "images 128x128" in text
