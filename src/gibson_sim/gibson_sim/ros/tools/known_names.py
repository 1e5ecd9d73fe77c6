"""Lists the names of a ROS domain for shell completion: topics, services, actions, nodes, parameters and entities."""

from __future__ import annotations

import json
import time

from rcl_interfaces.srv import ListParameters
from rclpy.action.graph import get_action_names_and_types
from simulation_interfaces.srv import GetEntities

from gibson_sim.ros.tools.tool import USUAL_DISCOVERY_S, Tool
from gibson_sim.ros.topics.names import is_hidden

_STEADY_S = 0.3
"""Time without a new topic or service after which discovery counts as complete, s of wall time."""
_ANSWER_S = 2.0
"""Timeout for the responses of all services, s of wall time; late ones are omitted."""
_LIST, _ENTITIES = "/list_parameters", "/get_entities"


def known_names(tool: Tool) -> str:
    """Returns a JSON object, kind -> names in alphabetical order; ``parameters`` is node -> names."""
    _discover(tool)
    services = tool.known_services()
    nodes = sorted(name.removesuffix(_LIST) for name in services if name.endswith(_LIST))
    parameters = {node: tool.create_client(ListParameters, node + _LIST).call_async(ListParameters.Request()) for node in nodes}
    entities = [
        tool.create_client(GetEntities, name).call_async(GetEntities.Request()) for name in services if name.endswith(_ENTITIES)
    ]
    tool.spin_until(_ANSWER_S, lambda: all(future.done() for future in (*parameters.values(), *entities)))
    names = {
        "topics": sorted(name for name in tool.known_topics() if not is_hidden(name)),
        "services": sorted(name for name in services if not is_hidden(name)),
        "actions": sorted(name for name, _ in get_action_names_and_types(tool)),
        "nodes": nodes,
        "entities": sorted(name for future in entities if future.done() for name in future.result().entities),
        "parameters": {node: sorted(future.result().result.names) for node, future in parameters.items() if future.done()},
    }
    return json.dumps(names)


def _discover(tool: Tool) -> None:
    """Spins until the graph contains other nodes and has not changed for ``_STEADY_S``."""
    known: set[str] = set(tool.known_topics()) | set(tool.known_services())
    initial_count = len(known)
    changed = time.monotonic()

    def is_steady() -> bool:
        nonlocal known, changed
        present = set(tool.known_topics()) | set(tool.known_services())
        if present != known:
            known, changed = present, time.monotonic()
        return len(known) > initial_count and time.monotonic() - changed > _STEADY_S

    tool.spin_until(USUAL_DISCOVERY_S, is_steady)
