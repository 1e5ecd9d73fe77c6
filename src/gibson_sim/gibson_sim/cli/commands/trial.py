"""``gibson-sim trial``: runs a robot's stack many times in simulation, evaluates each run, and compares trials."""

from __future__ import annotations

import argparse
import platform
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim import __version__
from gibson_sim.cli.console import say
from gibson_sim.cli.environment import require_nodes
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.workers import add_workers, backend_of
from gibson_sim.errors import ConfigError

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Backend
    from gibson_sim.trials.comparing.comparison import Comparison
    from gibson_sim.trials.records import RunResult, RunSpec
    from gibson_sim.trials.report.results import TrialResults
    from gibson_sim.trials.scenario_spec import Scenario

_OUTPUT = Path("out") / "trials"
_MOST_LISTED = 12
"""Maximum number of run numbers in a line."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "trial",
        help="run a robot's stack many times in simulation, each run with a verdict; compare two trials",
        description="Results are in the output folder: index.html, results.json, junit.xml, and a folder for each run. The exit code is 0 "
        "if all runs passed, and 1 if not.",
    )
    parser.add_argument("scenario", nargs="?", metavar="FILE", help="scenario file (trial.yaml), or the name of a built-in one")
    parser.add_argument("--output", type=Path, metavar="DIR", help="new folder for the results (default: out/trials/NAME_TIME)")
    add_workers(parser, "runs")
    parser.add_argument(
        "--run", dest="numbers", type=int, nargs="+", action="extend", default=[], metavar="N", help="only these runs of the plan"
    )
    parser.add_argument("--runs", type=int, metavar="N", help="number of runs in each scene with each robot; overrides the file")
    parser.add_argument(
        "--restart", choices=("each", "never"), help="restart the stack for each run, or keep it running; overrides the file"
    )
    parser.add_argument("--keep", choices=("failed", "all"), help="bags to keep; overrides the file")
    parser.add_argument(
        "--resume", action="store_true", help="continue the trial in --output; runs that already have a result are skipped"
    )
    parser.add_argument(
        "--compare", type=Path, nargs="+", metavar="FILE",
        help="results.json of an earlier trial to compare with; with two of them, and no scenario, these are compared",
    )  # fmt: skip
    parser.add_argument(
        "--fail-if-worse",
        action="store_true",
        help="with --compare: exit code 1 also if significantly more runs got worse than better",
    )
    parser.add_argument("--plan", action="store_true", help="print the planned runs, and exit")
    parser.add_argument("--schema", action="store_true", help="print the JSON schema of scenario files, for editors, and exit")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Runs, plans or compares trials."""
    if args.schema:
        from gibson_sim.trials.scenario.json_schema import schema_text

        print(schema_text(), end="")
        return ExitCode.OK
    _check(args)
    if args.scenario is None:
        return _compare_two(args)
    # Imported here, since a comparison of two files does not need it.
    from gibson_sim.trials.report.words import plan_table
    from gibson_sim.trials.running import Overrides, check, check_output_folder, claimed
    from gibson_sim.trials.scenario.load import ScenarioError, load_scenario

    before = _results(args.compare[0]) if args.compare else None
    changes, backend = Overrides(args.runs, args.restart, args.keep), _backend(args)
    try:
        scenario = changes.applied(load_scenario(args.scenario))
        folder: Path = args.output or _OUTPUT / f"{scenario.name}_{datetime.now():%Y%m%d-%H%M%S}"
        if not args.plan:
            # Check before the runs are planned, which may take minutes.
            if not args.ray:
                require_nodes()
            check_output_folder(folder, resume=args.resume)
            check(scenario)
        plan = _plan(scenario, () if args.resume else args.numbers)
    except ScenarioError as error:
        for mistake in error.mistakes:
            say(f"gibson-sim: error: {mistake}")
        return ExitCode.ERROR
    runs = [one for one in plan if not args.numbers or one.number in args.numbers]
    if args.plan:
        print(plan_table(runs))
        return ExitCode.OK
    with claimed(folder, resume=args.resume):
        return _Trial(args, scenario, changes, plan, runs, before, folder).execute(backend)


