"""``gibson-sim render``: re-renders a recorded run from its states, with other cameras, lights or appearances."""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.bags.folders import check_bag
from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.options import add_settings, given, settings_from_args
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.processes import become
from gibson_sim.cli.workers import add_workers, backend_of, files_of
from gibson_sim.client_config import RenderBagConfig
from gibson_sim.config import RenderConfig
from gibson_sim.errors import ConfigError

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Backend

_RENDER = ("egl_device", "egl_uuid", "egl_library", "detail_px", "compress_textures", "cache", "register_depth", "asset_roots")
_FILES = ("bag", "cameras", "lights", "randomise")
"""Settings that can be files."""
_FUNCTION = "gibson_sim.ros.recording.render_bag:render_one"


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "render",
        help="re-render a recorded run from its states, without physics: other cameras, outputs, lights or appearances",
        description="Renders the states of a bag, and writes a new bag with the images and all other topics of the old one. "
        "The bag must have /scene and /scene_state, as bags of `gibson-sim run --record` have.",
    )
    parser.add_argument("bag", nargs="+", metavar="DIR", help="folder of the recorded bag; several are rendered by workers")
    parser.add_argument(
        "--output",
        required=True,
        metavar="DIR",
        help="folder of the new bag: new or empty; for several bags, the folder in which their new bags get the same names",
    )
    add_workers(parser, "bags")
    add_settings(
        parser,
        RenderBagConfig,
        (
            "cameras", "views", "view_size", "view_rate", "outputs", "rate", "interpolate", "lights", "randomise", "randomise_seed",
            "copy", "compression", "reserve_mb", "samples", "blender_python",
        ),
    )  # fmt: skip
    parser.add_argument(
        "--with",
        dest="tracer",
        metavar="NAME",
        help="trace the colours by a program: cycles (Blender's path tracer, gibson_sim_tools)",
    )
    parser.add_argument("--from", dest="begin", type=float, metavar="S", help="begin S seconds after the start of the bag")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="end S seconds after the start of the bag")
    add_settings(parser, RenderConfig, _RENDER)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    """Replaces this process by the rendering process, so that it owns the terminal, the signals and the exit code; or renders with workers."""
    require_nodes()
    bags, output = args.bag, args.output
    backend = backend_of(args, "bags")
    if len(bags) > 1 or args.ray is not None:
        return _run_on_workers(args, bags, output, backend)
    args.bag = bags[0]
    job = settings_from_args(RenderBagConfig, args)
    render = RenderConfig(**given(args, _RENDER))
    check_bag(args.bag)
    environment = node_environment()
    become("render_bag", [json.dumps({"bag": asdict(job), "render": asdict(render)})], environment)


def _run_on_workers(args: argparse.Namespace, bags: list[str], output: str, backend: Backend | None) -> int:
    """Renders each bag on a worker; prints one line for each."""
    from gibson_sim.jobs.local import LocalWorkers
    from gibson_sim.jobs.units import Unit, UnitResult, run_units

    render = asdict(RenderConfig(**given(args, _RENDER)))
    units: list[Unit] = []
    names: dict[str, str] = {}
    """Name of a new bag -> recorded bag."""
    for bag in bags:
        check_bag(bag)
        args.bag = bag
        job = asdict(settings_from_args(RenderBagConfig, args))
        files = files_of(job, _FILES)
        shipped = [key for key in _FILES if Path(job[key]) in files]
        name = re.sub(r"[^A-Za-z0-9._-]", "_", Path(job["bag"]).resolve().name)
        if name in names:
            raise ConfigError(
                f"bags {names[name]} and {bag} would both become {Path(output) / name}; rename one, or render them one at a time"
            )
        names[name] = bag
        units.append(Unit(name, _FUNCTION, {"bag": job, "render": render, "files": shipped}, files))

    def on_result(result: UnitResult) -> None:
        text = result.value if not result.error else f"error: {result.error}"
        where = "" if result.log is None else f" (see {result.log})"
        print(f"{Path(output) / result.id}: {text}{where}", flush=True, file=sys.stderr if result.error else sys.stdout)

    results = run_units(units, backend or LocalWorkers(1), output=Path(output), on_result=on_result)
    return ExitCode.ERROR if any(result.error for result in results) else ExitCode.OK
