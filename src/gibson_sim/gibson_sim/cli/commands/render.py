"""``gibson-sim render``: draws a recorded run again from its states, with other cameras, lights or appearances."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from gibson_sim.bags.folders import check_bag
from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.options import add_settings, given, settings_from_args
from gibson_sim.cli.processes import become
from gibson_sim.client_config import RenderBagConfig
from gibson_sim.config import RenderConfig

_RENDER = ("egl_device", "egl_uuid", "egl_library", "detail_px", "compress_textures", "cache", "register_depth", "asset_roots")


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "render",
        help="draw a recorded run again from its states, without physics: other cameras, outputs, lights or appearances",
        description="Draws the states of a bag and writes a new bag with the images and everything else of the old one. "
        "The bag must have /scene and /scene_state, as bags of `gibson-sim run --record` have.",
    )
    parser.add_argument("bag", metavar="DIR", help="folder of the recorded bag")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder of the new bag; it must not exist, or be empty")
    add_settings(
        parser,
        RenderBagConfig,
        (
            "cameras", "views", "view_size", "view_rate", "outputs", "rate", "interpolate", "lights", "randomise", "randomise_seed",
            "copy", "compression", "reserve_mb",
        ),
    )  # fmt: skip
    parser.add_argument("--from", dest="begin", type=float, metavar="S", help="begin S seconds after the start of the bag")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="end S seconds after the start of the bag")
    add_settings(parser, RenderConfig, _RENDER)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    """Replaces this process by the one that draws, which thus owns the terminal, the signals and the exit code."""
    require_nodes()
    job = settings_from_args(RenderBagConfig, args)
    render = RenderConfig(**given(args, _RENDER))
    check_bag(args.bag)
    environment = node_environment()
    become("render_bag", [json.dumps({"bag": asdict(job), "render": asdict(render)})], environment)
