"""``gibson-sim top``: what a running simulation does, live in the terminal."""

from __future__ import annotations

import argparse
import json
from typing import Any

from gibson_sim.cli.environment import add_network, domain_of, environment_of, require_nodes
from gibson_sim.cli.processes import become

PATIENCE_S, PERIOD_S = 5.0, 1.0


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "top",
        help="show what a running simulation does: real-time factor, and what each node says of itself",
        description="Shows /diagnostics of all nodes, once a second. Exits with 3 where no simulation runs in this ROS domain.",
    )
    parser.add_argument("--once", action="store_true", help="print one table and end")
    parser.add_argument(
        "--topics",
        action="store_true",
        help="also the rate of every topic; subscribes to all of them, images too, which costs time",
    )
    add_network(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replaces this process by the node, which so gets the terminal, its signals and its exit code."""
    require_nodes()
    environment = environment_of(args)
    domain_of(environment)
    options = {"once": args.once, "topics": args.topics, "patience_s": PATIENCE_S, "period_s": PERIOD_S}
    become("top_node", [json.dumps(options)], environment)
