"""The program behind ``gibson-sim topic``, ``node``, ``service``, ``param`` and ``action``: one command, given as JSON, printed as by ``ros2``."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import Any

from gibson_sim import interrupts
from gibson_sim.ros.nodes.node_main import run_node
from gibson_sim.ros.tools import actions, nodes, params, services, topics
from gibson_sim.ros.tools.hints import check_name
from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import Tool

COMMANDS: dict[str, Callable[..., int | None]] = {
    "topic list": topics.topic_list, "topic type": topics.topic_type, "topic info": topics.topic_info,
    "topic echo": topics.topic_echo, "topic hz": topics.topic_hz,
    "topic bw": topics.topic_bw, "topic delay": topics.topic_delay, "node list": nodes.node_list, "node info": nodes.node_info,
    "service list": services.service_list, "service type": services.service_type, "service call": services.service_call,
    "param list": params.param_list, "param get": params.param_get, "param set": params.param_set, "action list": actions.action_list,
    "action send_goal": actions.action_send_goal,
}  # fmt: skip
"""Name of a command as with ``ros2`` -> function."""


def execute(tool: Tool, command: str, arguments: Mapping[str, Any]) -> int:
    """Executes a command, such as "topic echo", and returns the exit code.

    Raises:
        GibsonSimError: an argument is not valid, or the command fails.
    """
    if command == "names":
        from gibson_sim.ros.tools.known_names import known_names

        print_line(known_names(tool))
        return 0
    if command not in COMMANDS:
        from gibson_sim.ros.tools.verbs import VERBS  # imported only here: it takes half a second

        print_line(VERBS[command](tool, **arguments))
        return 0
    for kind in ("topic", "service", "action", "node"):
        if (name := arguments.get(kind)) is not None:
            check_name(kind, name)
    return int(COMMANDS[command](tool, **arguments) or 0)


def main() -> None:
    """Executes the command in the JSON on the command line: ``command``, and its arguments."""
    arguments = json.loads(sys.argv[1])
    command = arguments.pop("command")
    run_node(lambda: Tool(lambda tool: execute(tool, command, arguments)), [], interrupted=interrupts.INTERRUPTED)


if __name__ == "__main__":
    main()