def _plan(scenario: Scenario, numbers: Sequence[int]) -> Sequence[RunSpec]:
    """Returns the planned runs; reports progress if planning takes long."""
    from gibson_sim.cli.trial_progress import PlanProgress
    from gibson_sim.trials.planning.plan import plan_runs

    progress = PlanProgress()
    try:
        return plan_runs(scenario, numbers, progress.report)
    finally:
        progress.close()


def _check(args: argparse.Namespace) -> None:
    """Checks the combination of options.

    Raises:
        ConfigError: they do not.
    """
    compared = args.compare or []
    if args.scenario is None and len(compared) != 2:
        raise ConfigError(
            "give the scenario FILE of a trial, or --compare BEFORE AFTER with the results of two; see docs/trials.md for an example"
        )
    if args.scenario is not None and len(compared) > 1:
        raise ConfigError(
            f"--compare has {len(compared)} files; to run {args.scenario}, give one file, and put the scenario before all options"
        )
    if args.fail_if_worse and not compared:
        raise ConfigError("--fail-if-worse is for --compare: give the results.json of the trial to compare with")
    if args.resume and args.output is None:
        raise ConfigError("--resume needs --output DIR, the folder of the trial to continue")


def _results(path: Path) -> TrialResults:
    from gibson_sim.trials.report.results import read_results

    return read_results(path)


def _compare_two(args: argparse.Namespace) -> int:
    from gibson_sim.trials.comparing.comparison import compare

    before, after = map(_results, args.compare)
    print(f"before: {before.rate.text()}\nafter:  {after.rate.text()}")
    comparison = compare(before.results, after.results)
    _print_comparison(comparison)
    return ExitCode.ERROR if args.fail_if_worse and comparison.is_decline else ExitCode.OK


def _print_comparison(comparison: Comparison) -> None:
    for name, pairs in (("worse", comparison.worse), ("better", comparison.better)):
        for pair in pairs:
            from gibson_sim.trials.report.words import run_line

            print(f"got {name:6} {run_line(pair.after)}")
    for line in comparison.lines():
        print(line)


