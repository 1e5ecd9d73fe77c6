"""The options ``--workers`` and ``--ray`` of commands with many independent units of work, and the backend that they select."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.cli.console import say
from gibson_sim.errors import ConfigError
from gibson_sim.reading import exists

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Backend


def add_workers(parser: Any, what: str) -> None:
    """Adds the options. ``what``: the units, such as "bags"."""
    parser.add_argument(
        "--workers",
        type=int,
        default=None,
        metavar="N",
        help=f"{what} at the same time, each in its own process (default: 1)",
    )
    parser.add_argument(
        "--ray", metavar="ADDRESS", help="work on a Ray cluster, such as auto or 10.0.0.5:6379 (docs/many_machines.md)"
    )


def workers_of(args: argparse.Namespace, default: int | None = None) -> int | str | None:
    """Returns the number of workers, or the address of a Ray cluster; None = neither option is given, and there is no default.

    Args:
        args: parsed arguments with the options.
        default: number of workers if neither option is given.

    Raises:
        ConfigError: both are given.
    """
    if args.ray is None:
        return default if args.workers is None else int(args.workers)
    if args.workers is not None:
        raise ConfigError("--workers and --ray exclude each other: the cluster decides how many units run at the same time")
    return str(args.ray)


def backend_of(args: argparse.Namespace, what: str = "units of work", default: int | None = None) -> Backend | None:
    """Returns the backend that executes the units; None = neither option is given, and there is no default.

    Args:
        args: parsed arguments with the options.
        what: the units, such as "bags".
        default: number of workers if neither option is given.

    Raises:
        GibsonSimError: both are given, or one is not possible on this machine.
    """
    from gibson_sim.jobs.units import backend_for

    workers = workers_of(args, default)
    return None if workers is None else backend_for(workers, partial(report_interrupt, what))


def report_interrupt(what: str, running: int) -> None:
    """Prints what happens after Ctrl-C, since it takes a few seconds; ``running``: number of running units, 0 = unknown."""
    say(
        f"interrupted: ending {f'{running} {what}' if running else what}, and all their processes; Ctrl-C again does not wait for them"
    )


def files_of(values: dict[str, Any], keys: tuple[str, ...]) -> tuple[Path, ...]:
    """Returns the settings of ``keys`` that are local files or folders, and makes them absolute in ``values``."""
    files = []
    for key in keys:
        if values[key] and exists(values[key]):
            files.append(Path(values[key]).absolute())
            values[key] = str(files[-1])
    return tuple(files)
