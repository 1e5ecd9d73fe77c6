"""``gibson-sim bench report``: writes the benchmark page from JSON files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "report",
        help="write a page with tables and plots of the JSON files in a folder",
        description="Writes docs/benchmarks.md and its plots from files written by `gibson-sim bench ... --json`.",
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("docs/benchmarks"),
        metavar="DIR",
        help="folder of the JSON files (default: docs/benchmarks)",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("docs/benchmarks.md"), metavar="FILE.md", help="default: docs/benchmarks.md"
    )
    parser.add_argument(
        "--images", type=Path, default=Path("docs/images"), metavar="DIR", help="folder of the plots (default: docs/images)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Writes the page, and prints which files it contains."""
    from gibson_sim_bench.reports.page import write_page

    for line in write_page(args.data, args.output, args.images):
        print(line)
    return 0
