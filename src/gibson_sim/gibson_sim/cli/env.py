"""``gibson-sim env``: the variables that a user's own node should have, for `eval "$(gibson-sim env)"`."""

from __future__ import annotations

import argparse
import os
import shlex
from typing import Any

from gibson_sim.cli.environment import ros_variables


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser("env", help='print shell lines that set up your own nodes: eval "$(gibson-sim env)"')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints one export a line; returns 0."""
    for name, value in ros_variables(os.environ).items():
        print(f"export {name}={shlex.quote(value)}")
    return 0
