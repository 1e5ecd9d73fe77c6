"""``gibson-sim bench scaling``: time and memory by problem size."""

from __future__ import annotations

import argparse
from typing import Any

from gibson_sim.cli.quiet import quiet
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "scaling",
        help="time and memory against triangles, resolution, cameras, bodies, robots, environments and processes",
        description="Every case runs in its own process. `gibson-sim bench report` draws the plots. Nothing else should run on the machine.",
    )
    parser.add_argument("--quick", action="store_true", help="two small cases of each")
    parser.add_argument("--only", default="", metavar="A,B", help="some of these quantities (default: all)")
    add_report_options(parser)
    parser.set_defaults(run=run)


@quiet()
def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    from gibson_sim_bench.scaling import kinds_of, measure, report_text

    report = measure(kinds_of(args.only), quick=args.quick, progress=print_progress)
    print(report_text(report, markdown=args.markdown))
    write_json(args.json, report.as_json())
    return 0
