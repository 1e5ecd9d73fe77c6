"""The Foxglove WebSocket server, based on the package ``foxglove-sdk``. Must not import ROS: a ``FoxgloveBackend`` handles requests of clients.

Messages, requests and responses are CDR bytes that are passed through unchanged; message definitions (encoding ``ros2msg``) describe them. The
protocol has no authentication, and the SDK accepts pages of any origin: every client that can reach the port can read all data, and can send
commands unless ``commands`` is off.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, TimeoutError
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, cast

from gibson_sim.errors import ConfigError, EnvironmentProblemError
from gibson_sim.quoting import quoted

logger = logging.getLogger(__name__)

CDR, JSON = "cdr", "json"
"""Encodings of client messages."""
_DEFINITION = "ros2msg"
_BACKLOG = 256
"""Queue length for a slow client; when it is full, the oldest message is dropped."""
_CALL_S, _PARAMETERS_S = 120.0, 5.0
"""Timeouts for the response of a service and of parameters, seconds of wall time."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic that clients can subscribe to."""

    name: str
    type_name: str
    """Message type such as ``sensor_msgs/msg/Image``."""
    definition: str
    """Definition of the type and of all nested types."""


@dataclass(frozen=True, slots=True)
class ServiceInfo:
    """A service that clients can call."""

    name: str
    type_name: str
    """Service type such as ``std_srvs/srv/Trigger``."""
    request: str
    """Definition of the request and of all nested types."""
    response: str
    """Definition of the response and of all nested types."""


@dataclass(frozen=True, slots=True)
class ClientTopic:
    """A topic advertised by a client."""

    key: tuple[int, int]
    """Id of the client, and the client's id of the topic."""
    name: str
    type_name: str
    encoding: str
    """``cdr`` or ``json``."""


class FoxgloveBackend(Protocol):
    """Handler of client requests. Every method may be called from any thread and must not block."""

    def subscribed(self, topic: str) -> None:
        """Handles a new subscription: the client expects further messages, and the last one of a latched topic."""

    def unsubscribed(self, topic: str) -> None:
        """Handles the end of the last subscription of a topic."""

    def advertised(self, topic: ClientTopic) -> None:
        """Handles a topic advertised by a client."""

    def unadvertised(self, key: tuple[int, int]) -> None:
        """Handles the end of an advertisement, also after a lost connection."""

    def received(self, key: tuple[int, int], data: bytes) -> None:
        """Handles a message published by a client."""

    def call(self, service: str, request: bytes) -> Future[bytes]:
        """Calls a service; the future holds the response."""

    def get_parameters(self, names: list[str]) -> Future[dict[str, Any]]:
        """Reads parameters, named ``/node.parameter``; no names = all."""

    def set_parameters(self, values: dict[str, Any]) -> Future[dict[str, Any]]:
        """Sets parameters; the future holds their resulting values."""

    def watch_parameters(self, watched: bool) -> None:
        """Handles a change of whether any client subscribes to parameter changes."""


class FoxgloveServer:
    """Serves the protocol in threads of the SDK.

    Args:
        backend: handler of client requests.
        host: address to listen on.
        port: TCP port; 0 = any free port.
        commands: whether clients may publish, call services and set parameters.
        name: server name shown by clients.

    Raises:
        EnvironmentProblemError: foxglove-sdk is not installed.
        ConfigError: the address cannot be used.
    """

    def __init__(
        self, backend: FoxgloveBackend, host: str, port: int, *, commands: bool = True, name: str = "gibson_sim"
    ) -> None:
        self._sdk = sdk = load_sdk()
        self._backend, self._host = backend, host
        self._context = sdk.Context()
        self._channels: dict[str, tuple[TopicInfo, Any]] = {}
        self._services: dict[str, ServiceInfo] = {}
        capabilities = [sdk.Capability.Time]
        if commands:
            capabilities += [sdk.Capability.ClientPublish, sdk.Capability.Parameters, sdk.Capability.Services]
        try:
            self._server: Any = sdk.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=capabilities,
                server_listener=_Listener(backend, sdk.Parameter),
                supported_encodings=[CDR, JSON] if commands else None,
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            reason = str(error).rpartition("bind port: ")[2]
            raise ConfigError(f"port {port} of {host} cannot be used: {reason}; choose another one") from error
        self.port = int(self._server.port)

    @property
    def url(self) -> str:
        """The address for a client."""
        return f"ws://{f'[{self._host}]' if ':' in self._host else self._host}:{self.port}"

    def serve_topics(self, topics: Iterable[TopicInfo]) -> None:
        """Replaces the offered topics."""
        offered = {topic.name: topic for topic in topics}
        for name in [name for name, (topic, _) in self._channels.items() if offered.get(name) != topic]:
            self._channels.pop(name)[1].close()
        for name, topic in offered.items():
            if name not in self._channels:
                schema = self._sdk.Schema(name=topic.type_name, encoding=_DEFINITION, data=topic.definition.encode())
                channel = self._sdk.Channel(name, schema=schema, message_encoding=CDR, context=self._context)
                self._channels[name] = (topic, channel)

    def serve_services(self, services: Iterable[ServiceInfo]) -> None:
        """Replaces the offered services."""
        offered = {service.name: service for service in services}
        removed = [name for name, service in self._services.items() if offered.get(name) != service]
        if removed:
            self._server.remove_services(removed)
        new = [service for name, service in offered.items() if name in removed or name not in self._services]
        if new:
            self._server.add_services([self._service(service) for service in new])
        self._services = offered

    def send(self, topic: str, data: bytes, time_ns: int) -> None:
        """Sends a message of a topic to its subscribers.

        Args:
            topic: topic of the message.
            data: CDR with its four bytes of encapsulation.
            time_ns: time of arrival on the clock of ``send_time``, nanoseconds.
        """
        if topic in self._channels:
            self._channels[topic][1].log(data, log_time=max(0, time_ns))

    def send_time(self, time_ns: int) -> None:
        """Sends the time to all clients, nanoseconds: simulation time if a clock is published."""
        self._server.broadcast_time(max(0, time_ns))

    def new_session(self) -> None:
        """Makes clients discard their data, since the clock has changed."""
        self._server.clear_session()

    def send_parameters(self, values: Mapping[str, Any]) -> None:
        """Sends new values of parameters to subscribed clients."""
        self._server.publish_parameter_values(_parameters(self._sdk.Parameter, values))

    def warn(self, text: str) -> None:
        """Shows a warning to all clients."""
        self._server.publish_status(text, self._sdk.StatusLevel.Warning)

    def close(self) -> None:
        """Ends the server; a second call does nothing."""
        self._server.stop()

    def _service(self, service: ServiceInfo) -> Any:
        sdk = self._sdk

        def schema(part: str, definition: str) -> Any:
            name = f"{service.type_name}_{part}"
            return sdk.MessageSchema(encoding=CDR, schema=sdk.Schema(name=name, encoding=_DEFINITION, data=definition.encode()))

        types = sdk.ServiceSchema(
            service.type_name, request=schema("Request", service.request), response=schema("Response", service.response)
        )
        return sdk.Service(service.name, schema=types, handler=partial(_call, self._backend))


