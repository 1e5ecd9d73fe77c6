"""``gibson-sim service``: list, type, call."""

from __future__ import annotations

from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.arguments import interface_class, parse_values
from gibson_sim.ros.tools.hints import PHYSICS, type_and_values
from gibson_sim.ros.tools.listing import print_names, with_types, without_hidden
from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import PATIENCE_S, Tool
from gibson_sim.ros.tools.yaml_messages import fill, yaml_text


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
    awaited = f"the service {quoted(name)}"
    if not type:
        if not tool.wait_for(awaited, lambda: name in tool.offered_services()):
            raise tool.missing_service(name)
        type, awaited = tool.known_services()[name][0], ""
    kind = interface_class(type)
    request = fill(kind.Request(), parsed)
    client = tool.create_client(kind, name)
    if not tool.wait_for(awaited, client.service_is_ready):
        raise tool.missing_service(name, type)
    print_line(f"requester: making request: {request}\n")
    response = tool.response(client, request)
    print_line("response:\n" + yaml_text(response, whole=True))
    result = getattr(response, "result", None)
    return 1 if getattr(response, "success", True) is False or getattr(result, "result", 1) not in (1, True) else 0
