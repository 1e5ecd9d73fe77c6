"""Finds the class of a message or service type by its name, and the name of a class."""

from __future__ import annotations

from importlib import import_module
from typing import Any

UNKNOWN = (ImportError, AttributeError, ValueError)
"""Exceptions of ``message_class`` if a type is not installed, or its name is invalid."""


def message_class(type_name: str) -> Any:
    """Returns the class of a message type such as ``geometry_msgs/msg/Twist``; for a service type, the class of its request.

    Raises:
        ImportError, AttributeError, ValueError: see ``UNKNOWN``.
    """
    package, kind, name = type_name.split("/")
    cls = getattr(import_module(f"{package}.{kind}"), name)
    return cls.Request if kind == "srv" else cls


def service_class(type_name: str) -> Any:
    """Returns the class of a service type such as ``std_srvs/srv/Trigger``.

    Raises:
        ImportError, AttributeError, ValueError: see ``UNKNOWN``.
    """
    package, kind, name = type_name.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)


def type_name_of(cls: Any) -> str:
    """Returns the type name of a message class, such as ``sensor_msgs/msg/Image``; for a request class, the name of the service type."""
    package, _, rest = cls.__module__.partition(".")
    return f"{package}/{rest.partition('.')[0]}/{cls.__name__.removesuffix('_Request')}"
