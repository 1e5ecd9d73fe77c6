"""``gibson-sim param``: list, get, set."""

from __future__ import annotations

from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.arguments import full_node_name, parse_values
from gibson_sim.ros.tools.hints import PHYSICS, RENDER
from gibson_sim.ros.tools.output import print_line
from gibson_sim.ros.tools.tool import LIST_PARAMETERS, Tool
from gibson_sim.settings import nearest

_ARRAYS = {
    ParameterType.PARAMETER_BYTE_ARRAY: ("Byte", "byte_array_value"), ParameterType.PARAMETER_BOOL_ARRAY: ("Boolean", "bool_array_value"),
    ParameterType.PARAMETER_INTEGER_ARRAY: ("Integer", "integer_array_value"),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ("Double", "double_array_value"),
    ParameterType.PARAMETER_STRING_ARRAY: ("String", "string_array_value"),
}  # fmt: skip
_KINDS = {
    ParameterType.PARAMETER_BOOL: ("Boolean", "bool_value"), ParameterType.PARAMETER_INTEGER: ("Integer", "integer_value"),
    ParameterType.PARAMETER_DOUBLE: ("Double", "double_value"), ParameterType.PARAMETER_STRING: ("String", "string_value"),
}  # fmt: skip
_PYTHON = {
    ParameterType.PARAMETER_BOOL: bool, ParameterType.PARAMETER_INTEGER: int, ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_STRING: str,
}  # fmt: skip


def param_list(tool: Tool, node: str | None = None) -> None:
    """Prints the parameters of a node, or of all nodes."""
    if node is not None:
        node_names = [full_node_name(node)]
    else:
        tool.discover(PHYSICS, RENDER)  # a node that loads the scene does not respond
        node_names = tool.nodes_with_parameters()
        if not node_names and not tool.simulation_runs():
            raise tool.missing_simulation()
    for node_name in node_names:
        print_line(f"{node_name}:\n" + "\n".join(f"  {name}" for name in _parameters(tool, node_name)))


def param_get(tool: Tool, node: str, name: str) -> None:
    """Prints the value of a parameter."""
    value = tool.call(f"{full_node_name(node)}/get_parameters", GetParameters, GetParameters.Request(names=[name])).values[:1]
    if not value or value[0].type == ParameterType.PARAMETER_NOT_SET:
        raise _missing_parameter(tool, node, name)
    if value[0].type in _KINDS:
        label, attribute = _KINDS[value[0].type]
        print_line(f"{label} value is: {getattr(value[0], attribute)}")
    else:
        label, attribute = _ARRAYS[value[0].type]
        print_line(f"{label} values are: {list(getattr(value[0], attribute))}")


def param_set(tool: Tool, node: str, name: str, value: str) -> None:
    """Sets a parameter; the node refuses it if it cannot be changed at run time."""
    description = tool.call(
        f"{full_node_name(node)}/describe_parameters", DescribeParameters, DescribeParameters.Request(names=[name])
    )
    declared = description.descriptors[0].type if description.descriptors else ParameterType.PARAMETER_NOT_SET
    parsed = parse_values(value)
    kind = (
        declared
        if declared in _KINDS
        else next((k for k, t in _PYTHON.items() if type(parsed) is t), ParameterType.PARAMETER_STRING)
    )
    if kind == ParameterType.PARAMETER_STRING:
        parsed = value
    elif kind == ParameterType.PARAMETER_DOUBLE and isinstance(parsed, int):
        parsed = float(parsed)
    if type(parsed) is not _PYTHON[kind]:
        raise GibsonSimError(f"parameter {quoted(name)} is {quoted(value)}, must be a value of type {_KINDS[kind][0].lower()}")
    message = ParameterMessage(name=name, value=ParameterValue(type=kind, **{_KINDS[kind][1]: parsed}))
    response = tool.call(f"{full_node_name(node)}/set_parameters", SetParameters, SetParameters.Request(parameters=[message]))
    result = response.results[0]
    if not result.successful:
        if name not in _parameters(tool, full_node_name(node)):
            raise _missing_parameter(tool, node, name)
        raise GibsonSimError(f"Setting parameter failed: {result.reason}")
    print_line("Set parameter successful")


def _parameters(tool: Tool, node_name: str) -> list[str]:
    """Returns the names of a node's parameters, sorted."""
    return sorted(tool.call(f"{node_name}{LIST_PARAMETERS}", ListParameters, ListParameters.Request()).result.names)


def _missing_parameter(tool: Tool, node: str, name: str) -> GibsonSimError:
    """Returns the error for a parameter that a node does not have: names the nodes that have it, or the most similar one."""
    tool.discover()
    others = [other for other in tool.nodes_with_parameters() if name in _parameters(tool, other)]
    hint = f"; {', '.join(others)} has it" if others else ""
    if not hint and (similar := nearest(name, _parameters(tool, full_node_name(node)))):
        hint = f"; {similar}"
    return GibsonSimError(f"node {full_node_name(node)} has no parameter {quoted(name)}{hint or '; see `gibson-sim param list`'}")
