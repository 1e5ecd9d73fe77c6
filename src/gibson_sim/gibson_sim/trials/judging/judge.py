"""Judges one run."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import clipped
from gibson_sim.trials.foreign_calls import foreign_calls
from gibson_sim.trials.judging.cause import cause_without_bag, find_cause
from gibson_sim.trials.judging.evidence import read_evidence
from gibson_sim.trials.judging.measures import measure
from gibson_sim.trials.judging.verdicts import NOT_JUDGED, failed_verdicts, verdicts_of
from gibson_sim.trials.records import Cause, Outcome, RunResult, RunSpec
from gibson_sim.trials.run_folder import BAG
from gibson_sim.trials.scenario.spec import Scenario

_MAX_LENGTH = 400
"""Largest length of the reason why a bag cannot be read, characters."""


def judge(scenario: Scenario, run: RunSpec, outcome: Outcome, folder: Path) -> RunResult:
    """Returns the result of a run: verdicts, measures, digest, and the cause if it failed. A faulty bag never raises.

    Args:
        scenario: criteria of the verdicts.
        run: the planned run.
        outcome: outcome of the run.
        folder: folder of the run, with its bag in ``bag``.
    """
    bag = folder / BAG
    try:
        evidence = read_evidence(bag, outcome, [f"/{rate.topic.lstrip('/')}" for rate in scenario.verdicts.rates])
        problem = ""
    except GibsonSimError as error:
        evidence, problem = None, clipped(str(error), _MAX_LENGTH)
    # A damaged bag can decode to arbitrary values.
    except (ValueError, IndexError, KeyError, AttributeError, OverflowError, MemoryError) as error:
        evidence, problem = (
            None,
            f"bag {bag} contains invalid values ({type(error).__name__}: {clipped(str(error), _MAX_LENGTH)})",
        )
    digest = "" if evidence is None else evidence.digest
    foreign = foreign_calls(scenario, run, outcome, () if evidence is None else evidence.calls)
    if evidence is None or outcome.goal_ns < 0:
        why = f"{outcome.end}: {outcome.detail}" if outcome.end in (*NOT_JUDGED, "stack died") or not problem else problem
        if foreign is not None:
            why = f"{outcome.end}, {foreign.what}"
        verdicts = failed_verdicts(scenario, outcome, why)
        why_failed = cause_without_bag(outcome, why) if foreign is None else Cause("foreign call", foreign.what)
        return RunResult(run, outcome, verdicts, {}, digest, why_failed)
    measured = measure(run, outcome, evidence)
    verdicts = verdicts_of(scenario, run, outcome, evidence, measured, bag, foreign)
    cause = find_cause(scenario, run, outcome, evidence, measured, verdicts, foreign)
    return RunResult(run, outcome, verdicts, measured.values, digest, cause)
