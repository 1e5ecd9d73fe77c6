"""``gibson-sim topic``: list, type, info, echo, hz, bw, delay."""

from __future__ import annotations

import math
import statistics
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from typing import Any

from gibson_sim import interrupts
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.tools.hints import PHYSICS, RENDER
from gibson_sim.ros.tools.output import print_error, print_line, print_names, with_types, without_hidden
from gibson_sim.ros.tools.tool import USUAL_DISCOVERY_S, Tool, full_name
from gibson_sim.ros.tools.yaml_messages import field_of, value_text, yaml_text
from gibson_sim.ros.topics.silence import SilenceNotice
from gibson_sim.ros.wire.message_types import message_class
from gibson_sim.types import NS_PER_S

_WINDOW = 10_000
"""Number of messages in statistics, the newest ones, as in ``ros2 topic hz``."""


def topic_list(tool: Tool, types: bool = False, include_hidden_topics: bool = False) -> None:
    """Prints the names of all topics, one per line."""
    tool.discover(PHYSICS, RENDER)
    if not tool.known_nodes():
        topics = {}  # those of this node
    elif include_hidden_topics:
        topics = tool.known_topics()
    else:
        topics = without_hidden(tool.known_topics())
    print_names(tool, with_types(topics, types))


def topic_type(tool: Tool, topic: str) -> None:
    """Prints the types of a topic, one per line."""
    name = tool.find_topic(topic)
    print_line("\n".join(tool.known_topics()[name]))


def topic_info(tool: Tool, topic: str, verbose: bool = False) -> None:
    """Prints the type of a topic, and the numbers of its publishers and subscriptions."""
    name = tool.find_topic(topic)
    tool.discover(PHYSICS, RENDER)
    tool.discover_endpoints(name)
    print_line(f"Type: {', '.join(tool.known_topics()[name])}")
    for label, infos in (
        ("Publisher", tool.get_publishers_info_by_topic(name)),
        ("Subscription", tool.get_subscriptions_info_by_topic(name)),
    ):
        print_line(f"{label} count: {len(infos)}")
        for info in infos if verbose else ():
            profile = info.qos_profile
            node = full_name(info.node_namespace, info.node_name)
            print_line(f"  node {node}: {profile.reliability.name}, {profile.durability.name}")


def topic_echo(tool: Tool, topic: str, type: str = "", once: bool = False, field: str = "", full: bool = False) -> int:
    """Prints messages as YAML, each followed by ``---``; returns 130 if Ctrl-C ends it before the first."""
    received: deque[Any] = deque()
    # rclpy inspects the signature, which ``deque.append`` does not have.
    name, kind = tool.subscribe(topic, lambda message: received.append(message), kind=type)
    silence = _silence(tool, name, kind)
    printed = False
    with suppress(KeyboardInterrupt):
        while not (once and printed):
            tool.spin_until(0.2, lambda: bool(received))
            if received:
                silence.end()
            silence.check(time.monotonic())
            while received and not (once and printed):
                message = received.popleft()
                print_line(
                    (value_text(field_of(message, field), whole=full) if field else yaml_text(message, whole=full)) + "---"
                )
                printed = True
    return 0 if printed else interrupts.INTERRUPTED


def _silence(tool: Tool, topic: str, kind: str) -> SilenceNotice:
    """Returns the notice that reports on stderr, once, why no message of a type arrives on a topic; stdout has messages only."""

    def reason() -> str:
        types = [info.topic_type for info in tool.get_publishers_info_by_topic(topic)]
        count = types.count(kind)
        if count:
            return f"waiting: {count} publisher{'s' * (count != 1)} of {topic}, but no message yet"
        if types:
            return f"waiting: no node publishes {topic} as {kind}, only as {' and '.join(sorted(set(types)))}"
        return f"waiting: no node publishes {topic}"

    def by_simulation() -> bool:
        return any(info.node_name in (PHYSICS, RENDER) for info in tool.get_publishers_info_by_topic(topic))

    return SilenceNotice(tool, print_error, reason, tool.start_s, by_simulation)


def _measure(tool: Tool, topic: str, kind: str, samples: deque[Any], report: Callable[[], str], seconds: float) -> int:
    """Prints a report each second for ``seconds`` of wall time (0 = until Ctrl-C); returns the exit code.

    Args:
        tool: node that receives the messages.
        topic: full name of the topic.
        kind: its type.
        samples: one for each received message.
        report: returns the text to print; empty = there are too few samples.
        seconds: duration.

    Returns:
        1 without a report; 130 if Ctrl-C ends it before the duration, or before the first report.
    """
    silence = _silence(tool, topic, kind)
    deadline = time.monotonic() + seconds if seconds else math.inf
    text = ""
    with suppress(KeyboardInterrupt):
        while time.monotonic() < deadline:
            tool.spin_until(min(1.0, deadline - time.monotonic()))
            if samples:
                silence.end()
            silence.check(time.monotonic())
            text = report()
            print_line(text or f"no new messages on {topic}")
        return 0 if text else 1
    return 0 if text and not seconds else interrupts.INTERRUPTED


def _statistics(tool: Tool, topic: str, report: Callable[[deque[tuple[float, int]]], str], seconds: float) -> int:
    """Subscribes, and measures, see ``_measure``; ``report`` gets the arrival time (monotonic, s) and the size (bytes) of each message."""
    received: deque[tuple[float, int]] = deque(maxlen=_WINDOW)
    name, kind = tool.subscribe(topic, lambda data: received.append((time.monotonic(), len(data))), raw=True)
    return _measure(tool, name, kind, received, lambda: report(received) if len(received) > 1 else "", seconds)


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
    return _measure(tool, name, kind, delays, report, seconds)


def _bytes(number: float) -> str:
    for unit in ("B", "KB", "MB"):
        if number < 1000.0:
            return f"{number:.2f} {unit}"
        number /= 1000.0
    return f"{number:.2f} GB"
