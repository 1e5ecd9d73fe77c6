"""``gibson-sim learn``: trains networks for robots."""

from __future__ import annotations

import argparse
import importlib.util
import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gibson_sim.cli.console import CONSOLE, Console, say
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import write_json
from gibson_sim.errors import ConfigError, EnvironmentProblemError
from gibson_sim.picture_files import check_picture_suffix
from gibson_sim.writing import check_writable
from gibson_sim_learn.filler.settings import EvaluationSettings, PairsSettings, TrainingSettings
from gibson_sim_learn.training_folder import locked

_NEEDED = ("torch", "onnx", "onnxruntime")
"""Packages of the extra ``learn`` that a training needs."""
INSTALL = "pip install -c constraints.txt --extra-index-url https://download.pytorch.org/whl/cpu 'gibson_sim_learn[learn]'"
"""Command that installs them in the environment of ``make setup``: at versions that suit its packages, and PyTorch for the CPU."""
_PERIOD_S = 30.0
"""Wall time between two lines of progress if the output is not a terminal, seconds."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("learn", help="train networks for robots, with PyTorch")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    path = kinds.add_parser(
        "path-following",
        help="train the network for visual path following",
        description=(
            "Renders data in the training scenes, trains, drives with the network and trains further (DAgger): several hours on two cores. "
            "The same command resumes it after an interruption. To try it out in minutes: --config docs/examples/path_following_trial.yaml. "
            "See docs/path_following_training.md."
        ),
    )
    path.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="YAML file of the training; keys that it omits have their defaults (default: path_following.yaml of the package)",
    )
    path.add_argument(
        "--folder",
        type=Path,
        default=Path("out/path_following"),
        metavar="DIR",
        help="folder for data, checkpoints, training curve and network (default: out/path_following)",
    )
    path.add_argument("--seed", type=int, metavar="N", help="random seed of data and training (default: that of the file)")
    path.set_defaults(run=run)
    goggles = kinds.add_parser(
        "goggles",
        help="train the network that adapts a camera's images to the simulator's appearance",
        description=(
            "Renders pairs of images in the training scenes and trains, in about ten minutes on two cores. "
            "The same command resumes it after an interruption. See docs/goggles.md."
        ),
    )
    goggles.add_argument("--iterations", type=int, metavar="N", help="optimiser steps (default: 3000)")
    goggles.add_argument(
        "--folder",
        type=Path,
        default=Path("out/goggles"),
        metavar="DIR",
        help="folder for pairs, checkpoints, training curve and network (default: out/goggles)",
    )
    goggles.add_argument("--seed", type=int, default=0, metavar="N", help="random seed of pairs and training (default: 0)")
    goggles.set_defaults(run=run_goggles)
    _add_filler(kinds)


def _add_filler(kinds: Any) -> None:
    filler = kinds.add_parser(
        "filler",
        help="train the network that fills holes of scans",
        description="Three steps in one folder; each resumes where it was interrupted. See docs/filler_training.md.",
    )
    steps = filler.add_subparsers(dest="step", required=True, metavar="STEP")
    folder = argparse.ArgumentParser(add_help=False)
    folder.add_argument(
        "--folder",
        type=Path,
        default=Path("out/filler"),
        metavar="DIR",
        help="folder for scans, pairs and training (default: out/filler)",
    )
    pairs = steps.add_parser(
        "pairs",
        parents=[folder],
        help="scan the scenes, and render the same views in the scans and in the scenes",
        description="Needs pip install 'gibson_sim_tools[scanning]'.",
    )
    add_settings(pairs, PairsSettings, ("shards", "frames", "triangles", "seed"))
    pairs.add_argument(
        "--scenes",
        metavar="NAMES",
        help="only these, separated by commas; several processes may work on different scenes (default: all)",
    )
    pairs.set_defaults(run=run_filler_pairs)
    train = steps.add_parser("train", parents=[folder], help="train with these pairs; writes training/filler.onnx")
    add_settings(
        train,
        TrainingSettings,
        ("iterations", "batch", "crop", "learning_rate", "weight_decay", "consistency", "evaluate_every", "seed"),
    )
    train.set_defaults(run=run_filler_training)
    evaluate = steps.add_parser(
        "evaluate",
        parents=[folder],
        help="compare a network with fillers that need no training",
        description="Evaluates in the held-out scenes; to choose parameters, use --validation.",
    )
    evaluate.add_argument("--model", type=Path, metavar="FILE", help="the network (default: training/filler.onnx of the folder)")
    evaluate.add_argument("--validation", action="store_true", help="evaluate in the validation scenes")
    add_settings(evaluate, EvaluationSettings, ("every", "drive", "seed"))
    evaluate.add_argument(
        "--sheet", type=Path, metavar="FILE", help="contact sheet of examples: scan, push-pull, network, ground truth"
    )
    evaluate.add_argument("--report", type=Path, metavar="FILE", help="write the metrics as JSON")
    evaluate.set_defaults(run=run_filler_evaluation)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Trains, and prints the path of the network."""
    from gibson_sim_learn.path_following.settings import load_settings

    settings = load_settings(args.config, args.seed)
    require_learning()
    with _progress() as progress:
        from gibson_sim_learn.path_following.pipeline import learn

        learned = learn(args.folder, settings, progress)
    print(f"{learned.model}: {learned.size / 1e6:.1f} MB; card: {learned.card}; curve: {args.folder / 'curve.png'}")
    return 0


