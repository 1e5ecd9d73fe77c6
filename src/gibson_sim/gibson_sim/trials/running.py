"""A trial from its scenario to its report: ``plan`` and ``run``.

``run`` reads the scenario once, plans its runs, claims the output folder, executes and judges each run as a unit of work (``jobs``) in a
worker process, and writes the report. Each unit has the scenario itself in its arguments, so that an edit of the file during a trial affects
no run. The command line, tests, notebooks and Ray clusters all use these two functions. Must not import ROS.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Literal

from gibson_sim import __version__
from gibson_sim.errors import ConfigError
from gibson_sim.jobs.units import LOG_SUFFIX, Backend, Context, Unit, UnitResult, backend_for, run_units
from gibson_sim.processes.environment import require_nodes
from gibson_sim.processes.folder_lock import locked_folder
from gibson_sim.processes.processor import processors
from gibson_sim.quoting import quoted
from gibson_sim.trials.comparison import compare as compare_results
from gibson_sim.trials.json_values import json_values, restored
from gibson_sim.trials.records import Cause, Outcome, RunResult, RunSpec, Verdict
from gibson_sim.trials.report.results import TrialResults, read_results, write_results
from gibson_sim.trials.run_folder import RESULTS, RUNS, read_result, run_folder, run_name, write_result, write_run
from gibson_sim.trials.scenario.load import load_scenario
from gibson_sim.trials.scenario.spec import Scenario
from gibson_sim.writing import cannot_write, write_file

_OUTPUT = Path("out") / "trials"
_FUNCTION = f"{__name__}:execute_run"
_LOOKS = "randomise"
"""Setting of the physics node that can name a file of rules."""


@dataclass(frozen=True, slots=True)
class Overrides:
    """Overrides of settings of a scenario; None = as in the scenario."""

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
                raise ConfigError(f"runs is {self.runs}, must be at least 1")
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


class Progress:
    """Receives the progress of a trial, in the thread that runs it; by default it does nothing. Override what is of use."""

    def planned(self, done: int, total: int) -> None:
        """Receives the number of planned runs, ``done``, and of all runs to plan."""

    def begins(self, name: str, total: int, done: int, folder: Path) -> None:
        """Receives what is to be executed, before the first run begins.

        Args:
            name: name of the scenario.
            total: number of runs.
            done: number of those that an earlier part of a resumed trial has done.
            folder: folder of the results.
        """

    def report(self, number: int, text: str) -> None:
        """Receives the state of a run, as a text of one line."""

    def add(self, result: RunResult) -> None:
        """Receives the result of a run."""

    def interrupted(self, running: int) -> None:
        """Receives the number of runs that Ctrl-C ends, with their processes, which takes some seconds; 0 = unknown."""

    def close(self) -> None:
        """Ends the display: planning or execution has ended, for any reason; called after each of them."""


class TrialInterrupted(KeyboardInterrupt):
    """Ctrl-C: all processes have ended, and the report of the finished runs is written; ``resume`` continues the trial."""

    def __init__(self, results: TrialResults) -> None:
        super().__init__(f"{len(results.results)} of {results.planned} runs are kept in {results.folder}")
        self.results = results
        """Results so far."""


def plan(
    scenario: Scenario | str | Path, *, numbers: Collection[int] = (), runs: int | None = None, progress: Progress | None = None
) -> tuple[RunSpec, ...]:
    """Returns the planned runs of a scenario, in the order of their numbers; starts nothing.

    Args:
        scenario: a file, the name of a built-in scenario, or a loaded one.
        numbers: numbers of the requested runs; empty = all.
        runs: number of runs in each scene with each robot; None = as in the scenario.
        progress: receives the progress of the planning.

    Raises:
        ScenarioError: the scenario has mistakes or cannot be satisfied.
        GibsonSimError: a number is not that of a run, or the scenario does not exist.
    """
    return _plan(Overrides(runs).applied(_loaded(scenario)), numbers, progress or Progress())


def run(
    scenario: Scenario | str | Path,
    *,
    workers: int | str = 1,
    output: str | Path | None = None,
    numbers: Collection[int] = (),
    runs: int | None = None,
    restart: Literal["each", "never"] | None = None,
    keep: Literal["failed", "all"] | None = None,
    resume: bool = False,
    compare: TrialResults | str | Path | None = None,
    progress: Progress | None = None,
) -> TrialResults:
    """Runs a trial: executes and judges its runs; writes results, JUnit XML and page.

    Args:
        scenario: a file, the name of a built-in scenario, or a loaded one; it is read once, before the first run.
        workers: number of runs at the same time, each in its own processes; or the address of a Ray cluster, such as ``auto``.
        output: new folder for the results; None = ``out/trials/NAME_TIME``.
        numbers: numbers of the runs to execute; empty = all runs of the plan.
        runs: number of runs in each scene with each robot; None = as in the scenario.
        restart: whether the stack is restarted for each run; None = as in the scenario.
        keep: runs whose bags are kept; None = as in the scenario.
        resume: whether to continue the trial in ``output``; runs that have a result there are not repeated.
        compare: earlier trial to compare with: its results, its ``results.json`` or its folder.
        progress: receives the progress.

    Raises:
        ScenarioError: the scenario has mistakes or cannot be satisfied.
        GibsonSimError: an argument is not allowed, the stack or a package is not installed, or the folder cannot be used; nothing was started.
        WriteError: the folder cannot be written to.
        TrialInterrupted: Ctrl-C.
    """
    progress = progress or Progress()
    before = read_results(Path(compare)) if isinstance(compare, (str, Path)) else compare
    backend = backend_for(workers, progress.interrupted)
    overrides = Overrides(runs, restart, keep)
    loaded = overrides.applied(_loaded(scenario))
    if resume and output is None:
        raise ConfigError("resume needs output, the folder of the trial to continue")
    folder = _OUTPUT / f"{loaded.name}_{datetime.now():%Y%m%d-%H%M%S}" if output is None else Path(output)
    # Check before the runs are planned, which may take minutes.
    if not isinstance(workers, str):
        require_nodes()
    check_output_folder(folder, resume=resume)
    check(loaded)
    planned = _plan(loaded, () if resume else numbers, progress)
    chosen = [one for one in planned if not numbers or one.number in numbers]
    with claimed(folder, resume=resume):
        results = finished(folder, planned) if resume else {}
        earlier_s = read_results(folder).wall_time if resume and (folder / RESULTS).exists() else 0.0
        todo = [one for one in chosen if one.number not in results]
        progress.begins(loaded.name, len(chosen), len(chosen) - len(todo), folder)
        started, begin_s = datetime.now(timezone.utc), time.monotonic()
        is_complete = _execute(loaded, todo, backend, folder, results, progress)
        done = tuple(results[number] for number in sorted(results))
        trial = TrialResults(
            name=loaded.name,
            file=str(loaded.path if isinstance(scenario, Scenario) else scenario),
            results=done,
            planned=max(len(chosen), len(done)) if resume else len(chosen),
            scenario=json_values(loaded),
            versions={"gibson_sim": __version__, "python": platform.python_version(), "system": platform.platform()},
            machine={"name": platform.node(), "processor": processors()},
            started=started.isoformat(timespec="seconds"),
            wall_time=earlier_s + time.monotonic() - begin_s,
            workers=str(workers),
            comparison=_comparison(before, done),
            folder=folder,
        )
        _write_report(trial, folder, overrides.options())
    if not is_complete:
        raise TrialInterrupted(trial)
    return trial


def _loaded(scenario: Scenario | str | Path) -> Scenario:
    return scenario if isinstance(scenario, Scenario) else load_scenario(scenario)


def _plan(scenario: Scenario, numbers: Collection[int], progress: Progress) -> tuple[RunSpec, ...]:
    # Imported here: maps, scenes and robots are not needed before.
    from gibson_sim.trials.planning.plan import plan_runs

    try:
        return plan_runs(scenario, numbers, progress.planned)
    finally:
        progress.close()


def _execute(
    scenario: Scenario, todo: Sequence[RunSpec], backend: Backend, folder: Path, results: dict[int, RunResult], progress: Progress
) -> bool:
    """Executes runs and adds their results by number; returns whether all were executed: Ctrl-C ends it early."""

    def keep(result: RunResult) -> None:
        results[result.run.number] = result
        progress.add(result)

    try:
        execute_runs(scenario, todo, backend, folder, keep, progress.report)
    except KeyboardInterrupt:
        return False
    finally:
        progress.close()
    return True


def _comparison(before: TrialResults | None, results: Sequence[RunResult]) -> dict[str, Any] | None:
    """Returns the comparison with an earlier trial as JSON values; None = there is none."""
    if before is None:
        return None
    return {**compare_results(before.results, results).to_json(), "file": before.source or before.name}


def _write_report(trial: TrialResults, folder: Path, options: Sequence[str]) -> None:
    """Writes the files of the report; ``options``: command-line options that affect the plan."""
    from gibson_sim.trials.report import junit, page

    write_results(trial, folder)
    write_file(folder / junit.FILE, junit.junit_xml(trial, folder, options))
    write_file(folder / page.FILE, page.trial_page(trial, folder, options, f"made by gibson-sim {__version__} trial"))


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
    name = f"output {quoted(str(folder))}"
    try:
        entries = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
        ancestor = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    except NotADirectoryError as error:
        raise ConfigError(f"{name} is a file, must be a folder") from error
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}") from error
    if not (ancestor.is_dir() and os.access(ancestor, os.W_OK)):
        raise ConfigError(f"{name} cannot be created: {ancestor} is {'read-only' if ancestor.is_dir() else 'a file'}")
    if entries and not resume:
        is_trial = RESULTS in entries or RUNS in entries
        remedy = "give a new one, or continue the trial in it (--resume, resume=True)" if is_trial else "give a new one"
        raise ConfigError(f"{name}: the folder already contains {quoted(entries[0])}; {remedy}")
    if entries and RUNS not in entries:
        raise ConfigError(f"{name}: the folder contains {quoted(entries[0])}, but no trial to resume; give another one")


@contextmanager
def claimed(folder: Path, *, resume: bool) -> Iterator[None]:
    """Creates the output folder, see ``check_output_folder``, and locks it against other trials within a ``with`` block.

    Raises:
        ConfigError: another trial uses the folder, or the folder cannot be used.
        WriteError: the folder cannot be created.
    """
    in_use = ConfigError(f"output {quoted(str(folder))}: another trial is writing to the folder; wait for it, or give a new one")
    with locked_folder(folder, in_use):
        check_output_folder(folder, resume=resume)
        yield


def finished(folder: Path, runs: Iterable[RunSpec]) -> dict[int, RunResult]:
    """Returns the results of planned runs that an earlier attempt executed with the same plan, by number.

    Args:
        folder: folder of the trial.
        runs: planned runs.
    """
    results = {one.number: read_result(one, run_folder(folder, one.number)) for one in runs}
    return {number: result for number, result in results.items() if result is not None}


def execute_runs(
    scenario: Scenario,
    runs: Sequence[RunSpec],
    backend: Backend,
    folder: Path,
    on_result: Callable[[RunResult], None],
    on_progress: Callable[[int, str], None],
) -> None:
    """Executes runs, each in a folder within that of the trial, and hands over each result when it is available.

    Args:
        scenario: scenario of the trial; the workers get it as it is.
        runs: planned runs.
        backend: executes the units of work.
        folder: folder of the trial.
        on_result: called in this thread.
        on_progress: called in this thread with the number of a run and its state as text.

    Raises:
        WriteError: the folder cannot be written to.
        KeyboardInterrupt: Ctrl-C; all processes have ended, and the results handed over so far are kept.
    """
    by_id = {run_name(one.number): one for one in runs}
    files = _files(scenario)
    arguments = {"scenario": json_values(scenario), "python": sys.executable}
    units = [
        # No run follows the last one. With several workers, each has a last run, but which one is unknown in advance.
        Unit(name, _FUNCTION, {**arguments, "run": json_values(one), "followed": number < len(runs)}, files)
        for number, (name, one) in enumerate(by_id.items(), 1)
    ]
    for name in by_id:
        _remove(folder / RUNS / name)

    def keep(unit: UnitResult) -> None:
        if unit.stopped or (not unit.error and unit.value is None):
            return
        planned = by_id[unit.id]
        if unit.error:
            result = worker_failure(scenario, planned, unit.error)
            write_run(planned, run_folder(folder, planned.number))
            write_result(result, run_folder(folder, planned.number))
        else:
            result = RunResult.from_json(unit.value)
        on_result(result)

    run_units(
        units, backend, output=folder / RUNS, on_result=keep, on_progress=lambda name, text: on_progress(by_id[name].number, text)
    )


def execute_run(arguments: dict[str, Any], folder: Path, context: Context) -> dict[str, Any] | None:
    """Executes and judges one run in a worker process; returns its result as JSON values, or None if it was interrupted.

    Args:
        arguments: the scenario, the Python program of the caller, the run, and whether other runs follow it.
        folder: folder of the run.
        context: context of the unit.
    """
    # Imported here: the command line needs neither for planning nor for comparing.
    from gibson_sim.trials.execution import execute
    from gibson_sim.trials.judging import judge
    from gibson_sim.trials.report.keeping import keep_of_run

    scenario = _on_this_machine(restored(Scenario, arguments["scenario"]), arguments["python"], context)
    planned = restored(RunSpec, arguments["run"])
    here = _run_on_this_machine(planned, context)
    write_run(planned, folder)
    outcome = execute(scenario, here, folder, followed=arguments["followed"], on_progress=context.progress, stop=context.stop)
    if outcome.end == "interrupted" or context.stop():
        return None
    context.progress("judging")
    result = replace(judge(scenario, here, outcome, folder), run=planned)
    keep_of_run(result, folder, scenario.record.keep)
    write_result(result, folder)
    return result.to_json()


def worker_failure(scenario: Scenario, run: RunSpec, error: str) -> RunResult:
    """Returns the result of a run whose worker failed through no fault of the stack."""
    outcome = Outcome("simulation failed", error, lockstep=bool(scenario.stack.lockstep))
    return RunResult(run, outcome, (Verdict("run", False, error),), {}, "", Cause("simulation failed", error))


def _files(scenario: Scenario) -> tuple[Path, ...]:
    """Returns the folders that workers on other machines need: those of scenario, stack, and scenes, robots, objects and looks given as files."""
    names = (*scenario.scenes, *scenario.robots, *(rule.object for rule in scenario.obstacles.spawn), scenario.randomise.looks)
    named = [path for path in map(Path, names) if path.is_absolute()]
    folders = [scenario.path.parent, scenario.stack.folder, *(path.parent if path.is_file() else path for path in named)]
    return tuple(dict.fromkeys(path for path in folders if not any(other in path.parents for other in folders)))


def _on_this_machine(scenario: Scenario, python: str, context: Context) -> Scenario:
    """Returns the scenario with the files and the Python of this machine; ``python``: Python program of the machine that planned it."""
    program, *words = scenario.stack.command
    command = (sys.executable if program == python else program, *words)
    stack = replace(scenario.stack, folder=context.path(scenario.stack.folder), command=command)
    return replace(scenario, path=context.path(scenario.path), stack=stack)


def _run_on_this_machine(run: RunSpec, context: Context) -> RunSpec:
    """Returns the run with the files of this machine."""

    def local(name: str) -> str:
        return str(context.path(name)) if Path(name).is_absolute() else name

    things = tuple(replace(thing, object=local(thing.object)) for thing in run.things)
    physics = {name: local(value) if name == _LOOKS else value for name, value in run.physics.items()}
    return replace(run, scene=local(run.scene), robot=local(run.robot), things=things, physics=physics)


def _remove(folder: Path) -> None:
    """Removes the files of an earlier attempt of a run."""
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.with_name(folder.name + LOG_SUFFIX).unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
