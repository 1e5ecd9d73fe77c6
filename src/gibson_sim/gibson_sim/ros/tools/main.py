"""The program behind ``gibson-sim topic``, ``service``, ``param`` and ``action``: one command, told by JSON, with the outputs of ``ros2``."""

from __future__ import annotations

import json
import math
import statistics
import sys
import time
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.action.graph import get_action_names_and_types
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import parse_yaml
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node
from gibson_sim.ros.nodes.wait_for_simulation import start_hint
from gibson_sim.ros.tools.hints import check_name, missing_service, no_simulation, simulation_runs, suggestion, type_and_values
from gibson_sim.ros.tools.yaml_messages import field_of, fill, value_text, yaml_text
from gibson_sim.ros.topics.silence import SilenceNotice
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.types import NS_PER_S

DISCOVERY_S = 1.5
"""Wall time in which the nodes of a domain are discovered, s."""
_LATE_DISCOVERY_S = 15.0
"""The same on a busy machine, where a participant's announcement is lost and comes again after seconds, s."""
PATIENCE_S = 5.0
"""Wall time for a name to appear, and for a service to answer, s."""
_MORE_TYPES_S = 0.3
"""Wall time in which a topic that is known may show that it has a second type, s."""
_WINDOW = 10_000
"""Messages that statistics are made of, as in ``ros2 topic hz``."""


