"""The parameters of all nodes for Foxglove clients, named ``/namespace/node.parameter``."""

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
_PATIENCE_S = 3.0
"""Wall time in which the nodes answer, seconds."""
Values = dict[str, Any]


class RelayedParameters:
    """Reads and sets parameters; never blocks."""

    def __init__(self, node: Node, server: FoxgloveServer) -> None:
        self._node, self._server = node, server
        self._clients: dict[str, Any] = {}
        self._events: Any = None

    def get(self, names: list[str], answer: Future[Values]) -> None:
        """Reads parameters; no name = those of all nodes. ``answer`` gets what exists."""
        if names:
            self._read(_by_node(names), answer)
            return
        nodes = [node for node in self._nodes() if self._is_there(f"{node}/list_parameters", ListParameters)]
        found: dict[str, list[str]] = {}
        gather = _Gather(self._node, len(nodes), lambda: self._read(found, answer))
        for node in nodes:

            def listed(response: Any, node: str = node) -> None:
                found[node] = list(response.result.names)

            gather.add(self._call(f"{node}/list_parameters", ListParameters, ListParameters.Request()), listed)

    def set(self, values: Values, answer: Future[Values]) -> None:
        """Sets parameters; ``answer`` gets the values that they have afterwards, and clients a warning of each that was refused."""
        wanted = {
            node: names
            for node, names in _by_node(list(values)).items()
            if self._is_there(f"{node}/set_parameters", SetParameters)
        }
        gather = _Gather(self._node, len(wanted), lambda: self._read(_by_node(list(values)), answer))
        for node, names in wanted.items():
            parameters = [_message(name, values[f"{node}.{name}"]) for name in names]

            def done(response: Any, node: str = node, names: list[str] = names) -> None:
                for name, result in zip(names, response.results, strict=False):
                    if not result.successful:
                        self._server.warn(f"parameter {quoted(f'{node}.{name}')} is not set: {result.reason}")

            gather.add(self._call(f"{node}/set_parameters", SetParameters, SetParameters.Request(parameters=parameters)), done)

    def watch(self, watched: bool) -> None:
        """Tells clients of changed parameters, or no longer."""
        if watched and self._events is None:
            self._events = self._node.create_subscription(ParameterEvent, _EVENTS, self._on_event, QoSProfile(depth=100))
        elif not watched and self._events is not None:
            self._node.destroy_subscription(self._events)
            self._events = None

    def _on_event(self, event: Any) -> None:
        changed = [*event.new_parameters, *event.changed_parameters]
        self._server.send_parameters({f"{event.node}.{p.name}": _python(p.value) for p in changed})

    def _read(self, wanted: dict[str, list[str]], answer: Future[Values]) -> None:
        values: Values = {}
        there = {node: names for node, names in wanted.items() if self._is_there(f"{node}/get_parameters", GetParameters)}
        gather = _Gather(self._node, len(there), lambda: answer.set_result(values))
        for node, names in there.items():

            def read(response: Any, node: str = node, names: list[str] = names) -> None:
                for name, value in zip(names, response.values, strict=False):
                    if (found := _python(value)) is not None:
                        values[f"{node}.{name}"] = found

            gather.add(self._call(f"{node}/get_parameters", GetParameters, GetParameters.Request(names=names)), read)

    def _nodes(self) -> list[str]:
        found = self._node.get_node_names_and_namespaces()
        return sorted({f"{namespace.rstrip('/')}/{name}" for name, namespace in found if not name.startswith("_")})

    def _is_there(self, service: str, kind: Any) -> bool:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        # A new client discovers a service within milliseconds, where the node is known already.
        return bool(self._clients[service].wait_for_service(timeout_sec=0.2))

    def _call(self, service: str, kind: Any, request: Any) -> Any:
        return self._clients[service].call_async(request)


class _Gather:
    """Calls ``then`` once all responses are there, or after ``_PATIENCE_S`` with those that are."""

    def __init__(self, node: Node, count: int, then: Callable[[], None]) -> None:
        self._node, self._left, self._then = node, count, then
        self._timer: Any = None
        if count:
            self._timer = node.create_timer(_PATIENCE_S, self._end)
        else:
            then()

    def add(self, future: Any, use: Callable[[Any], None]) -> None:
        """Adds a call; ``use`` gets its response."""

        def done(future: Any) -> None:
            if future.exception() is None and self._timer is not None:
                use(future.result())
            self._left -= 1
            if not self._left:
                self._end()

        future.add_done_callback(done)

    def _end(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
            self._then()


def _by_node(names: list[str]) -> dict[str, list[str]]:
    """Returns node -> names of its parameters; what has no node in its name is left out."""
    found: dict[str, list[str]] = {}
    for full in names:
        node, dot, name = full.partition(".")
        if dot and node.startswith("/") and name:
            found.setdefault(node, []).append(name)
    return found


def _python(value: Any) -> Any:
    """Returns the value of a parameter as the protocol has it; None = not set."""
    found = parameter_value_to_python(value)
    return (
        bytes(b[0] for b in found)
        if found and isinstance(found, list) and isinstance(found[0], bytes)
        else (list(found) if hasattr(found, "typecode") else found)
    )


def _message(name: str, value: Any) -> Any:
    """Returns a parameter from the protocol's value; None = removed."""
    return ParameterMessage(name=name) if value is None else Parameter(name, value=value).to_parameter_msg()
