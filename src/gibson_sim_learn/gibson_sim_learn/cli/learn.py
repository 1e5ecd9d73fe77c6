"""``gibson-sim learn``: trains networks for robots."""

from __future__ import annotations

import argparse
import importlib.util
import time
from pathlib import Path
from typing import Any

from gibson_sim.cli.console import CONSOLE, Console
from gibson_sim.cli.quiet import quiet
from gibson_sim.errors import ConfigError

_NEEDED = ("torch", "onnx", "onnxruntime")
"""Packages of the extra ``learn`` that a training cannot do without."""
_PERIOD_S = 30.0
"""Wall time between two lines where no terminal shows a bar, seconds."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("learn", help="train networks for robots, with PyTorch")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    path = kinds.add_parser(
        "path-following",
        help="train the network that follows paths by images",
        description=(
            "Draws data in the training scenes, trains, drives with the network and trains on. It goes on where it was interrupted. "
            "docs/path_following_training.md"
        ),
    )
    path.add_argument("--config", type=Path, metavar="FILE", help="YAML file of the training (default: that of the package)")
    path.add_argument(
        "--folder",
        type=Path,
        default=Path("out/path_following"),
        metavar="DIR",
        help="where data, checkpoints, curve and network are put (default: out/path_following)",
    )
    path.add_argument("--seed", type=int, metavar="N", help="of data and training (default: that of the file)")
    path.set_defaults(run=run)
    goggles = kinds.add_parser(
        "goggles",
        help="train the network that brings a camera's images to the simulator's look",
        description=(
            "Draws pairs of images in the training scenes and trains. It goes on where it was interrupted. docs/goggles.md"
        ),
    )
    goggles.add_argument("--iterations", type=int, metavar="N", help="steps of the optimiser (default: 3000)")
    goggles.add_argument(
        "--folder",
        type=Path,
        default=Path("out/goggles"),
        metavar="DIR",
        help="where pairs, checkpoints, curve and network are put (default: out/goggles)",
    )
    goggles.add_argument("--seed", type=int, default=0, metavar="N", help="of pairs and training (default: 0)")
    goggles.set_defaults(run=run_goggles)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Trains, and prints where the network is."""
    from gibson_sim_learn.path_following.settings import load_settings

    settings = load_settings(args.config, args.seed)
    require_learning()
    from gibson_sim_learn.path_following.pipeline import learn

    progress = _Progress(CONSOLE)
    try:
        learned = learn(args.folder, settings, progress.tell)
    finally:
        CONSOLE.status("")
    print(f"{learned.model}: {learned.size / 1e6:.1f} MB; card: {learned.card}; curve: {args.folder / 'curve.png'}")
    return 0


@quiet()
def run_goggles(args: argparse.Namespace) -> int:
    """Trains Goggles, and prints how near they bring images to the simulator's, and where the network is."""
    from gibson_sim_learn.goggles.settings import GogglesSettings

    settings = GogglesSettings(seed=args.seed, **({} if args.iterations is None else {"iterations": args.iterations}))
    require_learning()
    from gibson_sim_learn.goggles.pipeline import learn

    progress = _Progress(CONSOLE)
    try:
        learned = learn(args.folder, settings, progress.tell)
    finally:
        CONSOLE.status("")
    print("\n".join(learned.scores))
    print(f"{learned.model}: {learned.size / 1e6:.1f} MB; card: {learned.card}; examples: {args.folder / 'sheet.png'}")
    return 0


def require_learning() -> None:
    """Checks that the packages that a training needs are installed.

    Raises:
        ConfigError: one is not.
    """
    for name in _NEEDED:
        if importlib.util.find_spec(name) is None:
            raise ConfigError(f"learning needs {name}, which is not installed: pip install gibson_sim_learn[learn]")


class _Progress:
    """One line that is rewritten on a terminal; elsewhere a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console, self._told = console, -_PERIOD_S

    def tell(self, text: str) -> None:
        now = time.monotonic()
        if self._console.is_terminal:
            self._console.status(text)
        elif now - self._told >= _PERIOD_S:
            self._told = now
            self._console.write(text)
