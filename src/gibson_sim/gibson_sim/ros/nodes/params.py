"""Declares the settings of ``gibson_sim.config`` as ROS parameters, and reads them."""

from __future__ import annotations

import math
from dataclasses import Field
from typing import Any, Protocol, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from gibson_sim.settings import Settings, limits_of, make_settings, setting_fields

T = TypeVar("T", bound=Settings)


class HasParameters(Protocol):
    """The methods of a node that this module uses."""

    def declare_parameter(self, name: str, value: Any, descriptor: ParameterDescriptor) -> Any:
        """Declares a parameter and returns it."""

    def set_descriptor(self, name: str, descriptor: ParameterDescriptor) -> Any:
        """Replaces the descriptor of a declared parameter."""


def config_from_parameters(node: HasParameters, cls: type[T], *, changeable: tuple[str, ...] = ()) -> T:
    """Declares one parameter per field of ``cls``, read-only except ``changeable``, and returns ``cls`` with the values.

    The dataclass checks types and limits, so that the error message of an invalid value is the same for all interfaces. The limits are
    declared afterwards; otherwise rclpy would refuse the value first, with its own message.

    Raises:
        ConfigError: a value has the wrong type or is not allowed.
    """
    settings = setting_fields(cls)
    unlimited = {f.name: ParameterDescriptor(dynamic_typing=True) for f in settings}
    config = make_settings(cls, {f.name: node.declare_parameter(f.name, f.default, unlimited[f.name]).value for f in settings})
    for f in settings:
        node.set_descriptor(f.name, descriptor_of(f, changeable=f.name in changeable))
    return config


def descriptor_of(f: Field[Any], *, changeable: bool) -> ParameterDescriptor:
    """Returns the parameter descriptor of a setting: its description, its limits as text, and as a range if both are finite.

    Args:
        f: field created by ``setting``.
        changeable: whether the parameter may be set while the node runs.
    """
    constraints = [f"one of {', '.join(f.metadata['choices'])}" if f.metadata["choices"] else limits_of(f)]
    constraints += [] if changeable else ["read when the node starts: restart it to change this"]
    descriptor = ParameterDescriptor(
        description=f.metadata["doc"],
        additional_constraints="; ".join(filter(None, constraints)),
        read_only=not changeable,
        dynamic_typing=True,  # a float may be given as an integer, as in `ros2 param set /physics rate 2`
    )
    low, high = f.metadata["minimum"], f.metadata["maximum"]
    # A range has two ends: with the largest number as the upper one, GUIs would show a useless slider.
    if math.isfinite(low) and math.isfinite(high):
        if type(f.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        elif type(f.default) is float:
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    return descriptor