class _Sdk(Protocol):
    """The names of the SDK that this module uses."""

    Capability: Any
    Channel: Any
    Context: Any
    MessageSchema: Any
    Parameter: Any
    Schema: Any
    Service: Any
    ServiceSchema: Any
    StatusLevel: Any
    start_server: Callable[..., Any]


def load_sdk() -> _Sdk:
    """Returns the package ``foxglove``.

    Raises:
        EnvironmentProblemError: the package is not installed.
    """
    try:
        import foxglove as module
    except ImportError as error:
        raise EnvironmentProblemError(
            "the Foxglove server needs the Python package foxglove-sdk, which is not installed: `pip install foxglove-sdk`"
        ) from error
    sdk: Any = module
    if not hasattr(sdk, "start_server"):  # foxglove-client provides a package of the same name
        raise EnvironmentProblemError("the installed Python package `foxglove` has no server: `pip install foxglove-sdk`")
    logging.getLogger("foxglove").setLevel(logging.WARNING)
    return cast(_Sdk, sdk)


class _Listener:
    """Forwards client events to the backend. Called in threads of the SDK."""

    def __init__(self, backend: FoxgloveBackend, parameter: Any) -> None:
        self._backend, self._parameter = backend, parameter
        self._subscribers: dict[str, set[int]] = {}
        self._watched: set[str] = set()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._subscribers.setdefault(channel.topic, set()).add(client.id)
        self._backend.subscribed(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        remaining = self._subscribers.get(channel.topic, set())
        remaining.discard(client.id)
        if not remaining:
            self._subscribers.pop(channel.topic, None)
            self._backend.unsubscribed(channel.topic)

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        topic = ClientTopic((client.id, channel.id), channel.topic, channel.schema_name, channel.encoding)
        self._backend.advertised(topic)

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        self._backend.unadvertised((client.id, client_channel_id))

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        self._backend.received((client.id, client_channel_id), data)

    def on_get_parameters(self, client: Any, param_names: list[str], request_id: str | None = None) -> list[Any]:
        return _parameters(self._parameter, _values(self._backend.get_parameters(param_names)))

    def on_set_parameters(self, client: Any, parameters: list[Any], request_id: str | None = None) -> list[Any]:
        values = {parameter.name: parameter.get_value() for parameter in parameters}
        return _parameters(self._parameter, _values(self._backend.set_parameters(values)))

    def on_parameters_subscribe(self, param_names: list[str]) -> None:
        self._watched.update(param_names)
        self._backend.watch_parameters(True)

    def on_parameters_unsubscribe(self, param_names: list[str]) -> None:
        self._watched.difference_update(param_names)
        if not self._watched:
            self._backend.watch_parameters(False)


def _call(backend: FoxgloveBackend, request: Any) -> bytes:
    """Calls a service for a client; an exception is sent as its response."""
    if request.encoding != CDR:
        raise ConfigError(f"service {quoted(request.service_name)}: encoding {quoted(request.encoding)}, must be {CDR}")
    return backend.call(request.service_name, request.payload).result(_CALL_S)


def _values(response: Future[dict[str, Any]]) -> dict[str, Any]:
    """Returns parameters; empty if they do not arrive in time."""
    try:
        return response.result(_PARAMETERS_S)
    except TimeoutError:
        logger.warning("parameters did not arrive within %g s", _PARAMETERS_S)
        return {}


def _parameters(kind: Any, values: Mapping[str, Any]) -> list[Any]:
    return [kind(name, value=value) for name, value in values.items()]


def message_from_json(data: bytes) -> Any:
    """Parses the values of a JSON message.

    Raises:
        ConfigError: the message is not JSON.
    """
    try:
        return json.loads(data)
    except ValueError as error:
        raise ConfigError(f"a message is not JSON: {error}") from error
