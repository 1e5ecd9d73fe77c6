"""Relays service calls of Foxglove clients: requests and responses in CDR."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.topics import names
from gibson_sim.ros.wire.message_types import UNKNOWN, service_class
from gibson_sim.web.foxglove_server import FoxgloveServer, ServiceInfo

_HIDDEN_PACKAGES = ("rcl_interfaces/", "type_description_interfaces/")
"""Packages of services that every node has, which are not offered; the protocol has its own messages for parameters."""


class RelayedServices:
    """Calls services for clients."""

    def __init__(self, node: Node, server: FoxgloveServer, definitions: MessageDefinitions) -> None:
        self._node, self._server, self._definitions = node, server, definitions
        self._known: dict[str, ServiceInfo] = {}
        self._clients: dict[str, Any] = {}
        self._waiting: set[Future[bytes]] = set()

    def update(self) -> None:
        """Offers the services that exist now to clients."""
        services = {}
        for name, types in self._node.get_service_names_and_types():
            if names.is_hidden(name) or types[0].startswith(_HIDDEN_PACKAGES):
                continue
            try:
                service_class(types[0])
                services[name] = ServiceInfo(name, types[0], *self._definitions.service_texts(types[0]))
            except (*UNKNOWN, GibsonSimError):
                continue  # the type is not installed
        if services != self._known:
            for name in set(self._clients) - set(services):
                self._node.destroy_client(self._clients.pop(name))
            self._known = services
            self._server.serve_services(services.values())

    def call(self, name: str, data: bytes, answer: Future[bytes]) -> None:
        """Calls a service.

        Args:
            name: full name of the service.
            data: request in CDR.
            answer: gets the response in CDR, or the error.
        """
        if name not in self._known:
            answer.set_exception(ConfigError(f"service {quoted(name)} does not exist"))
            return
        kind = service_class(self._known[name].type_name)
        try:
            request = deserialize_message(data, kind.Request)
        except Exception:
            answer.set_exception(
                ConfigError(f"service {quoted(name)}: {len(data)} bytes are not a request of {self._known[name].type_name}")
            )
            return
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        client = self._clients[name]
        if not client.wait_for_service(timeout_sec=1.0):
            answer.set_exception(ConfigError(f"service {quoted(name)} does not respond"))
            return
        self._waiting.add(answer)

        def on_done(future: Any) -> None:
            self._waiting.discard(answer)
            if answer.done():
                return
            if future.exception() is not None:
                answer.set_exception(ConfigError(f"service {quoted(name)} failed: {future.exception()}"))
            else:
                answer.set_result(serialize_message(future.result()))

        client.call_async(request).add_done_callback(on_done)

    def close(self) -> None:
        """Ends all pending calls with an error, so that no thread waits for them."""
        for answer in self._waiting:
            if not answer.done():
                answer.set_exception(ConfigError("the Foxglove server has ended"))
        self._waiting.clear()
