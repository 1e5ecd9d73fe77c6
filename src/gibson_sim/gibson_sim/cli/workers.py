"""The options ``--workers`` and ``--ray`` of commands whose work is many independent units, and the backend that they choose."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
        help=f"{what} at the same time, each in a process of its own (default: 1)",
    )
    parser.add_argument(
        "--ray", metavar="ADDRESS", help="work on a Ray cluster, such as auto or 10.0.0.5:6379 (docs/many_machines.md)"
    )


def backend_of(args: argparse.Namespace) -> Backend | None:
    """Returns where the units run; None = neither option is given.

    Raises:
        GibsonSimError: both are given, or one is impossible here.
    """
    if args.ray is not None:
        if args.workers is not None:
            raise ConfigError("--workers and --ray exclude each other: the cluster decides how many units run at the same time")
        from gibson_sim.jobs.ray_cluster import RayCluster

        return RayCluster(args.ray)
    if args.workers is None:
        return None
    from gibson_sim.jobs.local import LocalWorkers

    return LocalWorkers(args.workers)


def files_of(values: dict[str, Any], keys: tuple[str, ...]) -> tuple[Path, ...]:
    """Returns the settings of ``keys`` that are files or folders of this machine, and makes them absolute in ``values``."""
    found = []
    for key in keys:
        if values[key] and exists(values[key]):
            found.append(Path(values[key]).absolute())
            values[key] = str(found[-1])
    return tuple(found)
