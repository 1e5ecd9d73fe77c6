"""``gibson-sim env``: prints the environment variables for a user's own nodes, for `eval "$(gibson-sim env)"`."""

from __future__ import annotations

import argparse
import os
import shlex
from typing import Any

from gibson_sim.reach import PROFILE_VARIABLE, REACHES, SUBNET, profile_of, reach_variables


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("env", help='print shell lines that set up your own nodes: eval "$(gibson-sim env)"')
    parser.add_argument(
        "--reach",
        choices=REACHES,
        help="also set who reaches your nodes: processes of this machine only, or all machines of the network (default: as ROS does)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints one line per variable; returns 0."""
    if args.reach:
        variables = reach_variables(os.environ, args.reach)
    else:
        variables = {} if os.environ.get(PROFILE_VARIABLE) else {PROFILE_VARIABLE: str(profile_of(SUBNET))}
    for name, value in variables.items():
        print(f"export {name}={shlex.quote(value)}" if value else f"unset {name}")
    return 0
