"""The Foxglove WebSocket server, by the package ``foxglove-sdk``. Knows no ROS: a ``FoxgloveBackend`` is told what clients ask for.

Messages, requests and responses are bytes in CDR that pass as they are; what they mean is said by definitions (encoding ``ros2msg``). The
protocol has no password, and the SDK accepts pages of every web site: whoever reaches the port may read everything, and command everything
unless ``commands`` is off.
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
"""Encodings of what clients send."""
_DEFINITION = "ros2msg"
_BACKLOG = 256
"""Messages that wait for a slow client; beyond it the oldest is dropped."""
_CALL_S, _PARAMETERS_S = 120.0, 5.0
"""Longest wall time until a service and the parameters answer, seconds."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic that clients can subscribe to."""

    name: str
    type_name: str
    """``sensor_msgs/msg/Image``."""
    definition: str
    """Text of the type and of all nested types."""


@dataclass(frozen=True, slots=True)
class ServiceInfo:
    """A service that clients can call."""

    name: str
    type_name: str
    """``std_srvs/srv/Trigger``."""
    request: str
    """Definition of the request, and of all nested types."""
    response: str


@dataclass(frozen=True, slots=True)
class ClientTopic:
    """A topic that a client wants to publish on."""

    key: tuple[int, int]
    """Number of the client, and the number that it gave the topic."""
    name: str
    type_name: str
    encoding: str
    """``cdr`` or ``json``."""


class FoxgloveBackend(Protocol):
    """What stands behind the server. Every method may be called from any thread and must not block."""

    def subscribed(self, topic: str) -> None:
        """A client has subscribed to a topic: it wants the next messages, and the last one of a latched topic."""

    def unsubscribed(self, topic: str) -> None:
        """The last client of a topic has gone."""

    def advertised(self, topic: ClientTopic) -> None:
        """A client wants to publish on a topic."""

    def unadvertised(self, key: tuple[int, int]) -> None:
        """A client no longer publishes on a topic, or is gone."""

    def received(self, key: tuple[int, int], data: bytes) -> None:
        """A client has published a message."""

    def call(self, service: str, request: bytes) -> Future[bytes]:
        """Calls a service; the future holds the response."""

    def get_parameters(self, names: list[str]) -> Future[dict[str, Any]]:
        """Reads parameters, named ``/node.parameter``; no name = all."""

    def set_parameters(self, values: dict[str, Any]) -> Future[dict[str, Any]]:
        """Sets parameters; the future holds the values that they have afterwards."""

    def watch_parameters(self, watched: bool) -> None:
        """Whether any client wants to be told of changed parameters."""


class FoxgloveServer:
    """Serves the protocol in threads of the SDK.

    Args:
        backend: what stands behind it.
        host: address to listen on.
        port: of TCP; 0 = any that is free.
        commands: clients may publish, call services and set parameters.
        name: shown by clients.

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
        allowed = [sdk.Capability.Time]
        if commands:
            allowed += [sdk.Capability.ClientPublish, sdk.Capability.Parameters, sdk.Capability.Services]
        try:
            self._server: Any = sdk.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=allowed,
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
        """Offers these topics and no others."""
        wanted = {topic.name: topic for topic in topics}
        for name in [name for name, (topic, _) in self._channels.items() if wanted.get(name) != topic]:
            self._channels.pop(name)[1].close()
        for name, topic in wanted.items():
            if name not in self._channels:
                schema = self._sdk.Schema(name=topic.type_name, encoding=_DEFINITION, data=topic.definition.encode())
                channel = self._sdk.Channel(name, schema=schema, message_encoding=CDR, context=self._context)
                self._channels[name] = (topic, channel)

    def serve_services(self, services: Iterable[ServiceInfo]) -> None:
        """Offers these services and no others."""
        wanted = {service.name: service for service in services}
        gone = [name for name, service in self._services.items() if wanted.get(name) != service]
        if gone:
            self._server.remove_services(gone)
        new = [service for name, service in wanted.items() if name in gone or name not in self._services]
        if new:
            self._server.add_services([self._service(service) for service in new])
        self._services = wanted

    def send(self, topic: str, data: bytes, time_ns: int) -> None:
        """Sends a message of a topic to its subscribers.

        Args:
            topic: that it was published on.
            data: CDR, with its four bytes of encapsulation.
            time_ns: of its arrival, on the clock of ``send_time``, nanoseconds.
        """
        if topic in self._channels:
            self._channels[topic][1].log(data, log_time=max(0, time_ns))

    def send_time(self, time_ns: int) -> None:
        """Tells all clients the time, nanoseconds: simulation time where there is a clock."""
        self._server.broadcast_time(max(0, time_ns))

    def new_session(self) -> None:
        """Has clients forget what they show: another clock began."""
        self._server.clear_session()

    def send_parameters(self, values: Mapping[str, Any]) -> None:
        """Tells clients that want to know the new values of parameters."""
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
    """The names of the SDK that are used here."""

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
        EnvironmentProblemError: it is not installed.
    """
    try:
        import foxglove as found
    except ImportError as error:
        raise EnvironmentProblemError(
            "the Foxglove server needs the Python package foxglove-sdk, which is not installed: `pip install foxglove-sdk`"
        ) from error
    sdk: Any = found
    if not hasattr(sdk, "start_server"):  # foxglove-client alone has the same name
        raise EnvironmentProblemError("the Python package `foxglove` here has no server: `pip install foxglove-sdk`")
    logging.getLogger("foxglove").setLevel(logging.WARNING)
    return cast(_Sdk, sdk)


class _Listener:
    """Hands what clients do to the backend. Called in threads of the SDK."""

    def __init__(self, backend: FoxgloveBackend, parameter: Any) -> None:
        self._backend, self._parameter = backend, parameter
        self._subscribers: dict[str, set[int]] = {}
        self._watched: set[str] = set()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._subscribers.setdefault(channel.topic, set()).add(client.id)
        self._backend.subscribed(channel.topic)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        left = self._subscribers.get(channel.topic, set())
        left.discard(client.id)
        if not left:
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
    """Calls a service for a client; an exception is its answer."""
    if request.encoding != CDR:
        raise ConfigError(f"service {quoted(request.service_name)}: encoding {quoted(request.encoding)}, must be {CDR}")
    return backend.call(request.service_name, request.payload).result(_CALL_S)


def _values(answer: Future[dict[str, Any]]) -> dict[str, Any]:
    """Returns parameters; none if they do not arrive in time."""
    try:
        return answer.result(_PARAMETERS_S)
    except TimeoutError:
        logger.warning("parameters did not arrive within %g s", _PARAMETERS_S)
        return {}


def _parameters(kind: Any, values: Mapping[str, Any]) -> list[Any]:
    return [kind(name, value=value) for name, value in values.items()]


def message_of_json(data: bytes) -> Any:
    """Returns the values of a message in JSON.

    Raises:
        ConfigError: it is no JSON.
    """
    try:
        return json.loads(data)
    except ValueError as error:
        raise ConfigError(f"a message is no JSON: {error}") from error
