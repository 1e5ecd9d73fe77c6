"""The program behind ``gibson-sim topic``, ``node``, ``service``, ``param`` and ``action``: one command, given as JSON, printed as by ``ros2``."""

from __future__ import annotations

import json
import math
import statistics
import sys
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from itertools import pairwise
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.action.graph import (
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim import interrupts
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.processes.domain_lock import is_held
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node
from gibson_sim.ros.nodes.wait_for_simulation import start_hint
from gibson_sim.ros.tools.hints import (
    PHYSICS,
    RENDER,
    check_name,
    loading_nodes,
    missing_node,
    missing_service,
    no_simulation,
    simulation_runs,
    suggestion,
    type_and_values,
)
from gibson_sim.ros.tools.yaml_messages import field_of, fill, value_text, yaml_text
from gibson_sim.ros.topics.discovery import DISCOVERY_S
from gibson_sim.ros.topics.names import is_hidden
from gibson_sim.ros.topics.silence import SilenceNotice
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.settings import nearest
from gibson_sim.types import NS_PER_S

USUAL_DISCOVERY_S = 1.5
"""Time in which the nodes of a domain are usually discovered, s of wall time; if no packet is lost, see ``DISCOVERY_S``."""
_LOADING_S = 30.0
"""Timeout for a simulation that is starting: its nodes are discovered and load the scene, s of wall time."""
PATIENCE_S = 5.0
"""Timeout for the discovery of a name, s of wall time."""
_MORE_TYPES_S = 0.3
"""Time in which a discovered topic may turn out to have a second type, and the last names of a loaded node arrive, s of wall time."""
_WINDOW = 10_000
"""Number of messages in statistics, the newest ones, as in ``ros2 topic hz``."""


class Tool(Node):
    """A node that executes one command, after it has waited for discovery."""

    def __init__(self, arguments: dict[str, Any]) -> None:
        """Creates the node; ``arguments`` has ``command``, such as "topic echo", and the arguments of the command."""
        # A name that begins with _ is hidden, as that of ros2; the node offers no service, which lists would contain.
        super().__init__(
            "_gibson_sim_tool",
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._arguments = arguments
        self._start_s = time.monotonic()
        self._executor = make_executor()
        self._executor.add_node(self)

    def spin(self) -> int:
        """Executes the command; returns the exit code."""
        try:
            return self._execute()
        except BrokenPipeError:  # `gibson-sim topic list | head`
            sys.stderr.close()
            return 0

    def _execute(self) -> int:
        from gibson_sim.ros.tools.verbs import VERBS

        command = self._arguments.pop("command")
        if command == "names":
            from gibson_sim.ros.tools.known_names import known_names

            _print(known_names(self))
            return 0
        if command in VERBS:
            _print(VERBS[command](self, **self._arguments))
            return 0
        for kind in ("topic", "service", "action", "node"):
            if name := self._arguments.get(kind):
                check_name(kind, name)
        return int(_COMMANDS[command](self, **self._arguments) or 0)

    def close(self) -> None:
        """Shuts the executor down."""
        self._executor.shutdown()

    def spin_until(self, timeout_s: float, condition: Callable[[], bool] = lambda: False) -> bool:
        """Spins until a condition holds, or for ``timeout_s`` of wall time; returns whether the condition holds.

        Raises:
            KeyboardInterrupt: the end of the process is requested; what is known until then is not a result.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            if not is_running():
                raise KeyboardInterrupt
            if condition():
                return True
            remaining = deadline - time.monotonic()
            if remaining <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(remaining, 0.05))

    def wait_for(self, awaited: str, condition: Callable[[], bool]) -> bool:
        """Spins until a condition holds, for ``PATIENCE_S``, and reports that on stderr; returns whether the condition holds.

        Args:
            awaited: completes ``waiting for <awaited>``; empty = no report.
            condition: condition that must hold.
        """
        if condition():
            return True
        if awaited:
            _print_error(f"waiting for {awaited}")
        return self.spin_until(PATIENCE_S, condition)

    def discover(self, *awaited: str) -> None:
        """Spins until the nodes of the domain are discovered: longer without a simulation, and longest while one is starting.

        Args:
            awaited: names of the nodes of a simulation that must have loaded the scene, if they are present.
        """
        self._discover_usually()
        self.spin_until(DISCOVERY_S - USUAL_DISCOVERY_S, self.simulation_runs)
        if loading := self.loading(*awaited):
            _print_error(f"waiting for {loading}: the simulation is starting")
            if self.spin_until(_LOADING_S, lambda: not self.loading(*awaited)):
                self.spin_until(_MORE_TYPES_S)
            else:
                loading = self.loading(*awaited)
                _print_error(f"{loading} has not loaded the scene after {_LOADING_S:.0f} s: names may be missing")

    def _discover_usually(self) -> None:
        """Spins until ``USUAL_DISCOVERY_S`` after the start of this node."""
        self.spin_until(max(0.0, self._start_s + USUAL_DISCOVERY_S - time.monotonic()))

    def simulation_runs(self) -> bool:
        """Returns whether a simulation is discovered."""
        return simulation_runs(self.offered_services())

    def known_nodes(self) -> list[str]:
        """Returns the full names of the discovered nodes, sorted, without hidden ones, such as this node."""
        discovered = set(self.get_node_names_and_namespaces())
        return sorted(_full_name(namespace, name) for name, namespace in discovered if not name.startswith("_"))

    def loading(self, *awaited: str) -> str:
        """Returns what of a simulation is starting: the full names of its nodes among ``awaited``; empty = nothing."""
        topics = [topic for topic, kinds in self.known_topics().items() if "gibson_msgs/msg/RunInfo" in kinds]
        publishers = [info for topic in topics for info in self.get_publishers_info_by_topic(topic)]
        loaded = {_full_name(info.node_namespace, info.node_name) for info in publishers}
        nodes = loading_nodes(awaited, {*self.known_nodes(), *_nodes_with_parameters(self)}, loaded)
        if not nodes and awaited and not self.simulation_runs() and is_held(self.context.get_domain_id()):
            return "the physics node"  # it is not discovered yet
        return ", ".join(nodes)

    def known_topics(self) -> dict[str, list[str]]:
        """Returns topic -> types of the graph."""
        return dict(self.get_topic_names_and_types())

    def known_services(self) -> dict[str, list[str]]:
        """Returns service -> types of the graph."""
        return dict(self.get_service_names_and_types())

    def offered_services(self) -> dict[str, list[str]]:
        """Returns service -> types of the services that nodes offer; the graph also contains services that have clients only."""
        return {name: types for name, types in self.known_services().items() if self.count_services(name)}

    def missing_service(self, name: str, kind: str = "") -> GibsonSimError:
        """Returns the error for a service that no node offers; ``name`` is its full name, ``kind`` its type, if it is known."""
        services = self.offered_services()
        return GibsonSimError(missing_service(name, kind, services, domain=self.context.get_domain_id(), start=start_hint()))

    def missing_simulation(self) -> GibsonSimError:
        """Returns the error that no simulation runs."""
        return GibsonSimError(no_simulation(self.context.get_domain_id(), start_hint()))

    def hint(self, listing: str) -> str:
        """Returns the hint for the user if no other name is similar; ``listing`` is the command that lists the names."""
        return f"see `gibson-sim {listing}`" if self.simulation_runs() else str(self.missing_simulation())

    def find_topic(self, topic: str) -> str:
        """Returns the full name of a topic, after it was discovered.

        Raises:
            GibsonSimError: the topic does not exist.
        """
        name = self.resolve_topic_name(topic)
        if not self.spin_until(PATIENCE_S, lambda: name in self.known_topics()):
            loading = self.loading(PHYSICS, RENDER)
            hint = f"the simulation is starting, waiting for {loading}: try again in a few seconds" if loading else ""
            hint = hint or suggestion(name, self.known_topics(), self.hint("topic list"))
            raise GibsonSimError(f"topic {quoted(name)} has no publisher and no subscriber; {hint}")
        return name

    def type_of(self, topic: str) -> tuple[str, str]:
        """Returns the full name and the type of a topic.

        Raises:
            GibsonSimError: the topic does not exist, or has several types.
        """
        name = self.find_topic(topic)
        self.spin_until(_MORE_TYPES_S, lambda: len(self.known_topics()[name]) > 1)
        types = self.known_topics()[name]
        if len(types) > 1:
            raise GibsonSimError(f"topic {quoted(name)} has several types: {', '.join(types)}; only one can be shown")
        return name, types[0]

    def subscribe(self, topic: str, callback: Callable[[Any], None], *, raw: bool = False) -> tuple[str, str]:
        """Subscribes to a topic with a QoS that matches all publishers; returns its full name and type."""
        name, kind = self.type_of(topic)
        try:
            message_type = message_class(kind)
        except UNKNOWN as error:
            raise GibsonSimError(f"the message type {kind} is not installed in this environment") from error
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
        reliable = bool(offered) and all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
        latched = bool(offered) and all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
        profile = QoSProfile(
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self.create_subscription(message_type, name, callback, profile, raw=raw)
        return name, kind

    def call(self, name: str, kind: Any, request: Any) -> Any:
        """Returns the response of a service.

        Raises:
            GibsonSimError: no node offers the service, or it does not respond.
        """
        client = self.create_client(kind, name)
        if not self.spin_until(PATIENCE_S, client.service_is_ready):
            raise self.missing_service(client.srv_name, _type_name(kind))
        return self.response(client, request)

    def response(self, client: Any, request: Any) -> Any:
        """Returns the response of the service of a client; raises GibsonSimError if it does not respond."""
        future = client.call_async(request)
        if not self.spin_until(60.0, future.done):
            raise GibsonSimError(f"the service {quoted(client.srv_name)} did not respond within 60 s")
        return future.result()


def _type_name(kind: Any) -> str:
    """Returns the name of a service class, such as ``std_srvs/srv/Trigger``."""
    package, part, *_ = kind.__module__.split(".")
    return f"{package}/{part}/{kind.__name__}"


def _full_name(namespace: str, name: str) -> str:
    """Returns the full name of a node, such as ``/robot_1/driver``."""
    return f"{namespace.rstrip('/')}/{name}"


def _print_names(tool: Tool, names: Collection[str]) -> None:
    """Prints names, one per line.

    Raises:
        GibsonSimError: there is none, and no simulation runs.
    """
    if not names and not tool.simulation_runs():
        raise tool.missing_simulation()
    for name in names:
        _print(name)


def _with_types(names: Mapping[str, list[str]], types: bool) -> list[str]:
    """Returns the sorted names, each with its types on request."""
    return [f"{name} [{', '.join(kinds)}]" if types else name for name, kinds in sorted(names.items())]


def _print(text: str = "") -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _print_error(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


# Topics


def topic_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all topics, one per line."""
    tool.discover(PHYSICS, RENDER)
    is_alone = not tool.known_nodes()  # the topics are those of this node
    _print_names(tool, [] if is_alone else _with_types(tool.known_topics(), types))


def topic_info(tool: Tool, topic: str, verbose: bool = False) -> None:
    """Prints the type of a topic, and the numbers of its publishers and subscriptions."""
    name = tool.find_topic(topic)
    tool.discover(PHYSICS, RENDER)
    _print(f"Type: {', '.join(tool.known_topics()[name])}")
    for label, infos in (
        ("Publisher", tool.get_publishers_info_by_topic(name)),
        ("Subscription", tool.get_subscriptions_info_by_topic(name)),
    ):
        _print(f"{label} count: {len(infos)}")
        for info in infos if verbose else ():
            profile = info.qos_profile
            node = _full_name(info.node_namespace, info.node_name)
            _print(f"  node {node}: {profile.reliability.name}, {profile.durability.name}")


def topic_echo(tool: Tool, topic: str, once: bool = False, field: str = "", full: bool = False) -> int:
    """Prints messages as YAML, each followed by ``---``; returns 130 if Ctrl-C ends it before the first."""
    received: deque[Any] = deque()
    # rclpy inspects the signature, which ``deque.append`` does not have.
    name, _ = tool.subscribe(topic, lambda message: received.append(message))
    silence = _silence(tool, name)
    printed = False
    with suppress(KeyboardInterrupt):
        while not (once and printed):
            tool.spin_until(0.2, lambda: bool(received))
            if received:
                silence.end()
            silence.check(time.monotonic())
            while received and not (once and printed):
                message = received.popleft()
                _print((value_text(field_of(message, field), whole=full) if field else yaml_text(message, whole=full)) + "---")
                printed = True
    return 0 if printed else interrupts.INTERRUPTED


def _silence(tool: Tool, topic: str) -> SilenceNotice:
    """Returns the notice that reports on stderr, once, why no message arrives on a topic; stdout has messages only."""

    def reason() -> str:
        publishers = tool.count_publishers(topic)
        if not publishers:
            return f"waiting: no node publishes {topic}"
        return f"waiting: {publishers} publisher{'s' * (publishers != 1)} of {topic}, but no message yet"

    return SilenceNotice(tool, _print_error, reason, time.monotonic())


def _measure(tool: Tool, topic: str, samples: deque[Any], report: Callable[[], str], seconds: float) -> int:
    """Prints a report each second for ``seconds`` of wall time (0 = until Ctrl-C); returns the exit code.

    Args:
        tool: node that receives the messages.
        topic: full name of the topic.
        samples: one for each received message.
        report: returns the text to print; empty = there are too few samples.
        seconds: duration.

    Returns:
        1 without a report; 130 if Ctrl-C ends it before the duration, or before the first report.
    """
    silence = _silence(tool, topic)
    deadline = time.monotonic() + seconds if seconds else math.inf
    text = ""
    with suppress(KeyboardInterrupt):
        while time.monotonic() < deadline:
            tool.spin_until(1.0)
            if samples:
                silence.end()
            silence.check(time.monotonic())
            text = report()
            _print(text or f"no new messages on {topic}")
        return 0 if text else 1
    return 0 if text and not seconds else interrupts.INTERRUPTED


def _statistics(tool: Tool, topic: str, report: Callable[[deque[tuple[float, int]]], str], seconds: float) -> int:
    """Subscribes, and measures, see ``_measure``; ``report`` gets the arrival time (monotonic, s) and the size (bytes) of each message."""
    received: deque[tuple[float, int]] = deque(maxlen=_WINDOW)
    name, _ = tool.subscribe(topic, lambda data: received.append((time.monotonic(), len(data))), raw=True)
    return _measure(tool, name, received, lambda: report(received) if len(received) > 1 else "", seconds)


def topic_hz(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints the rate of a topic, by wall time, each second."""

    def report(received: deque[tuple[float, int]]) -> str:
        times = [arrival for arrival, *_ in received]
        gaps = [b - a for a, b in pairwise(times)]
        mean = statistics.fmean(gaps)
        return (
            f"average rate: {1.0 / mean:.3f}\n\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s "
            f"std dev: {statistics.pstdev(gaps):.5f}s window: {len(gaps)}"
        )

    return _statistics(tool, topic, report, seconds)


def topic_bw(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints the bandwidth of a topic, by wall time, each second."""

    def report(received: deque[tuple[float, int]]) -> str:
        sizes = [size for _, size in received]
        elapsed = max(1e-9, received[-1][0] - received[0][0])
        mean = statistics.fmean(sizes)
        return (
            f"{_bytes(sum(sizes[1:]) / elapsed)}/s from {len(sizes)} messages\n\tMessage size mean: {_bytes(mean)} "
            f"min: {_bytes(min(sizes))} max: {_bytes(max(sizes))}"
        )

    return _statistics(tool, topic, report, seconds)


def topic_delay(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints the delay of the messages of a topic against their stamps, in simulation time if there is a /clock."""
    clock: list[tuple[int, int]] = []
    if tool.spin_until(USUAL_DISCOVERY_S, lambda: "/clock" in tool.known_topics()):
        tool.subscribe("/clock", lambda data: clock.__setitem__(slice(None), [(stamp_ns(data), time.monotonic_ns())]), raw=True)
    delays: deque[float] = deque(maxlen=_WINDOW)
    name, kind = tool.type_of(topic)
    fields = message_class(kind).get_fields_and_field_types()
    if "header" not in fields:
        raise GibsonSimError(f"messages of {name} ({kind}) have no header, and so no stamp to compute a delay")

    def on_message(data: bytes) -> None:
        now = clock[0][0] + (time.monotonic_ns() - clock[0][1]) if clock else time.time_ns()
        delays.append((now - stamp_ns(data)) / NS_PER_S)

    def report() -> str:
        if not delays:
            return ""
        return (
            f"average delay: {statistics.fmean(delays):.3f}\n\tmin: {min(delays):.3f}s max: {max(delays):.3f}s "
            f"std dev: {statistics.pstdev(delays):.5f}s window: {len(delays)}"
        )

    tool.subscribe(topic, on_message, raw=True)
    return _measure(tool, name, delays, report, seconds)


def _bytes(number: float) -> str:
    for unit in ("B", "KB", "MB"):
        if number < 1000.0:
            return f"{number:.2f} {unit}"
        number /= 1000.0
    return f"{number:.2f} GB"


# Nodes


def node_list(tool: Tool) -> None:
    """Prints the full names of all nodes, one per line."""
    tool.discover(PHYSICS)
    _print_names(tool, tool.known_nodes())


def node_info(tool: Tool, node: str) -> None:
    """Prints the topics, services and actions of a node, with their types."""
    full_name = _node_name(node)
    if not tool.spin_until(PATIENCE_S, lambda: full_name in tool.known_nodes()):
        raise GibsonSimError(missing_node(full_name, tool.known_nodes(), tool.hint("node list")))
    tool.discover(PHYSICS, RENDER)
    namespace, _, name = full_name.rpartition("/")
    _print(full_name)
    for label, listed in (
        ("Subscribers", tool.get_subscriber_names_and_types_by_node(name, namespace or "/")),
        ("Publishers", tool.get_publisher_names_and_types_by_node(name, namespace or "/")),
        ("Service Servers", tool.get_service_names_and_types_by_node(name, namespace or "/")),
        ("Service Clients", tool.get_client_names_and_types_by_node(name, namespace or "/")),
        ("Action Servers", get_action_server_names_and_types_by_node(tool, name, namespace or "/")),
        ("Action Clients", get_action_client_names_and_types_by_node(tool, name, namespace or "/")),
    ):
        _print(f"  {label}:")
        for entry, kinds in sorted(listed):
            if not is_hidden(entry):
                _print(f"    {entry}: {', '.join(kinds)}")


# Services


def service_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all services, one per line."""
    tool.discover(PHYSICS)
    _print_names(tool, _with_types(tool.known_services(), types))


def service_type(tool: Tool, service: str) -> None:
    """Prints the type of a service."""
    name = tool.resolve_service_name(service)
    if not tool.spin_until(PATIENCE_S, lambda: name in tool.known_services()):
        raise tool.missing_service(name)
    _print("\n".join(tool.known_services()[name]))


def service_call(tool: Tool, service: str, type: str = "", values: str = "") -> int:
    """Calls a service with YAML values; returns 1 if its response reports a failure."""
    name = tool.resolve_service_name(service)
    type, values = type_and_values(type, values)
    parsed = _yaml(values)
    awaited = f"the service {quoted(name)}"
    if not type:
        if not tool.wait_for(awaited, lambda: name in tool.offered_services()):
            raise tool.missing_service(name)
        type, awaited = tool.known_services()[name][0], ""
    kind = _service_class(type)
    request = fill(kind.Request(), parsed)
    client = tool.create_client(kind, name)
    if not tool.wait_for(awaited, client.service_is_ready):
        raise tool.missing_service(name, type)
    _print(f"requester: making request: {request}\n")
    response = tool.response(client, request)
    _print("response:\n" + yaml_text(response, whole=True))
    result = getattr(response, "result", None)
    return 1 if getattr(response, "success", True) is False or getattr(result, "result", 1) not in (1, True) else 0


def _service_class(name: str) -> Any:
    from importlib import import_module

    try:
        package, kind, last = name.split("/")
        return getattr(import_module(f"{package}.{kind}"), last)
    except UNKNOWN as error:
        raise GibsonSimError(f"the type {quoted(name)} is not installed in this environment") from error


def _yaml(text: str) -> Any:
    try:
        return parse_yaml(text) if text else None
    except TextError as error:
        raise GibsonSimError(f"{quoted(text)} is not YAML: {error}") from error


# Parameters


def param_list(tool: Tool, node: str = "") -> None:
    """Prints the parameters of a node, or of all nodes."""
    if node:
        node_names = [_node_name(node)]
    else:
        tool.discover(PHYSICS, RENDER)  # a node that loads the scene does not respond
        node_names = _nodes_with_parameters(tool)
        if not node_names and not tool.simulation_runs():
            raise tool.missing_simulation()
    for node_name in node_names:
        _print(f"{node_name}:\n" + "\n".join(f"  {name}" for name in _parameters(tool, node_name)))


_LIST_SUFFIX = "/list_parameters"


def _nodes_with_parameters(tool: Tool) -> list[str]:
    """Returns the full names of the discovered nodes that have parameter services."""
    kind = "rcl_interfaces/srv/ListParameters"
    services = tool.offered_services().items()
    return sorted(name.removesuffix(_LIST_SUFFIX) for name, kinds in services if name.endswith(_LIST_SUFFIX) and kind in kinds)


def _parameters(tool: Tool, node_name: str) -> list[str]:
    """Returns the names of a node's parameters, sorted."""
    return sorted(tool.call(f"{node_name}{_LIST_SUFFIX}", ListParameters, ListParameters.Request()).result.names)


def _missing_parameter(tool: Tool, node: str, name: str) -> GibsonSimError:
    """Returns the error for a parameter that a node does not have: names the nodes that have it, or the most similar one."""
    tool.discover()
    others = [other for other in _nodes_with_parameters(tool) if name in _parameters(tool, other)]
    hint = f"; {', '.join(others)} has it" if others else ""
    if not hint and (similar := nearest(name, _parameters(tool, _node_name(node)))):
        hint = f"; {similar}"
    return GibsonSimError(f"node {_node_name(node)} has no parameter {quoted(name)}{hint or '; see `gibson-sim param list`'}")


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


def param_get(tool: Tool, node: str, name: str) -> None:
    """Prints the value of a parameter."""
    value = tool.call(f"{_node_name(node)}/get_parameters", GetParameters, GetParameters.Request(names=[name])).values[:1]
    if not value or value[0].type == ParameterType.PARAMETER_NOT_SET:
        raise _missing_parameter(tool, node, name)
    if value[0].type in _KINDS:
        label, attribute = _KINDS[value[0].type]
        _print(f"{label} value is: {getattr(value[0], attribute)}")
    else:
        label, attribute = _ARRAYS[value[0].type]
        _print(f"{label} values are: {list(getattr(value[0], attribute))}")


def param_set(tool: Tool, node: str, name: str, value: str) -> None:
    """Sets a parameter; the node refuses it if it cannot be changed at run time."""
    description = tool.call(
        f"{_node_name(node)}/describe_parameters", DescribeParameters, DescribeParameters.Request(names=[name])
    )
    declared = description.descriptors[0].type if description.descriptors else ParameterType.PARAMETER_NOT_SET
    parsed = _yaml(value)
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
    response = tool.call(f"{_node_name(node)}/set_parameters", SetParameters, SetParameters.Request(parameters=[message]))
    result = response.results[0]
    if not result.successful:
        if name not in _parameters(tool, _node_name(node)):
            raise _missing_parameter(tool, node, name)
        raise GibsonSimError(f"Setting parameter failed: {result.reason}")
    _print("Set parameter successful")


_PYTHON = {
    ParameterType.PARAMETER_BOOL: bool, ParameterType.PARAMETER_INTEGER: int, ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_STRING: str,
}  # fmt: skip


def _node_name(node: str) -> str:
    return node if node.startswith("/") else f"/{node}"


# Actions


def action_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all actions, one per line."""
    tool.discover(PHYSICS)
    _print_names(tool, _with_types(dict(get_action_names_and_types(tool)), types))


def action_send_goal(tool: Tool, action: str, type: str, values: str = "", feedback: bool = False) -> int:
    """Sends a goal, waits for its end, and prints its result; returns 1 if it did not succeed."""
    kind = _service_class(type)
    client = ActionClient(tool, kind, action)
    if not tool.wait_for(f"the action {quoted(action)}", client.server_is_ready):
        known = [name for name, _ in get_action_names_and_types(tool)]
        raise GibsonSimError(f"no node offers the action {quoted(action)}; {suggestion(action, known, tool.hint('action list'))}")
    goal = fill(kind.Goal(), _yaml(values))
    _print(f"Sending goal:\n{yaml_text(goal, whole=True)}")
    on_feedback = (lambda message: _print("Feedback:\n" + yaml_text(message.feedback))) if feedback else None
    acceptance = client.send_goal_async(goal, feedback_callback=on_feedback)
    tool.spin_until(60.0, acceptance.done)
    handle = acceptance.result() if acceptance.done() else None
    if handle is None or not handle.accepted:
        raise GibsonSimError(f"the goal was not accepted by {action}")
    future = handle.get_result_async()
    tool.spin_until(math.inf, future.done)
    result = future.result()
    _print(
        f"Result:\n{yaml_text(result.result, whole=True)}\nGoal finished with status: {_STATUS.get(result.status, result.status)}"
    )
    client.destroy()
    return 0 if result.status == 4 else 1


_STATUS = {4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}
_COMMANDS: dict[str, Callable[..., int | None]] = {
    "topic list": topic_list, "topic info": topic_info, "topic echo": topic_echo, "topic hz": topic_hz, "topic bw": topic_bw,
    "topic delay": topic_delay, "node list": node_list, "node info": node_info, "service list": service_list,
    "service type": service_type, "service call": service_call,
    "param list": param_list, "param get": param_get, "param set": param_set, "action list": action_list,
    "action send_goal": action_send_goal,
}  # fmt: skip


def main() -> None:
    """Executes the command in the JSON on the command line."""
    arguments = json.loads(sys.argv[1])
    try:
        run_node(lambda: Tool(arguments), [], interrupted=interrupts.INTERRUPTED)
    except SystemExit as end:
        if end.code == interrupts.INTERRUPTED:
            interrupts.die()
        raise


if __name__ == "__main__":
    main()
