"""The node that executes a command, and what it discovers of its ROS domain."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node, NodeNameNonExistentError
from rclpy.parameter import Parameter

from gibson_sim.errors import GibsonSimError
from gibson_sim.processes.domain_lock import is_held
from gibson_sim.quoting import quoted
from gibson_sim.ros.client.simulation_client import Awaited, SimulationClient
from gibson_sim.ros.nodes.node_main import is_running, make_executor
from gibson_sim.ros.nodes.wait_for_simulation import start_hint
from gibson_sim.ros.tools.hints import PHYSICS, RENDER, loading_nodes, missing_service, no_simulation, simulation_runs, suggestion
from gibson_sim.ros.tools.output import print_error
from gibson_sim.ros.tools.subscription import AdaptiveSubscription
from gibson_sim.ros.topics.discovery import DISCOVERY_S
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class, type_name_of

USUAL_DISCOVERY_S = 1.5
"""Time in which the nodes of a domain are usually discovered, s of wall time; if no packet is lost, see ``DISCOVERY_S``."""
_LOADING_S = 30.0
"""Timeout for a simulation that is starting: its nodes are discovered and load the scene, s of wall time."""
PATIENCE_S = 5.0
"""Timeout for the discovery of a name, s of wall time."""
_RESPONSE_S = 60.0
"""Timeout for the response of a service, s of wall time."""
_MORE_TYPES_S = 0.3
"""Time in which a discovered topic may turn out to have a second type, and the last names of a loaded node arrive, s of wall time."""
_SETTLED_S = 0.5
"""Time without a new publisher or subscription after which the discovery of a topic counts as complete, s of wall time."""
LIST_PARAMETERS = "/list_parameters"
"""End of the name of a service that each node with parameters offers."""


class Tool(Node):
    """A node that executes one command, after it has waited for discovery."""

    def __init__(self, execute: Callable[[Tool], int]) -> None:
        """Creates the node; ``execute`` executes the command, and returns the exit code."""
        # A name that begins with _ is hidden, as that of ros2; the node offers no service, which lists would contain.
        super().__init__(
            "_gibson_sim_tool",
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._execute = execute
        self.start_s = time.monotonic()
        """Wall time at which discovery began, s (monotonic)."""
        self.client = SimulationClient(self, self._wait_for_call)
        """Client of the services of all nodes."""
        self._executor = make_executor()
        self._executor.add_node(self)

    def spin(self) -> int:
        """Executes the command; returns the exit code."""
        try:
            return self._execute(self)
        except BrokenPipeError:  # `gibson-sim topic list | head`
            sys.stderr.close()
            return 0

    def close(self) -> None:
        """Shuts the executor down."""
        self._executor.shutdown()

    def spin_until(self, timeout_s: float, condition: Callable[[], bool] = lambda: False) -> bool:
        """Spins until a condition holds, or for ``timeout_s`` of wall time; returns whether the condition holds.

        Raises:
            KeyboardInterrupt: the end of the process is requested; what is known until then is not a result.
        """
        return self._spin_until(timeout_s, condition, is_running)

    def spin_to_the_end(self, timeout_s: float, condition: Callable[[], bool]) -> bool:
        """Does the same after Ctrl-C, to end what this node began; a second Ctrl-C raises KeyboardInterrupt."""
        return self._spin_until(timeout_s, condition, self.context.ok)

    def _spin_until(self, timeout_s: float, condition: Callable[[], bool], may_continue: Callable[[], bool]) -> bool:
        deadline = time.monotonic() + timeout_s
        while True:
            if not may_continue():
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
            print_error(f"waiting for {awaited}")
        return self.spin_until(PATIENCE_S, condition)

    def discover(self, *awaited: str) -> None:
        """Spins until the nodes of the domain are discovered: longer without a simulation, and longest while one is starting.

        Args:
            awaited: names of the nodes of a simulation that must have loaded the scene, if they are present.
        """
        self._discover_usually()
        self.spin_until(DISCOVERY_S - USUAL_DISCOVERY_S, self.simulation_runs)
        if loading := self.loading(*awaited):
            print_error(f"waiting for {loading}: the simulation is starting")
            if self.spin_until(_LOADING_S, lambda: not self.loading(*awaited)):
                self.spin_until(_MORE_TYPES_S)
            else:
                loading = self.loading(*awaited)
                print_error(f"{loading} has not loaded the scene after {_LOADING_S:.0f} s: names may be missing")

    def _discover_usually(self) -> None:
        """Spins until ``USUAL_DISCOVERY_S`` after the start of this node."""
        self.spin_until(max(0.0, self.start_s + USUAL_DISCOVERY_S - time.monotonic()))

    def simulation_runs(self) -> bool:
        """Returns whether a simulation is discovered."""
        return simulation_runs(self.offered_services())

    def known_nodes(self) -> list[str]:
        """Returns the full names of the discovered nodes, sorted, without hidden ones, such as this node."""
        discovered = set(self.get_node_names_and_namespaces())
        return sorted(full_name(namespace, name) for name, namespace in discovered if not name.startswith("_"))

    def nodes_with_parameters(self) -> list[str]:
        """Returns the full names of the discovered nodes that have parameter services."""
        kind = "rcl_interfaces/srv/ListParameters"
        services = self.offered_services().items()
        return sorted(
            name.removesuffix(LIST_PARAMETERS) for name, kinds in services if name.endswith(LIST_PARAMETERS) and kind in kinds
        )

    def loading(self, *awaited: str) -> str:
        """Returns what of a simulation is starting: the full names of its nodes among ``awaited``; empty = nothing."""
        topics = [topic for topic, kinds in self.known_topics().items() if "gibson_msgs/msg/RunInfo" in kinds]
        publishers = [info for topic in topics for info in self.get_publishers_info_by_topic(topic)]
        loaded = {full_name(info.node_namespace, info.node_name) for info in publishers}
        # Subscriptions are discovered independently of publishers; the last one of the physics node is that of GetSimulationState.
        loaded -= {node for node in loaded if node.rpartition("/")[2] == PHYSICS and not simulation_runs(self._services_of(node))}
        nodes = loading_nodes(awaited, {*self.known_nodes(), *self.nodes_with_parameters()}, loaded)
        if not nodes and awaited and not self.simulation_runs() and is_held(self.context.get_domain_id()):
            return "the physics node"  # it is not discovered yet
        return ", ".join(nodes)

    def known_topics(self) -> dict[str, list[str]]:
        """Returns topic -> types of the graph."""
        return dict(self.get_topic_names_and_types())

    def known_services(self) -> dict[str, list[str]]:
        """Returns service -> types of the graph."""
        return dict(self.get_service_names_and_types())

    def _services_of(self, node: str) -> dict[str, list[str]]:
        """Returns service -> types of the services of a node whose subscriptions for requests are discovered."""
        namespace, _, name = node.rpartition("/")
        try:
            return dict(self.get_service_names_and_types_by_node(name, namespace or "/"))
        except NodeNameNonExistentError:  # it has ended
            return {}

    def offered_services(self) -> dict[str, list[str]]:
        """Returns service -> types of the services that nodes offer; the graph also contains services that have clients only."""
        return {name: types for name, types in self.known_services().items() if self.count_services(name)}

    def missing_service(self, name: str, kind: str = "") -> GibsonSimError:
        """Returns the error for a service that no node offers; ``name`` is its full name, ``kind`` its type, if it is known."""
        services = self.offered_services()
        domain, start = self.context.get_domain_id(), start_hint()
        return GibsonSimError(missing_service(name, kind, services, self.known_nodes(), domain=domain, start=start))

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

    def discover_endpoints(self, topic: str) -> None:
        """Spins until the numbers of publishers and subscriptions of a topic are settled; longer while it has no publisher."""
        known, changed_s = (-1, -1), 0.0

        def are_settled() -> bool:
            nonlocal known, changed_s
            present, now_s = (self.count_publishers(topic), self.count_subscribers(topic)), time.monotonic()
            if present != known:
                known, changed_s = present, now_s
            may_lack_publishers = not present[0] and now_s - self.start_s < PATIENCE_S
            return now_s - changed_s >= _SETTLED_S and not may_lack_publishers

        self.spin_until(PATIENCE_S, are_settled)

    def type_of(self, topic: str, given: str = "") -> tuple[str, str]:
        """Returns the full name and the type of a topic.

        Args:
            topic: name of the topic.
            given: type, needed if the topic may not exist yet or has several types; empty = the type of the topic.

        Raises:
            GibsonSimError: the topic does not exist and no type is given, it has several types, or it does not have the given one.
        """
        if given:
            name = self.resolve_topic_name(topic)
            self.spin_until(USUAL_DISCOVERY_S, lambda: name in self.known_topics())
        else:
            name = self.find_topic(topic)
        types = self.known_topics().get(name, [given])
        if given not in types:
            self.spin_until(_MORE_TYPES_S, lambda: len(self.known_topics().get(name, ())) > 1)
            types = self.known_topics().get(name, types)
        if given and given not in types:
            raise GibsonSimError(f"topic {quoted(name)} has the type {' and '.join(types)}, not {quoted(given)}")
        if len(types) > 1 and not given:
            raise GibsonSimError(
                f"topic {quoted(name)} has several types: {', '.join(types)}; only one can be shown: "
                f"`gibson-sim topic echo {name} {types[0]}`"
            )
        return name, given or types[0]

    def subscribe(self, topic: str, callback: Callable[[Any], None], *, kind: str = "", raw: bool = False) -> tuple[str, str]:
        """Subscribes to a topic with a QoS that matches all publishers; returns its full name and type; ``kind`` is a given type."""
        if kind:
            _message_class(kind)
        name, kind = self.type_of(topic, kind)
        AdaptiveSubscription(self, _message_class(kind), name, callback, raw=raw)
        return name, kind

    def _wait_for_call(self, condition: Callable[[], bool], awaited: Awaited) -> None:
        """Spins while a service is called.

        Raises:
            GibsonSimError: no node offers the service, or it does not respond.
        """
        if self.spin_until(_RESPONSE_S if awaited.is_sent else PATIENCE_S, condition):
            return
        if not awaited.is_sent:
            raise self.missing_service(awaited.service, type_name_of(awaited.kind))
        raise GibsonSimError(f"the service {quoted(awaited.service)} did not respond within {_RESPONSE_S:.0f} s")


def full_name(namespace: str, name: str) -> str:
    """Returns the full name of a node, such as ``/robot_1/driver``."""
    return f"{namespace.rstrip('/')}/{name}"


def _message_class(kind: str) -> Any:
    """Returns the class of a message type.

    Raises:
        GibsonSimError: the type is not installed.
    """
    try:
        if kind.split("/")[1:2] == ["msg"]:
            return message_class(kind)
    except UNKNOWN:
        pass
    raise GibsonSimError(
        f"the message type {quoted(kind)} is not installed in this environment; a type is written as in std_msgs/msg/String"
    )
