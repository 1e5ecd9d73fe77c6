"""``gibson-sim bench compare``: compares two reports."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "compare",
        help="compare two JSON files of one measurement: ratios and regressions",
        description="For information: the exit code is always 0.",
    )
    parser.add_argument("before", type=Path, metavar="A.json")
    parser.add_argument("after", type=Path, metavar="B.json")
    parser.add_argument(
        "--tolerance", type=float, default=0.15, metavar="X", help="fraction up to which a change is ignored (default: 0.15)"
    )
    parser.add_argument("--markdown", action="store_true", help="print Markdown")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the comparison."""
    from gibson_sim_bench.reports.compare import compare_text, read_report

    if not 0.0 <= args.tolerance < 1.0:
        raise ConfigError(f"--tolerance is {args.tolerance}, must be 0 or more and below 1")
    print(compare_text(read_report(args.before), read_report(args.after), args.tolerance, markdown=args.markdown))
    return 0
