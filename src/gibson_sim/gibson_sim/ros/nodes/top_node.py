"""The top node: shows the diagnostics of all nodes of a running simulation on the terminal, once a second."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node
from gibson_sim.ros.nodes.top_view import Overview, Status, TopicRate, render
from gibson_sim.ros.nodes.wait_for_simulation import start_hint
from gibson_sim.ros.topics import names
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.types import NS_PER_S

NO_SIMULATION = 3
"""Exit code if no simulation runs."""
_ALL = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Profile that matches every publisher, and never blocks one."""
_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass
class _TopicCount:
    """Number and size of the messages on a topic since the last overview."""

    kind: str
    subscription: Any = None
    messages: int = 0
    size: int = 0
    """Size of all messages, bytes."""


@dataclass
class _Times:
    """Wall time (monotonic) and simulation time of an instant, ns."""

    wall_ns: int = field(default_factory=time.monotonic_ns)
    sim_ns: int | None = None


class TopNode(Node):
    """Collects diagnostics, simulation time and the rates of topics.

    Subscribes:
        /diagnostics (diagnostic_msgs/DiagnosticArray): from all nodes, with any keys.
        /clock (rosgraph_msgs/Clock): serialized.
        all topics, serialized, if their rates are requested. Publishers that publish on demand then publish for this node, too.
    """

    def __init__(self, topics: bool, options: Mapping[str, Any] | None = None) -> None:
        """Creates the subscriptions.

        Args:
            topics: whether to measure the rates of all topics.
            options: arguments of ``watch``, for ``spin``.
        """
        super().__init__("top", start_parameter_services=False)
        self._options = options or {}
        self._executor: Executor | None = None
        self._statuses: dict[str, tuple[Status, int]] = {}
        self._sources: set[frozenset[str]] = set()
        self._stamp_ns: int | None = None
        self._counts: dict[str, _TopicCount] | None = {} if topics else None
        self._begin = _Times()
        """Start of the period."""
        self._first: _Times | None = None
        """Times of the first /clock, which may arrive within a period; None = none has arrived."""
        self.create_subscription(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, _ALL)
        self.create_subscription(Clock, names.CLOCK, self._on_clock, _NEWEST, raw=True)

    def spin(self) -> int:
        """Shows the overviews; returns the exit code."""
        self._executor = make_executor()
        self._executor.add_node(self)
        try:
            return watch(self, self._executor, **self._options)
        except BrokenPipeError:  # `gibson-sim top | head`
            sys.stderr.close()
            return 0

    def close(self) -> None:
        """Shuts the executor down."""
        if self._executor is not None:
            self._executor.shutdown()

    def simulation_runs(self) -> bool:
        """Returns whether /clock has a publisher in this domain."""
        return bool(self.count_publishers(names.CLOCK))

    def has_all_reports(self) -> bool:
        """Returns whether all publishers of /diagnostics have reported; the names of their statuses distinguish them."""
        return 0 < self.count_publishers(names.DIAGNOSTICS) <= len(self._sources)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        now = time.monotonic_ns()
        self._sources.add(frozenset(status.name for status in msg.status))
        for status in msg.status:
            values = tuple((pair.key, pair.value) for pair in status.values)
            # The message field is one byte long.
            level = int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)
            self._statuses[status.name] = (Status(status.name, level, status.message, values, 0.0), now)

    def _on_clock(self, data: bytes) -> None:
        self._stamp_ns = stamp_ns(data)
        if self._first is None:
            self._first = _Times(sim_ns=self._stamp_ns)

    def subscribe_to_new_topics(self) -> None:
        """Subscribes to new topics, if their rates are requested."""
        if self._counts is None:
            return
        for name, kinds in self.get_topic_names_and_types():
            if name in self._counts or len(kinds) != 1 or not self.count_publishers(name):
                continue
            count = self._counts[name] = _TopicCount(kinds[0])
            try:
                kind = message_class(kinds[0])
            except UNKNOWN:
                continue  # the package of the type is not installed: the topic is listed without a rate
            count.subscription = self.create_subscription(kind, name, partial(_add, count), _ALL, raw=True)

    def next_overview(self) -> Overview:
        """Returns the overview of the period that ends now, and starts the next period."""
        now = time.monotonic_ns()
        wall_s = (now - self._begin.wall_ns) / NS_PER_S
        sim_s = 0.0
        begin = self._first if self._begin.sim_ns is None else self._begin
        if self._stamp_ns is not None and begin is not None and begin.sim_ns is not None:
            # Extrapolated to the whole period if the first /clock arrived within it.
            sim_s = wall_s * max(0, self._stamp_ns - begin.sim_ns) / max(1, now - begin.wall_ns)
        statuses = tuple(Status(s.name, s.level, s.message, s.values, (now - at) / NS_PER_S) for s, at in self._statuses.values())
        topics = None
        if self._counts is not None:
            topics = tuple(
                TopicRate(name, c.kind, c.messages, c.size, self.count_subscribers(name) - (c.subscription is not None))
                for name, c in self._counts.items()
            )
            for count in self._counts.values():
                count.messages = count.size = 0
        self._begin = _Times(now, self._stamp_ns)
        nodes = len(self.get_node_names()) - 1
        return Overview(self.context.get_domain_id(), self._stamp_ns, wall_s, sim_s, nodes, statuses, topics)


