"""``gibson-sim bench realism``: our pictures beside path-traced ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from gibson_sim.cli.report_file import print_progress, write_json
from gibson_sim.errors import ConfigError

_JSON, _PAGE = "realism.json", "index.html"


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "realism",
        help="compare our pictures with path-traced ones of the same poses (needs Blender: pip install 'gibson_sim_tools[authoring]')",
        description="Samples free poses at three heights with a robot and moved things in sight, draws them, traces them with Cycles from the "
        "plan, materials and lamps of the scene, and writes the differences by cause. Traced pictures are cached, so that an interrupted run "
        "continues, and a run after a change of the renderer takes seconds.",
    )
    parser.add_argument("scenes", nargs="+", metavar="SCENE", help="names, folders or files of scenes")
    parser.add_argument("--poses", type=int, default=12, metavar="N", help="poses of each scene (default: 12)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the poses (default: 0)")
    parser.add_argument("--width", type=int, default=320, metavar="PX", help="width of the pictures, 4:3, pixels (default: 320)")
    parser.add_argument("--samples", type=int, default=128, metavar="N", help="traced paths per pixel (default: 128)")
    parser.add_argument(
        "--antialiasing", type=int, choices=(1, 4), default=1, help="colour samples per pixel of our pictures (default: 1)"
    )
    parser.add_argument(
        "--blender-python", default=sys.executable, metavar="FILE", help="Python interpreter that has bpy (default: this one)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("realism"),
        metavar="DIR",
        help=f"folder for {_JSON} and {_PAGE} (default: realism)",
    )
    parser.add_argument("--worst", type=int, default=6, metavar="N", help="pairs of each scene on the page (default: 6)")
    parser.add_argument("--repeat-truth", action="store_true", help="trace pictures again that are cached")
    parser.add_argument("--markdown", action="store_true", help="print Markdown")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes JSON and page."""
    plan = plan_of(args)
    from gibson_sim_bench.realism.measure import measure
    from gibson_sim_bench.realism.page import report_text, write_page

    report = measure(plan, print_progress)
    write_json(args.output / _JSON, report.as_json())
    write_page(report, args.output / _PAGE, args.worst)
    print(report_text(report, markdown=args.markdown))
    print(f"\n{args.output / _PAGE}")
    return 0


def plan_of(args: argparse.Namespace) -> Any:
    """Returns the ``RealismPlan`` of the options.

    Raises:
        ConfigError: an option is invalid.
    """
    from gibson_sim_bench.realism.measure import RealismPlan

    if args.worst < 0:
        raise ConfigError(f"--worst is {args.worst}, must be 0 or more")
    return RealismPlan(
        tuple(args.scenes),
        args.poses,
        args.seed,
        args.width,
        args.samples,
        args.antialiasing,
        args.blender_python,
        args.repeat_truth,
    )
