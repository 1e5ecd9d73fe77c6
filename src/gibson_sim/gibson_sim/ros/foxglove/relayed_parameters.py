"""Relays the parameters of all nodes to Foxglove clients, with names ``/namespace/node.parameter``."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSProfile

from gibson_sim.quoting import quoted
from gibson_sim.web.foxglove_server import FoxgloveServer

_EVENTS = "/parameter_events"
_TIMEOUT_S = 3.0
"""Timeout for the responses of all nodes, s of wall time."""
Values = dict[str, Any]


class RelayedParameters:
    """Reads and sets parameters of other nodes; results are given to futures."""

    def __init__(self, node: Node, server: FoxgloveServer) -> None:
        self._node, self._server = node, server
        self._clients: dict[str, Any] = {}
        self._events: Any = None

    def get(self, names: list[str], answer: Future[Values]) -> None:
        """Reads parameters, or all parameters of all nodes if ``names`` is empty; ``answer`` gets the values that exist."""
        if names:
            self._read(_by_node(names), answer)
            return
        nodes = [node for node in self._nodes() if self._is_available(f"{node}/list_parameters", ListParameters)]
        names_by_node: dict[str, list[str]] = {}
        gather = _Gather(self._node, len(nodes), lambda: self._read(names_by_node, answer))
        for node in nodes:

            def on_list(response: Any, node: str = node) -> None:
                names_by_node[node] = list(response.result.names)

            gather.add(self._call(f"{node}/list_parameters", ListParameters, ListParameters.Request()), on_list)

    def set(self, values: Values, answer: Future[Values]) -> None:
        """Sets parameters; ``answer`` gets their values afterwards, and clients get a warning for each that was refused."""
        names_by_node = {
            node: names
            for node, names in _by_node(list(values)).items()
            if self._is_available(f"{node}/set_parameters", SetParameters)
        }
        gather = _Gather(self._node, len(names_by_node), lambda: self._read(_by_node(list(values)), answer))
        for node, names in names_by_node.items():
            parameters = [_message(name, values[f"{node}.{name}"]) for name in names]

            def on_set(response: Any, node: str = node, names: list[str] = names) -> None:
                for name, result in zip(names, response.results, strict=False):
                    if not result.successful:
                        self._server.warn(f"parameter {quoted(f'{node}.{name}')} is not set: {result.reason}")

            gather.add(self._call(f"{node}/set_parameters", SetParameters, SetParameters.Request(parameters=parameters)), on_set)

    def watch(self, watched: bool) -> None:
        """Starts or stops sending changed parameters to clients."""
        if watched and self._events is None:
            self._events = self._node.create_subscription(ParameterEvent, _EVENTS, self._on_event, QoSProfile(depth=100))
        elif not watched and self._events is not None:
            self._node.destroy_subscription(self._events)
            self._events = None

    def _on_event(self, event: Any) -> None:
        changed = [*event.new_parameters, *event.changed_parameters]
        self._server.send_parameters({f"{event.node}.{p.name}": _python(p.value) for p in changed})

    def _read(self, names_by_node: dict[str, list[str]], answer: Future[Values]) -> None:
        values: Values = {}
        available = {
            node: names for node, names in names_by_node.items() if self._is_available(f"{node}/get_parameters", GetParameters)
        }
        gather = _Gather(self._node, len(available), lambda: answer.set_result(values))
        for node, names in available.items():

            def on_values(response: Any, node: str = node, names: list[str] = names) -> None:
                for name, value in zip(names, response.values, strict=False):
                    if (converted := _python(value)) is not None:
                        values[f"{node}.{name}"] = converted

            gather.add(self._call(f"{node}/get_parameters", GetParameters, GetParameters.Request(names=names)), on_values)

    def _nodes(self) -> list[str]:
        nodes = self._node.get_node_names_and_namespaces()
        return sorted({f"{namespace.rstrip('/')}/{name}" for name, namespace in nodes if not name.startswith("_")})

    def _is_available(self, service: str, kind: Any) -> bool:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        # A new client discovers a service within milliseconds if its node is discovered already.
        return bool(self._clients[service].wait_for_service(timeout_sec=0.2))

    def _call(self, service: str, kind: Any, request: Any) -> Any:
        return self._clients[service].call_async(request)


class _Gather:
    """Calls ``on_end`` once all responses have arrived, or after ``_TIMEOUT_S``."""

    def __init__(self, node: Node, count: int, on_end: Callable[[], None]) -> None:
        self._node, self._remaining, self._on_end = node, count, on_end
        self._timer: Any = None
        if count:
            self._timer = node.create_timer(_TIMEOUT_S, self._end)
        else:
            on_end()

    def add(self, future: Any, on_response: Callable[[Any], None]) -> None:
        """Adds a call; ``on_response`` gets its response."""

        def on_done(future: Any) -> None:
            if future.exception() is None and self._timer is not None:
                on_response(future.result())
            self._remaining -= 1
            if not self._remaining:
                self._end()

        future.add_done_callback(on_done)

    def _end(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
            self._on_end()


def _by_node(names: list[str]) -> dict[str, list[str]]:
    """Returns node -> names of its parameters; names without a node are skipped."""
    names_by_node: dict[str, list[str]] = {}
    for full_name in names:
        node, dot, name = full_name.partition(".")
        if dot and node.startswith("/") and name:
            names_by_node.setdefault(node, []).append(name)
    return names_by_node


def _python(value: Any) -> Any:
    """Returns the value of a parameter in the types of the protocol; None = not set."""
    converted = parameter_value_to_python(value)
    return (
        bytes(b[0] for b in converted)
        if converted and isinstance(converted, list) and isinstance(converted[0], bytes)
        else (list(converted) if hasattr(converted, "typecode") else converted)
    )


def _message(name: str, value: Any) -> Any:
    """Returns a parameter message from a value of the protocol; None = removed."""
    return ParameterMessage(name=name) if value is None else Parameter(name, value=value).to_parameter_msg()
