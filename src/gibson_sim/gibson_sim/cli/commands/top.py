"""``gibson-sim top``: shows the state of a running simulation live in the terminal."""

from __future__ import annotations

import argparse
import json
from typing import Any

from gibson_sim.cli.environment import add_network, domain_of, environment_of, require_nodes
from gibson_sim.cli.processes import become

PATIENCE_S, PERIOD_S = 5.0, 1.0
"""Timeout for a simulation, and interval between two updates, seconds."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "top",
        help="show the state of a running simulation: real-time factor, and the diagnostics of each node",
        description="Shows /diagnostics of all nodes, once a second. Exits with 3 if no simulation runs in this ROS domain.",
    )
    parser.add_argument("--once", action="store_true", help="print one table and exit")
    parser.add_argument(
        "--topics",
        action="store_true",
        help="also show the rate of every topic; subscribes to all of them, including images, which costs time",
    )
    add_network(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replaces this process by the node, so that it owns the terminal, the signals and the exit code."""
    require_nodes()
    environment = environment_of(args)
    domain_of(environment)
    options = {"once": args.once, "topics": args.topics, "patience_s": PATIENCE_S, "period_s": PERIOD_S}
    become("top_node", [json.dumps(options)], environment)