class Tool(Node):
    """One command. The graph must be known before it can be answered, so it waits for discovery."""

    def __init__(self, words: dict[str, Any]) -> None:
        """``words``: ``command``, such as "topic echo", and its arguments."""
        super().__init__("gibson_sim_tool", start_parameter_services=False)
        self._words = words
        self._executor = make_executor()
        self._executor.add_node(self)

    def spin(self) -> int:
        """Does what was asked for; returns the exit code."""
        from gibson_sim.ros.tools.verbs import VERBS

        command = self._words.pop("command")
        if command == "names":
            from gibson_sim.ros.tools.known_names import known_names

            _say(known_names(self))
            return 0
        if command in VERBS:
            _say(VERBS[command](self, **self._words))
            return 0
        for what in ("topic", "service", "action", "node"):
            if name := self._words.get(what):
                check_name(what, name)
        return int(_COMMANDS[command](self, **self._words) or 0)

    def close(self) -> None:
        """Ends the executor."""
        self._executor.shutdown()

    def work(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Works for some wall time, or until a condition holds; returns whether it does."""
        deadline = time.monotonic() + seconds
        while is_running() and not until() and (left := deadline - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, 0.05))
        return until()

    def discover(self) -> None:
        """Works until the nodes of the domain are discovered: for ``DISCOVERY_S``, and longer while it knows a simulation in part."""
        self.work(DISCOVERY_S)
        names = *self.get_node_names(), *self.known_services()
        if any(name.lstrip("/").startswith("physics") for name in names) and not simulation_runs(self.offered_services()):
            self.work(_LATE_DISCOVERY_S, lambda: simulation_runs(self.offered_services()))
            self.work(_MORE_TYPES_S)

    def known_topics(self) -> dict[str, list[str]]:
        """Returns topic -> types of the graph."""
        return dict(self.get_topic_names_and_types())

    def known_services(self) -> dict[str, list[str]]:
        """Returns service -> types of the graph."""
        return dict(self.get_service_names_and_types())

    def offered_services(self) -> dict[str, list[str]]:
        """Returns service -> types of those that a node offers; the graph also has those that are only called, by this node, too."""
        return {name: types for name, types in self.known_services().items() if self.count_services(name)}

    def missing_service(self, name: str, kind: str = "") -> GibsonSimError:
        """Returns the error for a service, by its full name, that nothing offers; ``kind``: its type, if it is known."""
        offered = self.offered_services()
        return GibsonSimError(missing_service(name, kind, offered, domain=self.context.get_domain_id(), start=start_hint()))

    def _topic_hint(self) -> str:
        """Returns what to do where no topic has a similar name."""
        if simulation_runs(self.offered_services()):
            return "see `gibson-sim topic list`"
        return no_simulation(self.context.get_domain_id(), start_hint())

    def type_of(self, topic: str) -> tuple[str, str]:
        """Returns the full name and the type of a topic.

        Raises:
            GibsonSimError: there is none, or it has several types.
        """
        name = self.resolve_topic_name(topic)
        if not self.work(PATIENCE_S, lambda: name in self.known_topics()):
            hint = suggestion(name, self.known_topics(), self._topic_hint())
            raise GibsonSimError(f"topic {quoted(name)} has no publisher and no subscriber; {hint}")
        self.work(_MORE_TYPES_S, lambda: len(self.known_topics()[name]) > 1)
        types = self.known_topics()[name]
        if len(types) > 1:
            raise GibsonSimError(f"topic {quoted(name)} has several types: {', '.join(types)}; only one can be shown")
        return name, types[0]

    def subscribe(self, topic: str, callback: Callable[[Any], None], *, raw: bool = False) -> tuple[str, str]:
        """Subscribes with a quality of service that matches all publishers; returns the full name and the type."""
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
            GibsonSimError: nothing offers it, or it does not answer.
        """
        client = self.create_client(kind, name)
        if not self.work(PATIENCE_S, client.service_is_ready):
            raise self.missing_service(self.resolve_service_name(name), _type_name(kind))
        future = client.call_async(request)
        if not self.work(60.0, future.done):
            raise GibsonSimError(f"the service {quoted(client.srv_name)} did not answer within 60 s")
        return future.result()


def _type_name(kind: Any) -> str:
    """Returns ``std_srvs/srv/Trigger`` of a class."""
    package, part, *_ = kind.__module__.split(".")
    return f"{package}/{part}/{kind.__name__}"


def _say(text: str = "") -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _say_aside(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


# Topics


def topic_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all topics, one a line."""
    tool.discover()
    for name, kinds in sorted(tool.known_topics().items()):
        _say(f"{name} [{', '.join(kinds)}]" if types else name)


def topic_info(tool: Tool, topic: str, verbose: bool = False) -> None:
    """Prints the type of a topic, and how many publish and subscribe."""
    tool.discover()
    name = tool.resolve_topic_name(topic)
    if not tool.work(PATIENCE_S, lambda: name in tool.known_topics()):
        tool.type_of(topic)
    _say(f"Type: {', '.join(tool.known_topics()[name])}")
    for what, infos in (
        ("Publisher", tool.get_publishers_info_by_topic(name)),
        ("Subscription", tool.get_subscriptions_info_by_topic(name)),
    ):
        _say(f"{what} count: {len(infos)}")
        for info in infos if verbose else ():
            profile = info.qos_profile
            _say(
                f"  node {info.node_namespace.rstrip('/')}/{info.node_name}: {profile.reliability.name}, {profile.durability.name}"
            )


def topic_echo(tool: Tool, topic: str, once: bool = False, field: str = "", full: bool = False) -> None:
    """Prints messages as YAML, each followed by ``---``."""
    got: deque[Any] = deque()
    # rclpy reads the signature, which a method of deque has not.
    name, _ = tool.subscribe(topic, lambda message: got.append(message))
    silence = _silence(tool, name)
    while is_running():
        tool.work(0.2, lambda: bool(got))
        if got:
            silence.end()
        silence.check(time.monotonic())
        while got:
            message = got.popleft()
            _say((value_text(field_of(message, field), whole=full) if field else yaml_text(message, whole=full)) + "---")
            if once:
                return


def _silence(tool: Tool, topic: str) -> SilenceNotice:
    """Returns what tells on stderr, once, why no message comes on a topic; stdout is for messages alone."""

    def reason() -> str:
        publishers = tool.count_publishers(topic)
        if not publishers:
            return f"waiting: no node publishes {topic}"
        return f"waiting: {publishers} publisher{'s' * (publishers != 1)} of {topic}, but no message yet"

    return SilenceNotice(tool, _say_aside, reason, time.monotonic())


def _statistics(tool: Tool, topic: str, report: Callable[[deque[tuple[float, int, int]]], str], seconds: float) -> int:
    """Subscribes, and prints a report each second; returns 1 if nothing came within ``seconds`` (0 = until Ctrl-C)."""
    got: deque[tuple[float, int, int]] = deque(maxlen=_WINDOW)

    def on_message(data: bytes) -> None:
        got.append((time.monotonic(), len(data), time.time_ns()))

    name, _ = tool.subscribe(topic, on_message, raw=True)
    silence = _silence(tool, name)
    ends = time.monotonic() + seconds if seconds else math.inf
    while is_running() and time.monotonic() < ends:
        tool.work(1.0)
        if got:
            silence.end()
        silence.check(time.monotonic())
        _say(report(got) if len(got) > 1 else f"no new messages on {name}")
    return 0 if len(got) > 1 else 1


def topic_hz(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints the rate of a topic each second, by wall time."""

    def report(got: deque[tuple[float, int, int]]) -> str:
        times = [at for at, *_ in got]
        gaps = [b - a for a, b in pairwise(times)]
        mean = statistics.fmean(gaps)
        return (
            f"average rate: {1.0 / mean:.3f}\n\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s "
            f"std dev: {statistics.pstdev(gaps):.5f}s window: {len(gaps)}"
        )

    return _statistics(tool, topic, report, seconds)


def topic_bw(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints the bandwidth of a topic each second, by wall time."""

    def report(got: deque[tuple[float, int, int]]) -> str:
        sizes = [size for _, size, _ in got]
        passed = max(1e-9, got[-1][0] - got[0][0])
        mean = statistics.fmean(sizes)
        return (
            f"{_bytes(sum(sizes[1:]) / passed)}/s from {len(sizes)} messages\n\tMessage size mean: {_bytes(mean)} "
            f"min: {_bytes(min(sizes))} max: {_bytes(max(sizes))}"
        )

    return _statistics(tool, topic, report, seconds)


def topic_delay(tool: Tool, topic: str, seconds: float = 0.0) -> int:
    """Prints how late the messages of a topic are by their stamps, in the time of the simulation where there is one."""
    clock: list[tuple[int, int]] = []
    if tool.work(DISCOVERY_S, lambda: "/clock" in tool.known_topics()):
        tool.subscribe("/clock", lambda data: clock.__setitem__(slice(None), [(stamp_ns(data), time.monotonic_ns())]), raw=True)
    late: deque[float] = deque(maxlen=_WINDOW)
    name, kind = tool.type_of(topic)
    fields = message_class(kind).get_fields_and_field_types()
    if "header" not in fields:
        raise GibsonSimError(f"messages of {name} ({kind}) have no header, so no stamp that could be late")

    def on_message(data: bytes) -> None:
        now = clock[0][0] + (time.monotonic_ns() - clock[0][1]) if clock else time.time_ns()
        late.append((now - stamp_ns(data)) / NS_PER_S)

    tool.subscribe(topic, on_message, raw=True)
    silence = _silence(tool, name)
    ends = time.monotonic() + seconds if seconds else math.inf
    while is_running() and time.monotonic() < ends:
        tool.work(1.0)
        if late:
            silence.end()
        silence.check(time.monotonic())
        if late:
            _say(
                f"average delay: {statistics.fmean(late):.3f}\n\tmin: {min(late):.3f}s max: {max(late):.3f}s "
                f"std dev: {statistics.pstdev(late):.5f}s window: {len(late)}"
            )
        else:
            _say(f"no new messages on {name}")
    return 0 if late else 1


def _bytes(number: float) -> str:
    for unit in ("B", "KB", "MB"):
        if number < 1000.0:
            return f"{number:.2f} {unit}"
        number /= 1000.0
    return f"{number:.2f} GB"


# Services


def service_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all services, one a line."""
    tool.discover()
    for name, kinds in sorted(tool.known_services().items()):
        _say(f"{name} [{', '.join(kinds)}]" if types else name)


def service_type(tool: Tool, service: str) -> None:
    """Prints the type of a service."""
    name = tool.resolve_service_name(service)
    if not tool.work(PATIENCE_S, lambda: name in tool.known_services()):
        raise tool.missing_service(name)
    _say("\n".join(tool.known_services()[name]))


def service_call(tool: Tool, service: str, type: str = "", values: str = "") -> int:
    """Calls a service with YAML values; returns 1 where its result says that it failed."""
    name = tool.resolve_service_name(service)
    type, values = type_and_values(type, values)
    if not type:
        if not tool.work(PATIENCE_S, lambda: name in tool.known_services()):
            raise tool.missing_service(name)
        type = tool.known_services()[name][0]
    kind = _service_class(type)
    request = fill(kind.Request(), _yaml(values))
    _say(f"requester: making request: {request}\n")
    response = tool.call(service, kind, request)
    _say("response:\n" + yaml_text(response, whole=True))
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
        raise GibsonSimError(f"{quoted(text)} is no YAML: {error}") from error


# Parameters


def param_list(tool: Tool, node: str = "") -> None:
    """Prints the parameters of a node, or of all nodes."""
    tool.discover()
    ending = "/list_parameters"
    found = sorted(
        name.removesuffix(ending) for name, kinds in tool.known_services().items() if name.endswith(ending) and _LIST in kinds
    )
    for each in [_node_name(node)] if node else found:
        names = tool.call(f"{each}{ending}", ListParameters, ListParameters.Request()).result.names
        _say(f"{each}:\n" + "\n".join(f"  {name}" for name in sorted(names)))


_LIST = "rcl_interfaces/srv/ListParameters"
_KINDS = {
    ParameterType.PARAMETER_BOOL: ("Boolean", "bool_value"), ParameterType.PARAMETER_INTEGER: ("Integer", "integer_value"),
    ParameterType.PARAMETER_DOUBLE: ("Double", "double_value"), ParameterType.PARAMETER_STRING: ("String", "string_value"),
}  # fmt: skip


def param_get(tool: Tool, node: str, name: str) -> None:
    """Prints the value of a parameter."""
    value = tool.call(f"{_node_name(node)}/get_parameters", GetParameters, GetParameters.Request(names=[name])).values[:1]
    if not value or value[0].type not in _KINDS:
        raise GibsonSimError(
            f"node {_node_name(node)} has no parameter {quoted(name)} with a plain value; see `gibson-sim param list`"
        )
    label, attribute = _KINDS[value[0].type]
    _say(f"{label} value is: {getattr(value[0], attribute)}")


def param_set(tool: Tool, node: str, name: str, value: str) -> None:
    """Sets a parameter; the node says whether it may be changed while it runs."""
    described = tool.call(f"{_node_name(node)}/describe_parameters", DescribeParameters, DescribeParameters.Request(names=[name]))
    known = described.descriptors[0].type if described.descriptors else ParameterType.PARAMETER_NOT_SET
    given = _yaml(value)
    kind = known if known in _KINDS else next((k for k, t in _PYTHON.items() if type(given) is t), ParameterType.PARAMETER_STRING)
    if kind == ParameterType.PARAMETER_STRING:
        given = value
    elif kind == ParameterType.PARAMETER_DOUBLE and isinstance(given, int):
        given = float(given)
    if type(given) is not _PYTHON[kind]:
        raise GibsonSimError(f"parameter {quoted(name)} is {quoted(value)}, must be a value of type {_KINDS[kind][0].lower()}")
    message = ParameterMessage(name=name, value=ParameterValue(type=kind, **{_KINDS[kind][1]: given}))
    response = tool.call(f"{_node_name(node)}/set_parameters", SetParameters, SetParameters.Request(parameters=[message]))
    result = response.results[0]
    if not result.successful:
        raise GibsonSimError(f"Setting parameter failed: {result.reason}")
    _say("Set parameter successful")


_PYTHON = {
    ParameterType.PARAMETER_BOOL: bool, ParameterType.PARAMETER_INTEGER: int, ParameterType.PARAMETER_DOUBLE: float,
    ParameterType.PARAMETER_STRING: str,
}  # fmt: skip


def _node_name(node: str) -> str:
    return node if node.startswith("/") else f"/{node}"


# Actions


def action_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all actions, one a line."""
    tool.discover()
    for name, kinds in sorted(get_action_names_and_types(tool)):
        _say(f"{name} [{', '.join(kinds)}]" if types else name)


def action_send_goal(tool: Tool, action: str, type: str, values: str = "", feedback: bool = False) -> int:
    """Sends a goal, waits for its end, and prints its result; returns 1 where it did not succeed."""
    kind = _service_class(type)
    client = ActionClient(tool, kind, action)
    if not tool.work(PATIENCE_S, client.server_is_ready):
        raise GibsonSimError(f"nothing offers the action {quoted(action)}; see `gibson-sim action list`")
    goal = fill(kind.Goal(), _yaml(values))
    _say(f"Sending goal:\n{yaml_text(goal, whole=True)}")
    told = (lambda message: _say("Feedback:\n" + yaml_text(message.feedback))) if feedback else None
    sent = client.send_goal_async(goal, feedback_callback=told)
    tool.work(60.0, sent.done)
    handle = sent.result() if sent.done() else None
    if handle is None or not handle.accepted:
        raise GibsonSimError(f"the goal was not accepted by {action}")
    done = handle.get_result_async()
    while is_running() and not tool.work(1.0, done.done):
        pass
    if not done.done():
        return 130
    result = done.result()
    _say(
        f"Result:\n{yaml_text(result.result, whole=True)}\nGoal finished with status: {_STATUS.get(result.status, result.status)}"
    )
    client.destroy()
    return 0 if result.status == 4 else 1


_STATUS = {4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}
_COMMANDS: dict[str, Callable[..., int | None]] = {
    "topic list": topic_list, "topic info": topic_info, "topic echo": topic_echo, "topic hz": topic_hz, "topic bw": topic_bw,
    "topic delay": topic_delay, "service list": service_list, "service type": service_type, "service call": service_call,
    "param list": param_list, "param get": param_get, "param set": param_set, "action list": action_list,
    "action send_goal": action_send_goal,
}  # fmt: skip


def main() -> None:
    """Does the command in the JSON on the command line."""
    words = json.loads(sys.argv[1])
    run_node(lambda: Tool(words), [])


if __name__ == "__main__":
    main()
