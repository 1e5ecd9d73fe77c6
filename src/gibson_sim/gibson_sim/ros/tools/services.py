"""``gibson-sim service``: list, type, call."""

from __future__ import annotations

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.arguments import interface_class, parse_values
from gibson_sim.ros.tools.hints import PHYSICS, type_and_values
from gibson_sim.ros.tools.output import print_line, print_names, with_types, without_hidden
from gibson_sim.ros.tools.tool import PATIENCE_S, Tool
from gibson_sim.ros.tools.yaml_messages import fill, yaml_text

_MATCHING_S = 0.2
"""Time for the service to discover the client, s of wall time: without it, on a busy machine, its response can be lost."""


def service_list(tool: Tool, types: bool = False, include_hidden_services: bool = False) -> None:
    """Prints the names of all services, one per line."""
    tool.discover(PHYSICS)
    services = tool.known_services() if include_hidden_services else without_hidden(tool.known_services())
    print_names(tool, with_types(services, types))


def service_type(tool: Tool, service: str) -> None:
    """Prints the type of a service."""
    name = tool.resolve_service_name(service)
    if not tool.spin_until(PATIENCE_S, lambda: name in tool.known_services()):
        raise tool.missing_service(name)
    print_line("\n".join(tool.known_services()[name]))


def service_call(tool: Tool, service: str, type: str = "", values: str = "") -> int:
    """Calls a service with YAML values; returns 1 if its response reports a failure."""
    name = tool.resolve_service_name(service)
    type, values = type_and_values(type, values)
    parsed = parse_values(values)
    if type:
        interface_class(type, "srv")
    if not tool.wait_for(f"the service {quoted(name)}", lambda: name in tool.offered_services()):
        raise tool.missing_service(name, type)
    # Checked before the client exists: the graph contains the types of clients, too.
    offered = tool.known_services()[name]
    if type and type not in offered:
        raise GibsonSimError(f"{name} has the type {', '.join(offered)}, not {type}")
    kind = interface_class(type or offered[0], "srv")
    request = fill(kind.Request(), parsed)
    tool.client.discover(name, kind)
    tool.spin_until(_MATCHING_S)
    print_line(f"requester: making request: {request}\n")
    response = tool.client.call(name, request)
    print_line("response:\n" + yaml_text(response, whole=True))
    result = getattr(response, "result", None)
    return 1 if getattr(response, "success", True) is False or getattr(result, "result", 1) not in (1, True) else 0
