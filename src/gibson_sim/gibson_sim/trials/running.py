"""Executes and judges the runs of a trial, each as a unit of work (``jobs``) in a worker process, and collects their results."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from gibson_sim.errors import ConfigError
from gibson_sim.jobs.units import LOG_SUFFIX, Backend, Context, Unit, UnitResult, run_units
from gibson_sim.processes.folder_lock import locked_folder
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.trials.records import Cause, Outcome, RunResult, RunSpec, Verdict
from gibson_sim.trials.report.results import RESULTS, json_text, result_from_json
from gibson_sim.trials.report.words import run_folder
from gibson_sim.trials.scenario.load import load_scenario
from gibson_sim.trials.scenario_spec import Scenario
from gibson_sim.writing import cannot_write, write_file

RUNS = "runs"
RUN, RESULT = "run.json", "result.json"
"""Files in the folder of a run."""
_FUNCTION = f"{__name__}:execute_run"


@dataclass(frozen=True, slots=True)
class Overrides:
    """Command-line overrides of scenario settings; None = as in the file."""

    runs: int | None = None
    """Number of runs in each scene with each robot."""
    restart: Literal["each", "never"] | None = None
    keep: Literal["failed", "all"] | None = None

    def applied(self, scenario: Scenario) -> Scenario:
        """Returns the scenario with these overrides applied.

        Raises:
            ConfigError: a value is not allowed.
        """
        if self.runs is not None:
            if self.runs < 1:
                raise ConfigError(f"--runs is {self.runs}, must be at least 1")
            scenario = replace(scenario, runs=self.runs)
        if self.restart is not None:
            scenario = replace(scenario, stack=replace(scenario.stack, restart=self.restart))
        if self.keep is not None:
            scenario = replace(scenario, record=replace(scenario.record, keep=self.keep))
        return scenario

    def options(self) -> tuple[str, ...]:
        """Returns the command-line options that a repetition of a run needs."""
        options = (("--runs", self.runs), ("--restart", self.restart))
        return tuple(word for name, value in options if value is not None for word in (name, str(value)))


def check(scenario: Scenario) -> None:
    """Checks a scenario's stack before any process starts.

    Raises:
        GibsonSimError: the stack's program does not exist, or a setting of the stack cannot be used.
    """
    # Imported here: planning and comparing need no ROS domain.
    from gibson_sim.trials.execution import check_stack

    try:
        check_stack(scenario.stack)
    except ConfigError as error:
        raise ConfigError(f"{scenario.path}: {error}") from error


def check_output_folder(folder: Path, *, resume: bool) -> None:
    """Checks that the output folder is new or empty, or belongs to a trial that is resumed.

    Raises:
        ConfigError: the folder cannot be used.
    """
    try:
        entries = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
        ancestor = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    except NotADirectoryError as error:
        raise ConfigError(f"--output {quoted(str(folder))} is a file, must be a folder") from error
    except OSError as error:
        raise ConfigError(f"--output {quoted(str(folder))}: cannot be read: {error.strerror}") from error
    if not (ancestor.is_dir() and os.access(ancestor, os.W_OK)):
        raise ConfigError(
            f"--output {quoted(str(folder))} cannot be created: {ancestor} is {'read-only' if ancestor.is_dir() else 'a file'}"
        )
    if entries and not resume:
        is_trial = RESULTS in entries or RUNS in entries
        remedy = "give a new one, or add --resume to continue the trial in it" if is_trial else "give a new one"
        raise ConfigError(f"--output {quoted(str(folder))}: the folder already contains {quoted(entries[0])}; {remedy}")
    if entries and RUNS not in entries:
        raise ConfigError(
            f"--output {quoted(str(folder))}: the folder contains {quoted(entries[0])}, but no trial to resume; give another one"
        )


@contextmanager
def claimed(folder: Path, *, resume: bool) -> Iterator[None]:
    """Creates the output folder, see ``check_output_folder``, and locks it against other trials within a ``with`` block.

    Raises:
        ConfigError: another trial uses the folder, or the folder cannot be used.
        WriteError: the folder cannot be created.
    """
    in_use = ConfigError(
        f"--output {quoted(str(folder))}: another trial is writing to the folder; wait for it, or give a new one"
    )
    with locked_folder(folder, in_use):
        check_output_folder(folder, resume=resume)
        yield


def finished(folder: Path, runs: Iterable[RunSpec]) -> dict[int, RunResult]:
    """Returns the results of planned runs that an earlier attempt executed with the same plan, by number.

    Args:
        folder: folder of the trial.
        runs: planned runs.
    """
    results = {}
    for run in runs:
        path = run_folder(folder, run.number)
        try:
            executed = json.loads(read_file(path / RUN))
            result = result_from_json(json.loads(read_file(path / RESULT)))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        if executed == json.loads(json_text(run.to_json())) and result.outcome.end != "interrupted":
            results[run.number] = result
    return results


def execute_runs(
    scenario: Scenario,
    overrides: Overrides,
    runs: Sequence[RunSpec],
    backend: Backend,
    folder: Path,
    on_result: Callable[[RunResult], None],
    on_progress: Callable[[int, str], None],
) -> None:
    """Executes runs, each in a folder within that of the trial, and hands over each result when it is available.

    Args:
        scenario: scenario with the overrides applied.
        overrides: command-line overrides of the file.
        runs: planned runs.
        backend: executes the units of work.
        folder: folder of the trial.
        on_result: called in this thread.
        on_progress: called in this thread with the number of a run and its state as text.

    Raises:
        WriteError: the folder cannot be written to.
        KeyboardInterrupt: Ctrl-C; all processes have ended, and the results handed over so far are kept.
    """
    by_id = {f"{run.number:04d}": run for run in runs}
    files = _files(scenario)
    arguments = {"scenario": str(scenario.path), "folder": str(scenario.stack.folder), "overrides": asdict(overrides)}
    units = [
        # No run follows the last one. With several workers, each has a last run, but which one is unknown in advance.
        Unit(name, _FUNCTION, {**arguments, "run": run.to_json(), "followed": number < len(runs)}, files)
        for number, (name, run) in enumerate(by_id.items(), 1)
    ]
    for name in by_id:
        _remove(folder / RUNS / name)

    def keep(unit: UnitResult) -> None:
        if unit.stopped or (not unit.error and unit.value is None):
            return
        run = by_id[unit.id]
        if unit.error:
            result = worker_failure(scenario, run, unit.error)
            path = run_folder(folder, run.number)
            write_file(path / RUN, json_text(run.to_json()))
            write_file(path / RESULT, json_text(result.to_json()))
        else:
            result = result_from_json(unit.value)
        on_result(result)

    run_units(
        units, backend, output=folder / RUNS, on_result=keep, on_progress=lambda name, text: on_progress(by_id[name].number, text)
    )


def execute_run(arguments: dict[str, Any], folder: Path, context: Context) -> dict[str, Any] | None:
    """Executes and judges one run in a worker process; returns its result as JSON values, or None if it was interrupted.

    Args:
        arguments: the scenario file, its overrides, the run, and whether other runs follow it.
        folder: folder of the run.
        context: context of the unit.
    """
    # Imported here: the command line needs neither for planning nor for comparing.
    from gibson_sim.trials.execution import execute
    from gibson_sim.trials.judging import judge
    from gibson_sim.trials.report.keeping import keep_of_run

    scenario = Overrides(**arguments["overrides"]).applied(load_scenario(context.path(arguments["scenario"])))
    scenario = replace(scenario, stack=replace(scenario.stack, folder=context.path(arguments["folder"])))
    planned = RunSpec.from_json(arguments["run"])
    run = replace(planned, scene=_local_path(planned.scene, context), robot=_local_path(planned.robot, context))
    outcome = execute(scenario, run, folder, followed=arguments["followed"], on_progress=context.progress, stop=context.stop)
    write_file(folder / RUN, json_text(planned.to_json()), durable=False)
    if outcome.end == "interrupted" or context.stop():
        return None
    context.progress("judging")
    result = replace(judge(scenario, run, outcome, folder), run=planned)
    keep_of_run(result, folder, scenario.record.keep)
    values: dict[str, Any] = json.loads(json_text(result.to_json()))
    write_file(folder / RESULT, json_text(values))
    return values


def worker_failure(scenario: Scenario, run: RunSpec, error: str) -> RunResult:
    """Returns the result of a run whose worker failed through no fault of the stack."""
    outcome = Outcome("simulation failed", error, lockstep=bool(scenario.stack.lockstep))
    return RunResult(run, outcome, (Verdict("run", False, error),), {}, "", Cause("simulation failed", error))


def _files(scenario: Scenario) -> tuple[Path, ...]:
    """Returns the folders that workers on other machines need: those of scenario, stack, and scenes and robots given as files."""
    named = [path for path in map(Path, (*scenario.scenes, *scenario.robots)) if path.is_absolute()]
    folders = [scenario.path.parent, scenario.stack.folder, *(path.parent if path.is_file() else path for path in named)]
    return tuple(dict.fromkeys(path for path in folders if not any(other in path.parents for other in folders)))


def _local_path(name: str, context: Context) -> str:
    """Returns the name of a scene or a robot, or the path of its file on this machine."""
    return str(context.path(name)) if Path(name).is_absolute() else name


def _remove(folder: Path) -> None:
    """Removes the files of an earlier attempt of a run."""
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.with_name(folder.name + LOG_SUFFIX).unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