class _Trial:
    """A trial, from the plan to its report."""

    def __init__(
        self,
        args: argparse.Namespace,
        scenario: Scenario,
        changes: Any,
        plan: Sequence[RunSpec],
        runs: Sequence[RunSpec],
        before: TrialResults | None,
        folder: Path,
    ) -> None:
        self._args, self._scenario, self._changes, self._plan = args, scenario, changes, plan
        self._runs, self._before, self._folder = runs, before, folder
        self._results: dict[int, RunResult] = {}
        self._comparison: Comparison | None = None

    def execute(self, backend: Backend) -> int:
        """Executes the runs with a backend, writes the report, and returns the exit code."""
        from gibson_sim.cli.trial_progress import TrialProgress
        from gibson_sim.trials.comparing.comparison import runs_text
        from gibson_sim.trials.report.results import RESULTS
        from gibson_sim.trials.running import execute_runs, finished

        spent = 0.0
        if self._args.resume:
            self._results = finished(self._folder, self._plan)
            spent = _results(self._folder).wall_time if (self._folder / RESULTS).exists() else 0.0
        todo = [run for run in self._runs if run.number not in self._results]
        already_done = f", {len(self._runs) - len(todo)} of them already done" if len(todo) < len(self._runs) else ""
        say(f"{self._scenario.name}: {runs_text(len(self._runs))}{already_done}; results go into {self._folder}")
        progress = TrialProgress(len(self._runs), len(self._runs) - len(todo))
        started, begin = datetime.now(timezone.utc), time.monotonic()

        def keep(result: RunResult) -> None:
            self._results[result.run.number] = result
            progress.add(result)

        interrupted = False
        progress.begins()
        try:
            execute_runs(self._scenario, self._changes, todo, backend, self._folder, keep, progress.report)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            progress.close()
        trial = self._write(started, spent + time.monotonic() - begin)
        self._print(trial)
        if interrupted:
            return self._say_how_to_go_on(trial)
        declined = self._args.fail_if_worse and self._comparison is not None and self._comparison.is_decline
        return ExitCode.ERROR if trial.failed or not trial.is_complete or declined else ExitCode.OK

    def _write(self, started: datetime, wall_time: float) -> TrialResults:
        """Writes all files of the report; returns their results."""
        from gibson_sim.trials.comparing.comparison import compare
        from gibson_sim.trials.report.junit import FILE as JUNIT, junit_xml
        from gibson_sim.trials.report.page import FILE as PAGE, trial_page
        from gibson_sim.trials.report.results import TrialResults, write_results
        from gibson_sim.writing import write_file

        results = tuple(self._results[number] for number in sorted(self._results))
        compared = None
        if self._before is not None:
            self._comparison = compare(self._before.results, results)
            compared = {**self._comparison.to_json(), "file": str(self._args.compare[0])}
        trial = TrialResults(
            name=self._scenario.name,
            file=self._args.scenario,
            results=results,
            planned=len(self._runs) if not self._args.resume else max(len(self._runs), len(results)),
            scenario=asdict(replace(self._scenario)),
            versions={"gibson_sim": __version__, "python": platform.python_version(), "system": platform.platform()},
            machine={"name": platform.node(), "processor": _processor()},
            started=started.isoformat(timespec="seconds"),
            wall_time=wall_time,  # of all parts of a trial that was interrupted
            workers=self._args.ray or str(self._args.workers or 1),
            comparison=compared,
        )
        options = self._changes.options()
        write_results(trial, self._folder)
        write_file(self._folder / JUNIT, junit_xml(trial, self._folder, options))
        write_file(self._folder / PAGE, trial_page(trial, self._folder, options, f"made by gibson-sim {__version__} trial"))
        return trial

    def _print(self, trial: TrialResults) -> None:
        from gibson_sim.trials.report.words import can_be_replayed, replay_command, rerun_command

        print(trial.rate.text())
        for kind, numbers in trial.causes().items():
            listed = ", ".join(map(str, numbers[:_MOST_LISTED])) + (", ..." if len(numbers) > _MOST_LISTED else "")
            print(f"  {kind}: {len(numbers)} (run {listed})")
        if self._comparison is not None:
            _print_comparison(self._comparison)
        if trial.failed:
            first = trial.failed[0].run.number
            if can_be_replayed(self._folder, trial.failed[0]):
                print(f"run {first}, to the bit: {replay_command(self._folder, first)}")
            print(f"run {first}, with the stack: {rerun_command(trial.file, first, self._changes.options())}")
        print(f"page: {self._folder / 'index.html'}")

    def _say_how_to_go_on(self, trial: TrialResults) -> int:
        rest = [word for number in self._args.numbers for word in ("--run", str(number))]
        for name, value in (("--workers", self._args.workers), ("--ray", self._args.ray), ("--keep", self._args.keep)):
            rest += [] if value is None else [name, str(value)]
        if self._args.compare:
            rest += ["--compare", str(self._args.compare[0]), *["--fail-if-worse"] * self._args.fail_if_worse]
        words = ["gibson-sim", "trial", trial.file, *self._changes.options(), *rest, "--output", str(self._folder), "--resume"]
        say(f"interrupted: {len(trial.results)} of {trial.planned} runs are kept; to continue: {shlex.join(words)}")
        return ExitCode.INTERRUPTED


def _backend(args: argparse.Namespace) -> Backend:
    """Returns the backend that executes the runs: one worker by default."""
    backend = backend_of(args, "runs", default=1)
    assert backend is not None
    return backend


def _processor() -> str:
    """Returns the number and the model of the processors of this machine."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{len(names)} x {names[0]}" if names else platform.processor()
