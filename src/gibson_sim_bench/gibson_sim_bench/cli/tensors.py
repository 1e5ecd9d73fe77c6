"""``gibson-sim bench tensors``: images per second as tensors, on a GPU or on this CPU."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from gibson_sim.cli.report_file import add_report_options, parse_device, require_device, write_json


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "tensors", help="images per second as tensors: the comparison of the paper, one view, and 64 views at once"
    )
    parser.add_argument("--triangles", type=int, default=1_000_000, help="triangles of the generated scene (default: 1000000)")
    parser.add_argument("--blocks", type=int, default=20, help="timed blocks of each case (default: 20)")
    parser.add_argument("--calls", type=int, default=50, help="calls in each block (default: 50)")
    parser.add_argument(
        "--device", help="EGL device: its number or UUID, as `gibson-sim doctor` lists them (default: a GPU if there is one)"
    )
    add_report_options(parser, markdown=False)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the report, and writes the JSON file if one is named."""
    from gibson_sim_bench.tensors import measure, table

    device = parse_device(args.device)
    require_device(device)
    report = measure(
        args.triangles,
        args.blocks,
        args.calls,
        device,
        progress=lambda c: print(f"{c.name}, {c.views} x {c.size}x{c.size}: {c.median:,.0f} images/s", file=sys.stderr),
    )
    print(table(report))
    write_json(args.json, report.as_json())
    return 0
