"""Waits for a simulation, or another condition, before a node works: logs the wait after two seconds, and gives up after a timeout."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from rclpy.node import Node
from simulation_interfaces.srv import GetSimulationState

from gibson_sim.errors import GibsonSimError
from gibson_sim.reach import is_local
from gibson_sim.ros.nodes.node_main import started_by_launcher
from gibson_sim.ros.topics.discovery import offered_service

LOG_AFTER_S = 2.0
"""Time after which a node logs the condition that it waits for, s of wall time."""


def start_hint() -> str:
    """Returns a hint how to start a simulation, or to find one elsewhere."""
    elsewhere = ", or look for one on other machines with --reach subnet" if is_local(os.environ) else ""
    return f"`gibson-sim run`, or name its domain with --domain-id{elsewhere}"


class WaitCondition:
    """A condition that must hold before a node can work. Nodes started by ``gibson-sim run`` do not log the wait: their simulation is starting."""

    def __init__(
        self,
        node: Node,
        awaited: str | Callable[[], str],
        condition: Callable[[], bool],
        *,
        timeout_s: float = 0.0,
        remedy: str | Callable[[], str] = "",
    ) -> None:
        """Starts the timeout.

        Args:
            node: node that waits.
            awaited: completes ``waiting for <awaited>``; or a function that returns it.
            condition: returns whether the node can work.
            timeout_s: time after which the node gives up, s of wall time; 0 = never.
            remedy: hint for the user; or a function that returns it.
        """
        self._node, self._awaited, self._condition, self._timeout_s = node, awaited, condition, timeout_s
        self._remedy = remedy
        self._start = time.monotonic()
        self._logged = started_by_launcher()
        self._met = False

    @classmethod
    def for_robot(cls, node: Node, topic: str, timeout_s: float = 0.0) -> WaitCondition:
        """Returns the condition that a robot of a simulation publishes ``topic``; as ``for_simulation``, but a world may have no robot."""
        topic, domain = node.resolve_topic_name(topic), node.context.get_domain_id()

        def simulation_runs() -> bool:
            return bool(offered_service(node, GetSimulationState))

        return cls(
            node,
            lambda: (
                f"a robot that publishes {topic}: the simulation in ROS domain {domain} has none"
                if simulation_runs()
                else f"a simulation that publishes {topic} in ROS domain {domain}"
            ),
            lambda: node.count_publishers(topic) > 0,
            timeout_s=0.0 if started_by_launcher() else timeout_s,
            remedy=lambda: (
                "`gibson-sim spawn gibson_bot --at X,Y` adds one" if simulation_runs() else f"start one with {start_hint()}"
            ),
        )

    @classmethod
    def for_simulation(cls, node: Node, topic: str, timeout_s: float = 0.0, *, alternative: str = "") -> WaitCondition:
        """Returns the condition that a simulation publishes ``topic``; without timeout under the launcher, which has its own.

        Args:
            node: node that waits.
            topic: topic of the simulation.
            timeout_s: time after which the node gives up, s of wall time; 0 = never.
            alternative: what else publishes the topic, completes ``or <alternative>``.
        """
        return cls(
            node,
            f"a simulation that publishes {node.resolve_topic_name(topic)} in ROS domain {node.context.get_domain_id()}",
            lambda: node.count_publishers(topic) > 0,
            timeout_s=0.0 if started_by_launcher() else timeout_s,
            remedy=f"start one with {start_hint()}{f', or {alternative}' if alternative else ''}",
        )

    def is_met(self) -> bool:
        """Returns whether the condition holds or has held before; logs the wait once.

        Raises:
            GibsonSimError: it has not held within ``timeout_s``.
        """
        if self._met or self._condition():
            self._met = True
            return True
        waited_s = time.monotonic() - self._start
        awaited, remedy = (text if isinstance(text, str) else text() for text in (self._awaited, self._remedy))
        awaited = f"{awaited}; {remedy}" if remedy else awaited
        if self._timeout_s and waited_s > self._timeout_s:
            raise GibsonSimError(f"waited {self._timeout_s:g} s for {awaited}")
        if not self._logged and waited_s > LOG_AFTER_S:
            self._logged = True
            limit = f", at most {self._timeout_s:g} s," if self._timeout_s else ""
            self._node.get_logger().info(f"waiting{limit} for {awaited}")
        return False