@quiet()
def run_goggles(args: argparse.Namespace) -> int:
    """Trains Goggles, and prints the metrics and the path of the network."""
    from gibson_sim_learn.goggles.settings import GogglesSettings

    settings = GogglesSettings(seed=args.seed, **({} if args.iterations is None else {"iterations": args.iterations}))
    require_learning()
    with _progress() as progress:
        from gibson_sim_learn.goggles.pipeline import learn

        learned = learn(args.folder, settings, progress)
    print("\n".join(learned.scores))
    print(f"{learned.model}: {learned.size / 1e6:.1f} MB; card: {learned.card}; examples: {args.folder / 'sheet.png'}")
    return 0


@quiet()
def run_filler_pairs(args: argparse.Namespace) -> int:
    """Renders training pairs of the filler, and prints their path."""
    settings = settings_from_args(PairsSettings, args)
    if importlib.util.find_spec("open3d") is None:  # found here, not after the first scan
        raise EnvironmentProblemError("Open3D, which fuses the scans, is not installed: pip install 'gibson_sim_tools[scanning]'")
    with _progress() as progress:
        from gibson_sim_learn.filler.pairs import command_of
        from gibson_sim_learn.filler.pipeline import PAIRS, SCENES, make_all_pairs, missing_for_training

        make_all_pairs(args.folder, settings, SCENES if args.scenes is None else args.scenes.split(","), progress)
    missing = missing_for_training(args.folder)
    following = f"gibson-sim learn filler train --folder {shlex.quote(str(args.folder))}"
    if missing:
        following = f"{command_of(args.folder / PAIRS)}, which draws the {len(missing)} shards that training needs"
    print(f"{args.folder / PAIRS} holds the pairs{' of ' + args.scenes if args.scenes else ''}; next: {following}")
    return 0


@quiet()
def run_filler_training(args: argparse.Namespace) -> int:
    """Trains the filler, and prints its metrics and the path of the network."""
    settings = settings_from_args(TrainingSettings, args)
    require_learning()
    with _progress() as progress:
        from gibson_sim_learn.filler.pipeline import TRAINED, train

        with locked(args.folder / TRAINED):
            trained = train(args.folder, settings, progress)
    print(trained.summary)
    print(f"{trained.model}: {trained.size / 1e6:.1f} MB; card: {trained.card}; curve: {trained.card.with_name('curve.png')}")
    return 0


@quiet()
def run_filler_evaluation(args: argparse.Namespace) -> int:
    """Compares fillers, and prints a table."""
    settings = settings_from_args(EvaluationSettings, args)
    for file in (args.sheet, args.report):  # found here, not after the evaluation
        if file is not None:
            check_writable(file)
    if args.sheet is not None:
        check_picture_suffix(args.sheet)
    with _progress("interrupted; nothing is written") as progress:
        from gibson_sim_learn.filler.pipeline import evaluate
        from gibson_sim_learn.path_following.split import HELD_OUT, VALIDATION

        found = evaluate(
            args.folder,
            VALIDATION if args.validation else HELD_OUT,
            args.model,
            settings,
            sheet_file=args.sheet,
            progress=progress,
        )
    print("\n".join(found.lines))
    write_json(args.report, found.values)
    return 0


def require_learning() -> None:
    """Checks that the packages that a training needs are installed.

    Raises:
        ConfigError: a package is missing.
    """
    for name in _NEEDED:
        if importlib.util.find_spec(name) is None:
            raise ConfigError(f"learning needs {name}, which is not installed; in the checkout: {INSTALL}")


@contextmanager
def _progress(on_interrupt: str = "interrupted; the same command resumes") -> Iterator[Callable[[str], None]]:
    """Yields a function that shows a line of progress; clears the line at the end, and prints ``on_interrupt`` after Ctrl-C."""
    try:
        yield _Progress(CONSOLE).show
    except KeyboardInterrupt:
        CONSOLE.status("")
        say(on_interrupt)
        raise
    finally:
        CONSOLE.status("")


class _Progress:
    """Rewrites one status line on a terminal; otherwise writes at most one line per ``_PERIOD_S``."""

    def __init__(self, console: Console) -> None:
        self._console, self._last_written_s = console, -_PERIOD_S

    def show(self, text: str) -> None:
        now = time.monotonic()
        if self._console.is_terminal:
            self._console.status(text)
        elif now - self._last_written_s >= _PERIOD_S:
            self._last_written_s = now
            self._console.write(text)
