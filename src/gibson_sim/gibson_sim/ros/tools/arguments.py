"""Types, values and node names on the command line."""

from __future__ import annotations

import difflib
import pkgutil
from importlib import import_module
from pathlib import Path
from typing import Any

from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml

_KINDS = {"msg": "a message", "srv": "a service", "action": "an action"}
"""Second part of the name of a type -> what it is a type of."""
_NEEDED = {
    "srv": "a service type such as simulation_interfaces/srv/GetEntities",
    "action": "an action type such as simulation_interfaces/action/SimulateSteps",
}


def interface_class(name: str, kind: str) -> Any:
    """Returns the class of a service or action type, such as ``std_srvs/srv/Trigger``.

    Args:
        name: name of the type.
        kind: its second part, ``srv`` or ``action``. A class of another kind would crash rclpy.

    Raises:
        GibsonSimError: the type is of another kind, or is not installed.
    """
    parts = name.split("/")
    if len(parts) != 3 or parts[1] not in _KINDS or not (parts[0].isidentifier() and parts[2].isidentifier()):
        raise GibsonSimError(f"type {quoted(name)} does not have the form package/{kind}/Name; {_NEEDED[kind]} is needed")
    package, found, last = parts
    if found != kind:
        raise GibsonSimError(f"type {quoted(name)} is {_KINDS[found]}; {_NEEDED[kind]} is needed")
    try:
        module = import_module(f"{package}.{kind}")
    except ImportError as error:
        similar = [f"{other}/{kind}/{last}" for other in _similar_packages(package, kind)]
        raise _missing_type(name, similar) from error
    known = [other for other, value in vars(module).items() if isinstance(value, type)]
    if last not in known:
        raise _missing_type(name, [f"{package}/{kind}/{other}" for other in difflib.get_close_matches(last, known)])
    return getattr(module, last)


def _similar_packages(package: str, kind: str) -> list[str]:
    """Returns installed packages with types of a kind and similar names, the most similar first."""
    installed = [
        module.name
        for module in pkgutil.iter_modules()
        if Path(getattr(module.module_finder, "path", ""), module.name, kind).is_dir()
    ]
    return difflib.get_close_matches(package, installed, cutoff=0.8)


def _missing_type(name: str, similar: list[str]) -> GibsonSimError:
    hint = f"; did you mean {quoted(similar[0])}?" if similar else ""
    return GibsonSimError(f"type {quoted(name)} is not installed in this environment{hint}")


def parse_values(text: str) -> Any:
    """Returns the values in a YAML text; None = the text is empty.

    Raises:
        GibsonSimError: the text is not YAML.
    """
    try:
        return parse_yaml(text) if text else None
    except TextError as error:
        raise GibsonSimError(f"{quoted(text)}: {error}") from error
