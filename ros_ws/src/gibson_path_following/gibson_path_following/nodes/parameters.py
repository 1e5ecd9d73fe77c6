"""Declares the parameters of a node from the fields of its options, with their descriptions and limits."""

from __future__ import annotations

from dataclasses import Field, fields
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from gibson_path_following.options import Options, unknown_name

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Begins of the names of parameters that rclpy declares itself, some of them later."""
_Options = TypeVar("_Options", bound=Options)


def declared(node: Any, kind: type[_Options]) -> _Options:
    """Declares a parameter for every field of ``kind`` and returns their values; warns of values that were given for other names.

    Raises:
        SettingError: a value is not allowed.
    """
    names = {one.name for one in fields(kind)}
    for name in node._parameter_overrides:
        if name not in names and not node.has_parameter(name) and not name.startswith(_OF_ROS):
            node.get_logger().warning(unknown_name(name, kind))
    values = {}
    for one in fields(kind):
        default: Any = list(one.default) if isinstance(one.default, tuple) else one.default
        # Any value is accepted here, so that the options reject a wrong one with their own message.
        values[one.name] = node.declare_parameter(one.name, default, ParameterDescriptor(dynamic_typing=True)).value
    options = kind(**values)
    for one in fields(kind):
        node.set_descriptor(one.name, _descriptor(one))
    return options


def _descriptor(one: Field[Any]) -> Any:
    descriptor = ParameterDescriptor(description=one.metadata["text"], read_only=True, dynamic_typing=True)
    least, most = one.metadata["least"], one.metadata["most"]
    if least is not None and isinstance(one.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(least), to_value=float(most))]
    elif least is not None:
        descriptor.integer_range = [IntegerRange(from_value=int(least), to_value=int(most))]
    return descriptor
