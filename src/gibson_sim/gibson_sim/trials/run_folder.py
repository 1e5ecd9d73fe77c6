"""The folder of a trial, and those of its runs: the names and formats of their files.

::

    OUT/results.json            the whole trial: scenario and all results
    OUT/runs/0007/run.json      RunSpec
    OUT/runs/0007/outcome.json  Outcome
    OUT/runs/0007/result.json   RunResult
    OUT/runs/0007/bag/          rosbag2, with /inputs, /run_info and /tick_digest for bit-exact replay
    OUT/runs/0007/stack.log, simulation.log
"""

from __future__ import annotations

import json
from pathlib import Path

from gibson_sim.reading import read_file
from gibson_sim.trials.json_values import json_text, json_values
from gibson_sim.trials.records import Outcome, RunResult, RunSpec
from gibson_sim.writing import write_file

RESULTS, RUNS = "results.json", "runs"
"""File and folder in the folder of a trial."""
BAG, STACK_LOG, SIMULATION_LOG = "bag", "stack.log", "simulation.log"
"""Folder and files in the folder of a run."""
_RUN, _OUTCOME, _RESULT = "run.json", "outcome.json", "result.json"


def run_folder(folder: Path, number: int) -> Path:
    """Returns the folder of a run within that of its trial."""
    return folder / RUNS / run_name(number)


def run_name(number: int) -> str:
    """Returns the name of the folder of a run."""
    return f"{number:04d}"


def write_run(run: RunSpec, folder: Path) -> None:
    """Writes a planned run into its folder; raises WriteError if that is not possible."""
    write_file(folder / _RUN, json_text(run), durable=False)


def write_outcome(outcome: Outcome, folder: Path) -> None:
    """Writes the outcome of a run into its folder; raises WriteError if that is not possible."""
    write_file(folder / _OUTCOME, json_text(outcome), durable=False)


def write_result(result: RunResult, folder: Path) -> None:
    """Writes the result of a run into its folder; raises WriteError if that is not possible."""
    write_file(folder / _RESULT, json_text(result.to_json()))


def read_result(run: RunSpec, folder: Path) -> RunResult | None:
    """Returns the result in the folder of a run; None = it was not completely executed, or with another plan."""
    try:
        planned = json.loads(read_file(folder / _RUN))
        result = RunResult.from_json(json.loads(read_file(folder / _RESULT)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return result if planned == json_values(run) and result.outcome.end != "interrupted" else None


def remove_results(folder: Path) -> None:
    """Removes the files that an earlier execution of a run left in its folder, except its bag."""
    for name in (_OUTCOME, _RESULT, STACK_LOG, SIMULATION_LOG):
        (folder / name).unlink(missing_ok=True)