def _add(count: _TopicCount, data: bytes) -> None:
    count.messages += 1
    count.size += len(data)


def watch(node: TopNode, executor: Executor, *, once: bool, patience_s: float, period_s: float) -> int:
    """Shows overviews until the context ends, or one; returns the exit code.

    Args:
        node: node that collects the data.
        executor: executor of the node.
        once: show one overview only.
        patience_s: time without a simulation after which it gives up, s of wall time.
        period_s: period of the overviews, s of wall time.
    """
    last_seen = time.monotonic()
    while not node.simulation_runs():
        if time.monotonic() - last_seen > patience_s:
            return _no_simulation(node, patience_s)
        _spin_for(executor, 0.1)
    deadline = time.monotonic() + patience_s
    node.subscribe_to_new_topics()
    node.next_overview()
    last_seen = time.monotonic()
    while is_running():
        _spin_for(executor, period_s)
        while once and is_running() and not node.has_all_reports() and time.monotonic() < deadline:
            _spin_for(executor, 0.1)
        if node.simulation_runs():
            last_seen = time.monotonic()
        elif time.monotonic() - last_seen > patience_s:
            return _no_simulation(node, patience_s)
        _show(node.next_overview(), live=not once)
        if once:
            return 0
        node.subscribe_to_new_topics()
    return 0


def _no_simulation(node: TopNode, patience_s: float) -> int:
    domain = node.context.get_domain_id()
    sys.stderr.write(
        f"no simulation runs in ROS domain {domain}: {names.CLOCK} had no publisher for {patience_s:g} s. "
        f"Start one with {start_hint()}\n"
    )
    return NO_SIMULATION


def _spin_for(executor: Executor, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while (remaining := deadline - time.monotonic()) > 0 and is_running():
        executor.spin_once(timeout_sec=remaining)


def _show(overview: Overview, *, live: bool) -> None:
    terminal = sys.stdout.isatty()
    color = terminal and "NO_COLOR" not in os.environ
    width = shutil.get_terminal_size((100, 24)).columns
    clear = "\x1b[H\x1b[J" if live and terminal else ""
    end = "\n" if terminal or not live else "\n\n"
    sys.stdout.write(clear + render(overview, width=width, color=color) + end)
    sys.stdout.flush()


def main() -> None:
    """Runs the top node with the options in the JSON on the command line: ``once``, ``topics``, ``patience_s``, ``period_s``."""
    options = json.loads(sys.argv[1])
    run_node(lambda: TopNode(options.pop("topics"), options), [])


if __name__ == "__main__":
    main()
