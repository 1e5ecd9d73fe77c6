"""The program behind ``gibson-sim topic``, ``node``, ``service``, ``param`` and ``action``: one command, given as JSON, printed as by ``ros2``."""

from __future__ import annotations

import json
import sys

from gibson_sim import interrupts
from gibson_sim.ros.nodes.node_main import run_node
from gibson_sim.ros.tools.commands import execute
from gibson_sim.ros.tools.tool import Tool


def main() -> None:
    """Executes the command in the JSON on the command line: ``command``, and its arguments."""
    arguments = json.loads(sys.argv[1])
    command = arguments.pop("command")
    run_node(lambda: Tool(lambda tool: execute(tool, command, arguments)), [], interrupted=interrupts.INTERRUPTED)


if __name__ == "__main__":
    main()
