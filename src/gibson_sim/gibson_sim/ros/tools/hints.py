"""Checks names that a user typed on the command line, and suggests similar ones. Pure: imports no ROS."""

from __future__ import annotations

import difflib
import re
from collections.abc import Container, Iterable, Mapping

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

_SIMILAR = 0.66
"""Minimum similarity of a suggested name, by difflib: ``/cmd`` suggests ``/cmd_vel``; ``/nothing`` does not suggest ``/diagnostics``."""
_STANDARD, _STATE = "simulation_interfaces/srv/", "simulation_interfaces/srv/GetSimulationState"
_PARAMETER_SERVICES = ("get_parameters", "set_parameters", "describe_parameters", "list_parameters")
"""Services that a node with parameters offers, below the name of the node."""
PHYSICS, RENDER = "physics", "render"
"""Names of the nodes of a simulation, without namespace."""


_NAME = re.compile(r"(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*", re.ASCII)


def check_name(kind: str, name: str) -> None:
    """Checks the name of a topic, a service, an action or a node; ``kind`` is for the message.

    Raises:
        ConfigError: the name is not valid in ROS.
    """
    if not name:
        raise ConfigError(f"the name of the {kind} is empty")
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{kind} {quoted(name)} is not a ROS name: letters, digits and _ between single slashes, no digit first, such as /robot_1/odom"
        )


def simulation_runs(services: Mapping[str, Iterable[str]]) -> bool:
    """Returns whether a simulation offers any of the services, given as service -> types."""
    return any(_STATE in types for types in services.values())


def loading_nodes(awaited: Container[str], present: Iterable[str], loaded: Container[str]) -> list[str]:
    """Returns the full names of the nodes of a simulation that load its scene, sorted.

    Args:
        awaited: names of nodes of a simulation, without namespaces.
        present: full names of all nodes.
        loaded: full names of the nodes that publish their settings: a node of a simulation does once its other topics exist.
    """
    return sorted(node for node in present if node.rpartition("/")[2] in awaited and node not in loaded)


def no_simulation(domain: int, start: str) -> str:
    """Returns the message that no simulation runs; ``start`` is the hint how to start one."""
    return f"no simulation runs in ROS domain {domain}; start one with {start}"


def suggestion(name: str, known: Iterable[str], otherwise: str) -> str:
    """Returns ``did you mean 'x'?`` with the most similar other name; the same name with or without a slash does not count as another.

    Args:
        name: name that does not exist.
        known: names that exist.
        otherwise: result if no name is similar.
    """
    stripped = name.strip("/")
    others = sorted(other for other in known if other.strip("/") != stripped)
    same_end = [other for other in others if other.endswith(f"/{stripped}")]
    matches = same_end or difflib.get_close_matches(name, others, n=1, cutoff=_SIMILAR)
    return f"did you mean {quoted(matches[0])}?" if matches else otherwise


def missing_service(
    name: str, kind: str, services: Mapping[str, Iterable[str]], nodes: Container[str] = (), *, domain: int, start: str
) -> str:
    """Returns the reason why a service cannot be called, in one line.

    Args:
        name: full name of the service.
        kind: type of the service, such as ``simulation_interfaces/srv/SpawnEntity``; empty = unknown.
        services: service -> types of the services that nodes offer.
        nodes: full names of the discovered nodes.
        domain: ROS domain ID.
        start: hint how to start a simulation.
    """
    node, _, last = name.rpartition("/")
    is_of_parameters = last in _PARAMETER_SERVICES and kind.startswith("rcl_interfaces/")
    if is_of_parameters and node in nodes:
        return f"node {quoted(node)} offers no parameters; `gibson-sim param list` shows those of all nodes"
    runs = simulation_runs(services)
    if not runs and (kind.startswith(_STANDARD) or not services):
        return no_simulation(domain, start)
    if is_of_parameters:
        known = [other.removesuffix(f"/{last}") for other in services if other.endswith(f"/{last}")]
        return missing_node(node, known, f"known: {', '.join(sorted(known))}" if runs else no_simulation(domain, start))
    otherwise = "see `gibson-sim service list`" if runs else no_simulation(domain, start)
    return f"no node offers the service {quoted(name)}; {suggestion(name, services, otherwise)}"


def missing_node(node: str, nodes: Iterable[str], otherwise: str) -> str:
    """Returns the message that a node does not exist; see ``suggestion``."""
    return f"node {quoted(node)} does not exist; {suggestion(node, nodes, otherwise)}"


def type_and_values(type: str, values: str) -> tuple[str, str]:
    """Returns the type and the values of a service call whose type may be omitted: values begin with a brace, types do not."""
    return ("", type) if type.startswith("{") and not values else (type, values)


def spawned_as(resource: str, default_name: str, entities: Iterable[str]) -> str:
    """Returns a hint to the entities that the user probably meant by the name of a resource; empty = there are none.

    Args:
        resource: name of a model in the catalogue, such as ``bottle_water``.
        default_name: default name of its entities, ``bottle``; further ones are ``bottle_2``, ``bottle_3``. Empty = none.
        entities: names of all entities.
    """
    matches = [name for name in entities if default_name and re.fullmatch(rf"{re.escape(default_name)}(_\d+)?", name)]
    if not matches:
        return ""
    return f"there is no entity {quoted(resource)}; {quoted(resource)} is spawned as {quoted(default_name)}: did you mean {' or '.join(matches)}?"
