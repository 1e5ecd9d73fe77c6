"""Trials: repeated runs of an unmodified ROS stack in simulation, each with a verdict. User documentation: ``docs/trials.md``.

    from gibson_sim import trials

    trial = trials.run("flat", runs=10, workers=2)     # as `gibson-sim trial flat --runs 10 --workers 2`
    print(trial.rate.text(), trial.causes(), trial.folder / "index.html")
    rows = trial.to_rows()                             # one mapping per run: pandas.DataFrame(rows)

Public names, loaded on first access:

run             executes and judges the runs of a scenario, and writes the report
plan            the planned runs, without executing them
load_scenario   reads and checks a scenario file
read_results    the results of an earlier trial
compare         two trials, run by run
TrialResults, RunResult, Scenario, Progress, TrialInterrupted

A scenario file (``scenario``) becomes a list of runs (``planning``); each is executed with a simulation and the stack in a ROS domain of its
own (``execution``), judged from its bag (``judging``), and reported (``report``). ``running`` is the way through all of them. No module here
imports ROS; the node ``ros/trials/trial_node.py`` communicates with the stack.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gibson_sim.trials.comparison import compare
    from gibson_sim.trials.records import RunResult
    from gibson_sim.trials.report.results import TrialResults, read_results
    from gibson_sim.trials.running import Progress, TrialInterrupted, plan, run
    from gibson_sim.trials.scenario.load import load_scenario
    from gibson_sim.trials.scenario.spec import Scenario

_MODULE_OF_NAME = {
    **dict.fromkeys(("Progress", "TrialInterrupted", "plan", "run"), "running"),
    **dict.fromkeys(("TrialResults", "read_results"), "report.results"),
    "RunResult": "records",
    "Scenario": "scenario.spec",
    "compare": "comparison",
    "load_scenario": "scenario.load",
}
__all__ = [
    "Progress", "RunResult", "Scenario", "TrialInterrupted", "TrialResults", "compare", "load_scenario", "plan", "read_results", "run",
]  # fmt: skip


def __getattr__(name: str) -> object:
    """Loads a public name on first access."""
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public names: {', '.join(__all__)}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)
    return value
