"""The names of a ROS domain, for a shell that completes a command line: topics, services, actions, nodes, parameters and entities."""

from __future__ import annotations

import json
import time

from rcl_interfaces.srv import ListParameters
from rclpy.action.graph import get_action_names_and_types
from simulation_interfaces.srv import GetEntities

from gibson_sim.ros.tools.main import DISCOVERY_S, Tool

_STEADY_S = 0.3
"""Wall time without a new topic or service after which the graph counts as known, s."""
_ANSWER_S = 2.0
"""Wall time for all services to answer, s. What has not answered is left out."""
_LIST, _ENTITIES = "/list_parameters", "/get_entities"


def known_names(tool: Tool) -> str:
    """Returns a JSON object: kind -> names in alphabetical order; ``parameters``: node -> names."""
    _discover(tool)
    services = tool.known_services()
    nodes = sorted(name.removesuffix(_LIST) for name in services if name.endswith(_LIST))
    asked = {node: tool.create_client(ListParameters, node + _LIST).call_async(ListParameters.Request()) for node in nodes}
    listed = [
        tool.create_client(GetEntities, name).call_async(GetEntities.Request()) for name in services if name.endswith(_ENTITIES)
    ]
    tool.work(_ANSWER_S, lambda: all(future.done() for future in (*asked.values(), *listed)))
    found = {
        "topics": sorted(tool.known_topics()),
        "services": sorted(services),
        "actions": sorted(name for name, _ in get_action_names_and_types(tool)),
        "nodes": nodes,
        "entities": sorted(name for future in listed if future.done() for name in future.result().entities),
        "parameters": {node: sorted(future.result().result.names) for node, future in asked.items() if future.done()},
    }
    return json.dumps(found)


def _discover(tool: Tool) -> None:
    """Works until the graph, which is more than this node, does not grow any more."""
    known: set[str] = set(tool.known_topics()) | set(tool.known_services())
    own = len(known)
    changed = time.monotonic()

    def steady() -> bool:
        nonlocal known, changed
        now = set(tool.known_topics()) | set(tool.known_services())
        if now != known:
            known, changed = now, time.monotonic()
        return len(known) > own and time.monotonic() - changed > _STEADY_S

    tool.work(DISCOVERY_S, steady)
