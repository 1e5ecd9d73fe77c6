"""``gibson-sim node``: list, info."""

from __future__ import annotations

from rclpy.action.graph import get_action_client_names_and_types_by_node, get_action_server_names_and_types_by_node

from gibson_sim.config import absolute_name
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.tools.hints import PHYSICS, RENDER, missing_node
from gibson_sim.ros.tools.output import print_line, print_names
from gibson_sim.ros.tools.tool import PATIENCE_S, Tool
from gibson_sim.ros.topics.names import is_hidden


def node_list(tool: Tool) -> None:
    """Prints the full names of all nodes, one per line."""
    tool.discover(PHYSICS)
    print_names(tool, tool.known_nodes())


def node_info(tool: Tool, node: str, include_hidden: bool = False) -> None:
    """Prints the topics, services and actions of a node, with their types."""
    full_name = absolute_name(node)
    if not tool.spin_until(PATIENCE_S, lambda: full_name in tool.known_nodes()):
        raise GibsonSimError(missing_node(full_name, tool.known_nodes(), tool.hint("node list")))
    tool.discover(PHYSICS, RENDER)
    namespace, _, name = full_name.rpartition("/")
    print_line(full_name)
    for label, listed in (
        ("Subscribers", tool.get_subscriber_names_and_types_by_node(name, namespace or "/")),
        ("Publishers", tool.get_publisher_names_and_types_by_node(name, namespace or "/")),
        ("Service Servers", tool.get_service_names_and_types_by_node(name, namespace or "/")),
        ("Service Clients", tool.get_client_names_and_types_by_node(name, namespace or "/")),
        ("Action Servers", get_action_server_names_and_types_by_node(tool, name, namespace or "/")),
        ("Action Clients", get_action_client_names_and_types_by_node(tool, name, namespace or "/")),
    ):
        print_line(f"  {label}:")
        for entry, kinds in sorted(listed):
            if include_hidden or not is_hidden(entry):
                print_line(f"    {entry}: {', '.join(kinds)}")
