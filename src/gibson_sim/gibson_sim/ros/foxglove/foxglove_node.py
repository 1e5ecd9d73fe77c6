"""The foxglove node: serves the topics, services and parameters of a ROS domain by the Foxglove WebSocket protocol."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.bags.stamps import stamp_ns
from gibson_sim.client_config import FoxgloveConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.foxglove.client_publishers import ClientPublishers
from gibson_sim.ros.foxglove.relayed_parameters import RelayedParameters
from gibson_sim.ros.foxglove.relayed_services import RelayedServices
from gibson_sim.ros.foxglove.relayed_topics import RelayedTopics
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.topics import names
from gibson_sim.web.foxglove_server import ClientTopic, FoxgloveServer
from gibson_sim.web.server import LOOPBACK

_GRAPH_PERIOD_S = 1.0
"""Period of the queries of the ROS graph, s of wall time."""
_CLOCK_PERIOD_S, _WALL_PERIOD_S = 0.02, 0.1
"""Periods at which clients receive simulation time, or wall time if there is no /clock, s of wall time."""


class FoxgloveNode(Node):
    """Serves the Foxglove WebSocket protocol, for any Foxglove client.

    Publishes:
        The messages of clients, if ``commands`` is set. If a client disconnects while it drives a robot, zero velocities are published.

    Subscribes:
        /clock; the topics that clients subscribe to; /parameter_events while a client subscribes to parameters.

    Services used: all services of the graph that clients call, if ``commands`` is set.

    Parameters: the fields of ``gibson_sim.client_config.FoxgloveConfig``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Starts the server. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GibsonSimError: a setting is invalid, or the server cannot listen on its address.
        """
        super().__init__("foxglove", **kwargs)
        self._config = config_from_parameters(self, FoxgloveConfig)
        self._calls: SimpleQueue[Callable[[], None]] = SimpleQueue()
        """Calls that the server's threads have scheduled in the node's thread."""
        self._clock_ns: int | None = None
        self._next_time = 0.0
        definitions = MessageDefinitions()
        self._server = FoxgloveServer(
            _Backend(self),
            self._config.host,
            self._config.port,
            commands=self._config.commands,
            name=f"ROS domain {self.context.get_domain_id()}",
        )
        self.relayed_topics = RelayedTopics(self, self._server, definitions, self._now_ns)
        self.relayed_services = RelayedServices(self, self._server, definitions)
        self.relayed_parameters = RelayedParameters(self, self._server)
        self.publishers_of_clients = ClientPublishers(self)
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(Clock, names.CLOCK, self._on_clock, newest, raw=True)
        for line in opening_lines(self._server.url, self._config):
            print(line, file=sys.stderr, flush=True)

    def spin(self) -> int:
        """Serves until the end of the process is requested; returns the exit code."""
        executor = make_executor()
        executor.add_node(self)
        next_update = 0.0
        while is_running():
            executor.spin_once(timeout_sec=0.02)
            while not self._calls.empty():
                self._calls.get()()
            now = time.monotonic()
            if self._clock_ns is None and now >= self._next_time:
                self._next_time = now + _WALL_PERIOD_S
                self._server.send_time(self._now_ns())
            if now >= next_update:
                next_update = now + _GRAPH_PERIOD_S
                self._update()
        return 0

    def close(self) -> None:
        """Ends the server; robots that clients drive are stopped."""
        self.publishers_of_clients.close()
        self.relayed_services.close()
        self._server.close()

    def call_soon(self, function: Callable[[], None]) -> None:
        """Schedules a call in the node's thread; thread-safe. Clients are shown the GibsonSimErrors that it raises."""
        self._calls.put(partial(self._guarded, function))

    def _guarded(self, function: Callable[[], None]) -> None:
        try:
            function()
        except GibsonSimError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            self._server.warn(str(error))

    def _update(self) -> None:
        """Updates the offered topics and services from the ROS graph."""
        if self._clock_ns is not None and not self.count_publishers(names.CLOCK):
            self._clock_ns = None
            self._server.new_session()
        self.relayed_topics.update()
        if self._config.commands:
            self.relayed_services.update()
        self.publishers_of_clients.clean_up()

    def _now_ns(self) -> int:
        """Returns simulation time if there is a /clock, otherwise wall time, ns."""
        return self.get_clock().now().nanoseconds if self._clock_ns is None else self._clock_ns

    def _on_clock(self, data: bytes) -> None:
        is_first = self._clock_ns is None
        self._clock_ns = stamp_ns(data)
        if is_first:
            self._server.new_session()
        now = time.monotonic()
        if is_first or now >= self._next_time:
            self._next_time = now + _CLOCK_PERIOD_S
            self._server.send_time(self._clock_ns)


class _Backend:
    """Forwards requests of clients to the node's thread."""

    def __init__(self, node: FoxgloveNode) -> None:
        self._node = node

    def subscribed(self, topic: str) -> None:
        self._node.call_soon(lambda: self._node.relayed_topics.subscribe(topic))

    def unsubscribed(self, topic: str) -> None:
        self._node.call_soon(lambda: self._node.relayed_topics.unsubscribe(topic))

    def advertised(self, topic: ClientTopic) -> None:
        self._node.call_soon(lambda: self._node.publishers_of_clients.advertise(topic))

    def unadvertised(self, key: tuple[int, int]) -> None:
        self._node.call_soon(lambda: self._node.publishers_of_clients.unadvertise(key))

    def received(self, key: tuple[int, int], data: bytes) -> None:
        self._node.call_soon(lambda: self._node.publishers_of_clients.publish(key, data))

    def call(self, service: str, request: bytes) -> Future[bytes]:
        answer: Future[bytes] = Future()
        self._node.call_soon(lambda: self._node.relayed_services.call(service, request, answer))
        return answer

    def get_parameters(self, names: list[str]) -> Future[dict[str, Any]]:
        answer: Future[dict[str, Any]] = Future()
        self._node.call_soon(lambda: self._node.relayed_parameters.get(names, answer))
        return answer

    def set_parameters(self, values: dict[str, Any]) -> Future[dict[str, Any]]:
        answer: Future[dict[str, Any]] = Future()
        self._node.call_soon(lambda: self._node.relayed_parameters.set(values, answer))
        return answer

    def watch_parameters(self, watched: bool) -> None:
        self._node.call_soon(lambda: self._node.relayed_parameters.watch(watched))


def opening_lines(url: str, config: FoxgloveConfig) -> list[str]:
    """Returns the lines that are printed at the start: the address, and who has access."""
    rights = "read and command everything" if config.commands else "read everything"
    instructions = f"open https://app.foxglove.dev or the desktop app, `Open connection`, `Foxglove WebSocket`, {url}"
    if config.host in LOOPBACK:
        access = f"every program of this machine, and every web page in a browser on it, can {rights}"
        return [f"foxglove: {url} ({access}: the protocol has no password)", f"foxglove: {instructions}"]
    advice = "" if config.commands is False else "; `--no-commands` makes access read-only"
    return [
        f"foxglove: {url}",
        f"foxglove: {instructions}",
        f"warning: every machine that reaches {config.host} port {url.rpartition(':')[2]} can {rights}: the protocol has no password{advice}",
    ]


def main(args: list[str] | None = None) -> None:
    """Runs the foxglove node."""
    run_node(FoxgloveNode, args)


if __name__ == "__main__":
    main()
