"""``gibson-sim param``: list, get, set."""

from __future__ import annotations

from typing import Any, NamedTuple

from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters

from gibson_sim.config import absolute_name
from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.arguments import parse_values
from gibson_sim.ros.tools.hints import PHYSICS, RENDER
from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import LIST_PARAMETERS, Tool
from gibson_sim.ros.tools.yaml_messages import MessageValueError, fill
from gibson_sim.settings import nearest


class _Type(NamedTuple):
    """A type of parameters."""

    label: str
    """As ``ros2 param get`` prints it."""
    field: str
    """Field of ``ParameterValue``."""
    allowed: str
    """Which values it has."""


_TYPES = {
    ParameterType.PARAMETER_BOOL: _Type("Boolean", "bool_value", "boolean: true or false"),
    ParameterType.PARAMETER_INTEGER: _Type("Integer", "integer_value", "integer: a whole number of at most 64 bits"),
    ParameterType.PARAMETER_DOUBLE: _Type("Double", "double_value", "double: a number, such as 1.5"),
    ParameterType.PARAMETER_STRING: _Type("String", "string_value", "string: a text"),
    ParameterType.PARAMETER_BYTE_ARRAY: _Type("Byte", "byte_array_value", "byte array: a list of 0 to 255, such as [1, 2]"),
    ParameterType.PARAMETER_BOOL_ARRAY: _Type("Boolean", "bool_array_value", "boolean array: a list, such as [true, false]"),
    ParameterType.PARAMETER_INTEGER_ARRAY: _Type("Integer", "integer_array_value", "integer array: a list, such as [1, 2]"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: _Type("Double", "double_array_value", "double array: a list, such as [1.0, 2.5]"),
    ParameterType.PARAMETER_STRING_ARRAY: _Type("String", "string_array_value", "string array: a list, such as ['a', 'b']"),
}
_GUESSES = (
    (bool, ParameterType.PARAMETER_BOOL, ParameterType.PARAMETER_BOOL_ARRAY),
    (int, ParameterType.PARAMETER_INTEGER, ParameterType.PARAMETER_INTEGER_ARRAY),
    (int | float, ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_DOUBLE_ARRAY),
    (str, ParameterType.PARAMETER_STRING, ParameterType.PARAMETER_STRING_ARRAY),
)
"""Type of a YAML value or of all elements of a list -> types of a parameter and of an array, in the order of ``ros2``."""


def param_list(tool: Tool, node: str | None = None) -> None:
    """Prints the parameters of a node, or of all nodes."""
    if node is not None:
        node_names = [absolute_name(node)]
    else:
        tool.discover(PHYSICS, RENDER)  # a node that loads the scene does not respond
        node_names = tool.nodes_with_parameters()
        if not node_names and not tool.simulation_runs():
            raise tool.missing_simulation()
    for node_name in node_names:
        print_line(f"{node_name}:\n" + "\n".join(f"  {name}" for name in _parameters(tool, node_name)))


def param_get(tool: Tool, node: str, name: str) -> None:
    """Prints the value of a parameter."""
    value = tool.client.call(f"{absolute_name(node)}/get_parameters", GetParameters.Request(names=[name])).values[:1]
    if not value or value[0].type == ParameterType.PARAMETER_NOT_SET:
        raise _missing_parameter(tool, node, name)
    label, field, _ = _TYPES[value[0].type]
    found = getattr(value[0], field)
    print_line(f"{label} values are: {list(found)}" if field.endswith("_array_value") else f"{label} value is: {found}")


def param_set(tool: Tool, node: str, name: str, value: str) -> None:
    """Sets a parameter; the node refuses it if it cannot be changed at run time."""
    node = absolute_name(node)
    description = tool.client.call(f"{node}/describe_parameters", DescribeParameters.Request(names=[name]))
    declared = description.descriptors[0] if description.descriptors else ParameterDescriptor()
    if declared.read_only:
        option = f"`--{name.replace('_', '-')}` of `gibson-sim run`, " if node.rpartition("/")[2] in (PHYSICS, RENDER) else ""
        raise GibsonSimError(
            f"parameter {quoted(name)} of node {node} is read-only: set it when the node starts, with {option}`-p {name}:=...` of `ros2 run`"
        )
    message = ParameterMessage(name=name, value=parameter_value(name, value, declared.type))
    response = tool.client.call(f"{node}/set_parameters", SetParameters.Request(parameters=[message]))
    result = response.results[0]
    if not result.successful:
        if name not in _parameters(tool, node):
            raise _missing_parameter(tool, node, name)
        raise GibsonSimError(f"Setting parameter failed: {result.reason}")
    print_line("Set parameter successful")


def parameter_value(name: str, text: str, declared: int) -> ParameterValue:
    """Returns the value of a parameter.

    Args:
        name: name of the parameter, for error messages.
        text: value as on the command line.
        declared: a constant of ``ParameterType``: the present type; PARAMETER_NOT_SET = as the text looks, as ``ros2`` does.

    Raises:
        GibsonSimError: the text is no value of the type.
    """
    try:
        value = parse_values(text)
    except GibsonSimError:  # a text that is not YAML
        value = text
    kind = declared if declared in _TYPES else _guess(value)
    if kind == ParameterType.PARAMETER_STRING and not isinstance(value, str):
        value = text
    _, field, allowed = _TYPES[kind]
    try:
        return fill(ParameterValue(type=kind), {field: value})
    except MessageValueError as error:
        raise GibsonSimError(f"parameter {quoted(name)} is {quoted(text)}, must be of type {allowed}") from error


def _guess(value: Any) -> int:
    """Returns the type of parameter that a YAML value has."""
    items = value if isinstance(value, list) else [value]
    for python, scalar, array in _GUESSES:
        # A bool is an int, too, and is only a bool here.
        if all(isinstance(item, python) and (python is bool or not isinstance(item, bool)) for item in items):
            return array if isinstance(value, list) else scalar
    return ParameterType.PARAMETER_STRING


def _parameters(tool: Tool, node_name: str) -> list[str]:
    """Returns the names of a node's parameters, sorted."""
    return sorted(tool.client.call(f"{node_name}{LIST_PARAMETERS}", ListParameters.Request()).result.names)


def _missing_parameter(tool: Tool, node: str, name: str) -> GibsonSimError:
    """Returns the error for a parameter that a node does not have: names the nodes that have it, or the most similar one."""
    tool.discover()
    others = [other for other in tool.nodes_with_parameters() if name in _parameters(tool, other)]
    hint = f"; {', '.join(others)} has it" if others else ""
    if not hint and (similar := nearest(name, _parameters(tool, absolute_name(node)))):
        hint = f"; {similar}"
    return GibsonSimError(f"node {absolute_name(node)} has no parameter {quoted(name)}{hint or '; see `gibson-sim param list`'}")
