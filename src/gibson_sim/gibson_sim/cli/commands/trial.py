"""``gibson-sim trial``: runs a robot's stack many times in simulation, evaluates each run, and compares trials."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.console import say
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.workers import add_workers, workers_of
from gibson_sim.errors import ConfigError

if TYPE_CHECKING:
    from gibson_sim.trials.comparison import Comparison
    from gibson_sim.trials.report.results import TrialResults

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
        from gibson_sim.trials.scenario.keys import schema_text

        print(schema_text(), end="")
        return ExitCode.OK
    _check(args)
    if args.scenario is None:
        return _compare_two(args)
    # Imported here, since a comparison of two files does not need it.
    from gibson_sim.trials.scenario.load import ScenarioError

    try:
        return _plan(args) if args.plan else _run(args)
    except ScenarioError as error:
        for mistake in error.mistakes:
            say(f"gibson-sim: error: {mistake}")
        return ExitCode.ERROR


def _check(args: argparse.Namespace) -> None:
    """Checks the combination of options.

    Raises:
        ConfigError: they cannot be combined.
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


def _plan(args: argparse.Namespace) -> int:
    """Prints the planned runs."""
    from gibson_sim.cli.trial_progress import TrialProgress
    from gibson_sim.trials.report.words import plan_table
    from gibson_sim.trials.running import plan

    print(plan_table(plan(args.scenario, numbers=args.numbers, runs=args.runs, progress=TrialProgress())))
    return ExitCode.OK


def _run(args: argparse.Namespace) -> int:
    """Runs a trial, prints its results, and returns the exit code."""
    from gibson_sim.cli.trial_progress import TrialProgress
    from gibson_sim.trials.comparison import compare
    from gibson_sim.trials.report.results import read_results
    from gibson_sim.trials.running import TrialInterrupted, run as run_trial

    before = read_results(args.compare[0]) if args.compare else None
    workers = workers_of(args, default=1)
    assert workers is not None
    is_interrupted = False
    try:
        trial = run_trial(
            args.scenario, workers=workers, output=args.output, numbers=args.numbers, runs=args.runs, restart=args.restart, keep=args.keep,
            resume=args.resume, compare=before, progress=TrialProgress(),
        )  # fmt: skip
    except TrialInterrupted as interruption:
        trial, is_interrupted = interruption.results, True
    comparison = None if before is None else compare(before.results, trial.results)
    _print(args, trial, comparison)
    if is_interrupted:
        return _say_how_to_go_on(args, trial)
    declined = args.fail_if_worse and comparison is not None and comparison.is_decline
    return ExitCode.ERROR if trial.failed or not trial.is_complete or declined else ExitCode.OK


def _options(args: argparse.Namespace) -> tuple[str, ...]:
    """Returns the options that a repetition of a run needs."""
    from gibson_sim.trials.running import Overrides

    return Overrides(args.runs, args.restart, args.keep).options()


def _compare_two(args: argparse.Namespace) -> int:
    from gibson_sim.trials.comparison import compare
    from gibson_sim.trials.report.results import read_results

    before, after = map(read_results, args.compare)
    print(f"before: {before.rate.text()}\nafter:  {after.rate.text()}")
    comparison = compare(before.results, after.results)
    _print_comparison(comparison)
    return ExitCode.ERROR if args.fail_if_worse and comparison.is_decline else ExitCode.OK


def _print_comparison(comparison: Comparison) -> None:
    from gibson_sim.trials.report.words import run_line

    for name, pairs in (("worse", comparison.worse), ("better", comparison.better)):
        for pair in pairs:
            print(f"got {name:6} {run_line(pair.after)}")
    for line in comparison.lines():
        print(line)


def _print(args: argparse.Namespace, trial: TrialResults, comparison: Comparison | None) -> None:
    from gibson_sim.trials.report.words import can_be_replayed, replay_command, rerun_command

    folder = trial.folder
    assert folder is not None
    print(trial.rate.text())
    for kind, numbers in trial.causes().items():
        listed = ", ".join(map(str, numbers[:_MOST_LISTED])) + (", ..." if len(numbers) > _MOST_LISTED else "")
        print(f"  {kind}: {len(numbers)} (run {listed})")
    if comparison is not None:
        _print_comparison(comparison)
    if trial.failed:
        first = trial.failed[0].run.number
        if can_be_replayed(folder, trial.failed[0]):
            print(f"run {first}, to the bit: {replay_command(folder, first)}")
        print(f"run {first}, with the stack: {rerun_command(trial.file, first, _options(args))}")
    print(f"page: {folder / 'index.html'}")


def _say_how_to_go_on(args: argparse.Namespace, trial: TrialResults) -> int:
    rest = [word for number in args.numbers for word in ("--run", str(number))]
    for name, value in (("--workers", args.workers), ("--ray", args.ray), ("--keep", args.keep)):
        rest += [] if value is None else [name, str(value)]
    if args.compare:
        rest += ["--compare", str(args.compare[0]), *["--fail-if-worse"] * args.fail_if_worse]
    words = ["gibson-sim", "trial", trial.file, *_options(args), *rest, "--output", str(trial.folder), "--resume"]
    say(f"interrupted: {len(trial.results)} of {trial.planned} runs are kept; to continue: {shlex.join(words)}")
    return ExitCode.INTERRUPTED
