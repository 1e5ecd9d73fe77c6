"""Makes the runs of a trial: each is a unit of work (``jobs``), executed and judged in a worker process. Gathers their results."""

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
_FUNCTION = f"{__name__}:make_run"


@dataclass(frozen=True, slots=True)
class Changes:
    """What a command line changes in a scenario; None = nothing."""

    runs: int | None = None
    """In each scene with each robot."""
    restart: Literal["each", "never"] | None = None
    keep: Literal["failed", "all"] | None = None

    def applied(self, scenario: Scenario) -> Scenario:
        """Returns the scenario with these changes.

        Raises:
            ConfigError: a value is impossible.
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
        """Returns those options of the command line that a repetition of a run needs."""
        found = (("--runs", self.runs), ("--restart", self.restart))
        return tuple(word for name, value in found if value is not None for word in (name, str(value)))


def check(scenario: Scenario) -> None:
    """Checks what can be known of a scenario's stack before anything starts.

    Raises:
        GibsonSimError: its program is not there, or what is wanted of it cannot be done.
    """
    # Loaded here: planning and comparing need no ROS domain.
    from gibson_sim.trials.execution import check_stack

    try:
        check_stack(scenario.stack)
    except ConfigError as error:
        raise ConfigError(f"{scenario.path}: {error}") from error


def prepare(folder: Path, *, resume: bool) -> None:
    """Checks that the output folder is new or empty, or is that of a trial that goes on.

    Raises:
        ConfigError: it is not.
    """
    try:
        there = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
        above = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    except NotADirectoryError as error:
        raise ConfigError(f"--output {quoted(str(folder))} is a file, must be a folder") from error
    except OSError as error:
        raise ConfigError(f"--output {quoted(str(folder))}: cannot be read: {error.strerror}") from error
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise ConfigError(
            f"--output {quoted(str(folder))} cannot be made: {above} is {'read-only' if above.is_dir() else 'a file'}"
        )
    if there and not resume:
        is_trial = RESULTS in there or RUNS in there
        remedy = "give a new one, or add --resume to go on with the trial in it" if is_trial else "give a new one"
        raise ConfigError(f"--output {quoted(str(folder))}: the folder holds {quoted(there[0])} already; {remedy}")
    if there and RUNS not in there:
        raise ConfigError(
            f"--output {quoted(str(folder))}: the folder holds {quoted(there[0])}, but no trial to go on with; give another one"
        )


@contextmanager
def claimed(folder: Path, *, resume: bool) -> Iterator[None]:
    """Makes the output folder, see ``prepare``, and keeps other trials out of it in a block.

    Raises:
        ConfigError: another trial is being made in it, or it cannot be used.
        WriteError: it cannot be made.
    """
    in_use = ConfigError(
        f"--output {quoted(str(folder))}: another trial is being made in the folder; wait for it, or give a new one"
    )
    with locked_folder(folder, in_use):
        prepare(folder, resume=resume)
        yield


def finished(folder: Path, runs: Iterable[RunSpec]) -> dict[int, RunResult]:
    """Returns the results of those runs that were made before, in the same way; by number.

    Args:
        folder: of the trial.
        runs: planned runs.
    """
    found = {}
    for run in runs:
        own = run_folder(folder, run.number)
        try:
            before = json.loads(read_file(own / RUN))
            result = result_from_json(json.loads(read_file(own / RESULT)))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
        if before == json.loads(json_text(run.to_json())) and result.outcome.end != "interrupted":
            found[run.number] = result
    return found


def make_runs(
    scenario: Scenario,
    changes: Changes,
    runs: Sequence[RunSpec],
    backend: Backend,
    folder: Path,
    on_result: Callable[[RunResult], None],
    on_progress: Callable[[int, str], None],
) -> None:
    """Makes runs, each with its folder in that of the trial; hands over each result as it comes.

    Args:
        scenario: with the changes.
        changes: that were made in what the file says.
        runs: planned runs.
        backend: where they are made.
        folder: of the trial.
        on_result: called in this thread.
        on_progress: called in this thread with the number of a run and what happens in it.

    Raises:
        WriteError: the folder cannot be written to.
        KeyboardInterrupt: Ctrl-C; all processes have ended, and results that were handed over stay.
    """
    by_id = {f"{run.number:04d}": run for run in runs}
    files = _files(scenario)
    arguments = {"scenario": str(scenario.path), "folder": str(scenario.stack.folder), "changes": asdict(changes)}
    units = [
        # The last one is followed by none; with several workers that holds for the last runs of the others, too, which nobody knows before.
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
            result = broken(scenario, run, unit.error)
            own = run_folder(folder, run.number)
            write_file(own / RUN, json_text(run.to_json()))
            write_file(own / RESULT, json_text(result.to_json()))
        else:
            result = result_from_json(unit.value)
        on_result(result)

    run_units(
        units, backend, output=folder / RUNS, on_result=keep, on_progress=lambda name, text: on_progress(by_id[name].number, text)
    )


def make_run(arguments: dict[str, Any], folder: Path, context: Context) -> dict[str, Any] | None:
    """Executes and judges one run, in a worker process; returns its result as values of JSON, None if it was told to stop.

    Args:
        arguments: the scenario file, what is changed in it, the run, and whether other runs follow it.
        folder: of the run.
        context: of the unit.
    """
    # Loaded here: the command line needs neither to plan nor to compare.
    from gibson_sim.trials.execution import execute
    from gibson_sim.trials.judging import judge
    from gibson_sim.trials.report.keeping import keep_of_run

    scenario = Changes(**arguments["changes"]).applied(load_scenario(context.path(arguments["scenario"])))
    scenario = replace(scenario, stack=replace(scenario.stack, folder=context.path(arguments["folder"])))
    planned = RunSpec.from_json(arguments["run"])
    run = replace(planned, scene=_here(planned.scene, context), robot=_here(planned.robot, context))
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


def broken(scenario: Scenario, run: RunSpec, error: str) -> RunResult:
    """Returns the result of a run whose worker failed: the stack is not to blame."""
    outcome = Outcome("simulation failed", error, lockstep=bool(scenario.stack.lockstep))
    return RunResult(run, outcome, (Verdict("run", False, error),), {}, "", Cause("simulation failed", error))


def _files(scenario: Scenario) -> tuple[Path, ...]:
    """Returns what the workers read, which travels to other machines: the folders of scenario and stack, and of scenes and robots in files."""
    named = [path for path in map(Path, (*scenario.scenes, *scenario.robots)) if path.is_absolute()]
    found = [scenario.path.parent, scenario.stack.folder, *(path.parent if path.is_file() else path for path in named)]
    return tuple(dict.fromkeys(path for path in found if not any(other in path.parents for other in found)))


def _here(name: str, context: Context) -> str:
    """Returns the name of a scene or a robot, or where its file is on this machine."""
    return str(context.path(name)) if Path(name).is_absolute() else name


def _remove(folder: Path) -> None:
    """Removes what an earlier attempt of a run left."""
    try:
        if folder.exists():
            shutil.rmtree(folder)
        folder.with_name(folder.name + LOG_SUFFIX).unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
