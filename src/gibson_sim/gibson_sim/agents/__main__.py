"""The process of ``gibson-sim mcp``: ``python -m gibson_sim.agents DOMAINS [FOLDER ...]``."""

from __future__ import annotations

import logging
import sys

from gibson_sim import interrupts
from gibson_sim.agents.folders import Folders
from gibson_sim.agents.session import AgentSession
from gibson_sim.errors import GibsonSimError
from gibson_sim.testing.processes import free_domains


def main() -> int:
    """Serves until stdin ends; returns the exit code. SIGINT ends the process, and its nodes with it."""
    interrupts.end_silently()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    domains, *folders = sys.argv[1:]
    try:
        next(free_domains(domains, 0))  # checks the option
        session = AgentSession(Folders(folders), domains)
    except GibsonSimError as error:
        print(f"gibson-sim: error: {error}", file=sys.stderr)
        return 1
    if sys.stdin.isatty():
        print(
            "gibson-sim mcp is started by a coding agent and waits for its messages on stdin: see docs/agents.md", file=sys.stderr
        )
    from gibson_sim.agents.server import serve

    serve(session)
    return 0


if __name__ == "__main__":
    sys.exit(main())
