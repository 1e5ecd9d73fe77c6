"""``gibson-sim bench peers``: Gibson Sim and third-party renderers, interleaved, on the same mesh and along the same camera path."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gibson_sim.cli.report_file import add_report_options, parse_size, print_progress, write_json
from gibson_sim_bench.protocol import SCAN_SCENES


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "peers",
        help="images per second of Gibson Sim, MuJoCo, pyrender, PyBullet and iGibson, where installed, interleaved",
        description="Each third-party renderer is optional; missing ones are reported: pip install mujoco pyrender pybullet, in any Python.",
    )
    parser.add_argument(
        "--house",
        action="append",
        default=[],
        metavar="X",
        help="scene of one mesh with one texture, instead of the built-in ones",
    )
    parser.add_argument(
        "--peer-python",
        action="append",
        default=[],
        metavar="PATH",
        help="interpreter with third-party renderers installed; may be repeated (default: this one)",
    )
    parser.add_argument(
        "--sizes", default="256x256,640x480", metavar="WxH", help="image sizes, pixels (default: 256x256,640x480)"
    )
    parser.add_argument("--frames", type=int, default=36, help="images of each case (default: 36)")
    parser.add_argument("--quick", action="store_true", help="12 images of each case, one scene")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write the first image of every renderer to DIR")
    add_report_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    from gibson_sim_bench.render import ABSENT, measure
    from gibson_sim_bench.reports.render import report_text

    report = measure(plan_of(args), progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    print("".join(f"\nNot measured: {name}: {why}." for name, why in ABSENT))
    write_json(args.json, {**report.as_json(), "kind": "peers", "absent": dict(ABSENT)})
    return 0


def plan_of(args: argparse.Namespace) -> Any:
    """Returns the ``RenderPlan`` of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    from gibson_sim_bench.render import RenderPlan
    from gibson_sim_bench.timing import FIVE

    scenes = tuple(args.house) or (SCAN_SCENES[:1] if args.quick else SCAN_SCENES)
    return RenderPlan(
        scenes=scenes,
        sizes=tuple(parse_size(text) for text in args.sizes.split(",") if text),
        outputs=(("rgb",), ("rgb", "depth"), FIVE),
        frames=12 if args.quick else max(1, args.frames),
        peers=True,
        peer_pythons=tuple(args.peer_python) or ("",),
        images=args.pictures,
    )
