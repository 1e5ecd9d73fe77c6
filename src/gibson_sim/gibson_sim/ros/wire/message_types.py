"""Classes of messages and services from the names of their types, and back."""

from __future__ import annotations

from importlib import import_module
from typing import Any

UNKNOWN = (ImportError, AttributeError, ValueError)
"""What ``message_class`` raises where a type is not installed here, or its name is none."""


def message_class(type_name: str) -> Any:
    """Returns the class of ``geometry_msgs/msg/Twist``, and the class of the request of ``simulation_interfaces/srv/SpawnEntity``.

    Raises:
        ImportError, AttributeError, ValueError: see ``UNKNOWN``.
    """
    package, kind, name = type_name.split("/")
    found = getattr(import_module(f"{package}.{kind}"), name)
    return found.Request if kind == "srv" else found


def type_name_of(cls: Any) -> str:
    """Returns ``sensor_msgs/msg/Image`` of a message class, ``simulation_interfaces/srv/SpawnEntity`` of that of a request."""
    package, _, rest = cls.__module__.partition(".")
    return f"{package}/{rest.partition('.')[0]}/{cls.__name__.removesuffix('_Request')}"
