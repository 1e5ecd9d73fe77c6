"""Made-up results of trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gibson_sim.trials.records import Cause, Outcome, RunResult, RunSpec, Verdict
from gibson_sim.trials.report.results import TrialResults


def spec(number: int, **changes: Any) -> RunSpec:
    """Returns a planned run in ``linden_flat``, from (4.2, 2.8) to (7.4, 6.6)."""
    values: dict[str, Any] = {
        "number": number, "scene": "linden_flat", "robot": "gibson_bot", "seed": 100 + number, "start": (4.2, 2.8, 0.0),
        "goal": (7.4, 6.6, 0.0), "shortest": 11.2, "radius": 0.18,
    }  # fmt: skip
    return RunSpec(**{**values, **changes})


def passed(number: int, *, time: float = 31.2, length: float = 12.1, digest: str = "", **changes: Any) -> RunResult:
    """Returns a run that reached its goal."""
    outcome = Outcome(
        "reached", "0.12 m from the goal", lockstep=True, goal_ns=1_000_000_000, end_ns=round((1.0 + time) * 1e9), running_s=8.0
    )
    verdicts = (
        Verdict("reached", True, "0.12 m from the goal, at most 0.3", 0.12, 0.3),
        Verdict("collisions", True, "none", 0, 0),
    )
    measures = {"time": time, "length": length, "path_ratio": length / 11.2, "clearance": 0.21}
    return RunResult(spec(number, **changes), outcome, verdicts, measures, digest)


def failed(
    number: int, text: str = "collision with chair_2 at 3.2,4.1 after 12.3 s", kind: Any = "collision", **changes: Any
) -> RunResult:
    """Returns a run that failed."""
    outcome = Outcome(
        "time limit", "120 s", lockstep=True, goal_ns=1_000_000_000, end_ns=121_000_000_000, status="driving", running_s=20.0
    )
    verdicts = (Verdict("reached", True, "0.2 m"), Verdict("collisions", False, "1 collision, at most 0", 1, 0))
    measures = {"time": 120.0, "length": 5.0, "clearance": 0.0}
    return RunResult(spec(number, **changes), outcome, verdicts, measures, "", Cause(kind, text, 12.3))


def trial(results: Sequence[RunResult], **changes: Any) -> TrialResults:
    """Returns a trial with these results."""
    values: dict[str, Any] = {
        "name": "rooms", "file": "rooms.yaml", "planned": len(results), "started": "2026-11-25T10:00:00+00:00", "wall_time": 61.0,
        "machine": {"name": "here"}, "versions": {"gibson_sim": "0.1.0"},
    }  # fmt: skip
    return TrialResults(results=tuple(results), **{**values, **changes})
