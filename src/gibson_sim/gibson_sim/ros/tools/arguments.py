"""Types, values and node names on the command line."""

from __future__ import annotations

from typing import Any

from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml
from gibson_sim.ros.wire.message_types import UNKNOWN, service_class


def interface_class(name: str) -> Any:
    """Returns the class of a service or action type, such as ``std_srvs/srv/Trigger``.

    Raises:
        GibsonSimError: the type is not installed.
    """
    try:
        return service_class(name)
    except UNKNOWN as error:
        raise GibsonSimError(f"the type {quoted(name)} is not installed in this environment") from error


def parse_values(text: str) -> Any:
    """Returns the values in a YAML text; None = the text is empty.

    Raises:
        GibsonSimError: the text is not YAML.
    """
    try:
        return parse_yaml(text) if text else None
    except TextError as error:
        raise GibsonSimError(f"{quoted(text)} is not YAML: {error}") from error


def full_node_name(node: str) -> str:
    """Returns the full name of a node, whose first slash may be omitted."""
    return node if node.startswith("/") else f"/{node}"
