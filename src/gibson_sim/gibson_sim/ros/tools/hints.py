"""What the tools of the command line make of names that a user typed. Pure text: it knows no node, and imports no ROS."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

_SIMILAR = 0.66
"""Least similarity of a name that is suggested, as of difflib: ``/cmd`` suggests ``/cmd_vel``; ``/nothing`` does not suggest ``/diagnostics``."""
_STANDARD, _STATE = "simulation_interfaces/srv/", "simulation_interfaces/srv/GetSimulationState"
_OF_NODES = ("get_parameters", "set_parameters", "describe_parameters", "list_parameters")
"""Services that a node with parameters offers below its name."""


_NAME = re.compile(r"(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*", re.ASCII)


def check_name(what: str, name: str) -> None:
    """Checks the name of a topic, a service, an action or a node.

    Raises:
        ConfigError: ROS has no such names.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"{what} {quoted(name)} is no name in ROS: letters, digits and _ between single slashes, no digit first, such as /robot_1/odom"
        )


def simulation_runs(services: Mapping[str, Iterable[str]]) -> bool:
    """Returns whether a simulation is among who offers services (service -> types)."""
    return any(_STATE in types for types in services.values())


def no_simulation(domain: int, start: str) -> str:
    """Returns that no simulation runs; ``start``: how to start one."""
    return f"no simulation runs in ROS domain {domain}; start one with {start}"


def suggestion(name: str, known: Iterable[str], otherwise: str) -> str:
    """Returns ``did you mean 'x'?`` with the nearest other name; the same name, with or without a slash, is none.

    Args:
        name: that was not found.
        known: names that exist.
        otherwise: what to say if none is near.
    """
    wanted = name.strip("/")
    others = sorted(other for other in known if other.strip("/") != wanted)
    same_end = [other for other in others if other.endswith(f"/{wanted}")]
    found = same_end or difflib.get_close_matches(name, others, n=1, cutoff=_SIMILAR)
    return f"did you mean {quoted(found[0])}?" if found else otherwise


def missing_service(name: str, kind: str, services: Mapping[str, Iterable[str]], *, domain: int, start: str) -> str:
    """Returns why a service cannot be called, in one line.

    Args:
        name: full name of the service.
        kind: its type, such as ``simulation_interfaces/srv/SpawnEntity``; "" = not known.
        services: service -> types, of those that a node offers.
        domain: ROS domain.
        start: how to start a simulation.
    """
    runs = simulation_runs(services)
    if not runs and (kind.startswith(_STANDARD) or not services):
        return no_simulation(domain, start)
    node, _, last = name.rpartition("/")
    if last in _OF_NODES and kind.startswith("rcl_interfaces/"):
        nodes = [other.removesuffix(f"/{last}") for other in services if other.endswith(f"/{last}")]
        listed = f"known: {', '.join(sorted(nodes)) or 'none'}"
        return f"there is no node {quoted(node)}; {suggestion(node, nodes, listed)}"
    otherwise = "see `gibson-sim service list`" if runs else no_simulation(domain, start)
    return f"nothing offers the service {quoted(name)}; {suggestion(name, services, otherwise)}"


def type_and_values(type: str, values: str) -> tuple[str, str]:
    """Returns the type and the values of a service call, of which the type may be left out: values begin with a brace, and a type never does."""
    return ("", type) if type.startswith("{") and not values else (type, values)


def spawned_as(resource: str, own_name: str, entities: Iterable[str]) -> str:
    """Returns which entities were probably meant by the name of a resource; "" = none.

    Args:
        resource: name of a thing of the catalogue, such as ``bottle_water``.
        own_name: the name that it gives its entities, ``bottle``; the next ones are ``bottle_2``, ``bottle_3``. "" = none.
        entities: names of all entities.
    """
    found = [name for name in entities if own_name and re.fullmatch(rf"{re.escape(own_name)}(_\d+)?", name)]
    if not found:
        return ""
    return f"there is no entity {quoted(resource)}; {quoted(resource)} is spawned as {quoted(own_name)}: did you mean {' or '.join(found)}?"
