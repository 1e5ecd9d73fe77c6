"""The options ``--workers`` and ``--ray`` of commands whose work is many independent units, and the backend that they choose."""

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


def backend_of(args: argparse.Namespace, what: str = "units of work", default: int | None = None) -> Backend | None:
    """Returns where the units run; None = neither option is given, and there is no default.

    Args:
        args: with the options.
        what: the units, such as "bags".
        default: number of workers if neither option is given.

    Raises:
        GibsonSimError: both are given, or one is impossible here.
    """
    if args.ray is not None:
        if args.workers is not None:
            raise ConfigError("--workers and --ray exclude each other: the cluster decides how many units run at the same time")
        from gibson_sim.jobs.ray_cluster import RayCluster

        return RayCluster(args.ray, on_interrupt=partial(_say_that_work_ends, what))
    count = default if args.workers is None else args.workers
    if count is None:
        return None
    from gibson_sim.jobs.local import LocalWorkers

    return LocalWorkers(count, on_interrupt=partial(_say_that_work_ends, what))


def _say_that_work_ends(what: str, running: int) -> None:
    """Says what happens after Ctrl-C, since it takes a few seconds. ``running``: number of units; 0 = not known."""
    say(
        f"interrupted: ending {f'{running} {what}' if running else what}, and all their processes; Ctrl-C again does not wait for them"
    )


def files_of(values: dict[str, Any], keys: tuple[str, ...]) -> tuple[Path, ...]:
    """Returns the settings of ``keys`` that are files or folders of this machine, and makes them absolute in ``values``."""
    found = []
    for key in keys:
        if values[key] and exists(values[key]):
            found.append(Path(values[key]).absolute())
            values[key] = str(found[-1])
    return tuple(found)
