"""``gibson-sim mcp``: serves a coding agent by the Model Context Protocol."""

from __future__ import annotations

import argparse
import os
import sys
from importlib.util import find_spec
from typing import Any

from gibson_sim.cli.environment import require_nodes
from gibson_sim.errors import EnvironmentProblemError

_DOMAINS = "1-101"
"""Those whose ports lie below the kernel's ephemeral ports."""


def add_parser(subparsers: Any) -> None:
    """Adds the sub-command."""
    parser = subparsers.add_parser(
        "mcp",
        help="serve a coding agent: simulations as tools of the Model Context Protocol",
        description="Speaks the Model Context Protocol on stdin and stdout; an agent starts it, see docs/agents.md. Nothing is reachable from "
        "other machines. Needs the package mcp: pip install 'gibson_sim[mcp]'",
    )
    parser.add_argument(
        "--folder",
        action="append",
        default=[],
        metavar="DIR",
        help="folder whose files the agent may use and in which it may record; may be given several times (default: none, only what is built in)",
    )
    parser.add_argument(
        "--domains", default=_DOMAINS, metavar="FIRST-LAST", help=f"ROS domains of which a free one is used (default: {_DOMAINS})"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replaces this process by the server.

    Raises:
        EnvironmentProblemError: a package is not installed.
    """
    from gibson_sim.cli.processes import replace_process

    if find_spec("mcp") is None:
        raise EnvironmentProblemError(
            "`gibson-sim mcp` needs the Python package mcp, which is not installed: `pip install 'gibson_sim[mcp]'`"
        )
    require_nodes()
    replace_process([sys.executable, "-m", "gibson_sim.agents", args.domains, *args.folder], os.environ)
