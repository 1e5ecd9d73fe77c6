"""Ensures that a ROS domain has one simulation: with two publishers of /clock, time would jump back and forth for all nodes."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.processes.domain_lock import DomainLock
from gibson_sim.ros.nodes.node_main import started_by_launcher
from gibson_sim.ros.topics import names
from gibson_sim.ros.topics.discovery import DISCOVERY_S, LATE_DISCOVERY_S


class SingleSimulationGuard:
    """Prevents a second simulation in a domain; if two discover each other late, the younger one ends."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock: DomainLock | None = None
        self._watch_until = 0.0

    def acquire(self) -> None:
        """Acquires the domain before any message is published: a second scene would replace the first one in its renderers.

        A lock excludes other simulations on this machine independently of discovery; those on other machines must be discovered. A node
        started by the launcher does not wait for that, since the launcher holds the lock.

        Raises:
            AlreadyRunningError: another simulation runs.
        """
        deadline = time.monotonic()
        if not started_by_launcher():
            self._lock = DomainLock(self._node.context.get_domain_id())
            deadline += DISCOVERY_S
        self._refuse_second(own_count=0)
        while time.monotonic() < deadline:
            time.sleep(0.05)
            self._refuse_second(own_count=0)

    def watch(self) -> None:
        """Continues to check for another simulation for ``LATE_DISCOVERY_S``."""
        self._watch_until = time.monotonic() + LATE_DISCOVERY_S
        self._node.create_timer(0.2, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _refuse_second(self, own_count: int) -> None:
        """Raises AlreadyRunningError if there are more than ``own_count`` publishers of /clock."""
        if self._node.count_publishers(names.CLOCK) > own_count:
            raise AlreadyRunningError(
                "another node publishes /clock in this ROS domain: stop that simulation, or choose another ROS_DOMAIN_ID"
            )

    def _watch(self) -> None:
        if time.monotonic() < self._watch_until:
            self._refuse_second(own_count=1)

    def close(self) -> None:
        """Releases the domain; a second call does nothing."""
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.close()
