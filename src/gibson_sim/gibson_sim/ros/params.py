"""The bridge between ROS parameters and the frozen settings in ``gibson_sim.config``."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Protocol, TypeVar

from rcl_interfaces.msg import ParameterDescriptor

T = TypeVar("T")


class HasParameters(Protocol):
    """The one thing that is needed of a node."""

    def declare_parameter(self, name: str, value: Any, descriptor: ParameterDescriptor) -> Any:
        """Declares a parameter and returns it."""


def config_from_parameters(node: HasParameters, cls: type[T], *, changeable: tuple[str, ...] = ()) -> T:
    """Declares one parameter per field of ``cls``, read-only but for ``changeable``, and returns ``cls`` filled with the values.

    The type and the limits are checked by the dataclass, so that a wrong value fails with the same words from everywhere.

    Raises:
        ConfigError: a value has the wrong type or is not allowed.
    """
    values = {}
    for f in fields(cls):  # type: ignore[arg-type]
        limits = f"{f.metadata['minimum']:g} to {f.metadata['maximum']:g} {f.metadata['unit']}".strip()
        descriptor = ParameterDescriptor(
            name=f.name,
            description=f.metadata["doc"],
            additional_constraints=limits,
            read_only=f.name not in changeable,
            dynamic_typing=True,
        )
        values[f.name] = node.declare_parameter(f.name, f.default, descriptor).value
    return cls(**values)
