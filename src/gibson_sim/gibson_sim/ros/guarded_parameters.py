"""No request about parameters ends a node: rclpy's own services raise at a type that does not exist, in the node's executor."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.node import Node

from gibson_sim.quoting import clipped

_Callback = Callable[[Any, Any], Any]
_READING = (DescribeParameters, GetParameters, GetParameterTypes, ListParameters)
_LONGEST_REASON = 200


def guard_parameters(node: Node) -> None:
    """Lets the services of a node's parameters answer whatever they are sent; what cannot be set is refused with a reason."""
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = partial(_set, node, service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = partial(_set_atomically, node, service.callback)
        elif service.srv_type in _READING:
            service.callback = partial(_read, node, service.callback)


def _set(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    results = []
    for parameter in request.parameters:
        try:
            results += callback(SetParameters.Request(parameters=[parameter]), SetParameters.Response()).results
        except Exception as error:
            results.append(_refusal(node, error))
    response.results = results
    return response


def _set_atomically(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    try:
        return callback(request, response)
    except Exception as error:
        response.result = _refusal(node, error)
        return response


def _read(node: Node, callback: _Callback, request: Any, response: Any) -> Any:
    try:
        return callback(request, response)
    except Exception as error:
        _refusal(node, error)
        return type(response)()


def _refusal(node: Node, error: Exception) -> SetParametersResult:
    reason = clipped(str(error), _LONGEST_REASON) or type(error).__name__
    node.get_logger().warning(f"a request about parameters is refused: {reason}", throttle_duration_sec=1.0)
    return SetParametersResult(successful=False, reason=reason)
