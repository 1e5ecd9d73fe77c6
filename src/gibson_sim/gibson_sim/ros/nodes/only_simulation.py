"""One simulation in a ROS domain: two sources of /clock would make time jump to and fro for everybody."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gibson_sim.errors import AlreadyRunningError
from gibson_sim.ros.nodes.node_main import started_by_launcher
from gibson_sim.ros.topics import names
from gibson_sim.standard.domain_lock import DomainLock

DISCOVERY_S, LATE_DISCOVERY_S = 3.0, 10.0
"""Within so long a new participant has heard of the others: usually, and on a busy machine."""


class OnlySimulation:
    """Refuses to be a second simulation; where both find each other late, the younger one gives way."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock: DomainLock | None = None
        self._young_until = 0.0

    def claim(self) -> None:
        """Looks for another simulation before anything is published: a second scene would replace the first one in its renderers.

        A lock tells of those on this machine, whatever discovery brings; a node that the launcher started need not wait for those on
        others either, and has the launcher's lock.

        Raises:
            AlreadyRunningError: there is one.
        """
        deadline = time.monotonic()
        if not started_by_launcher():
            self._lock = DomainLock(self._node.context.get_domain_id())
            deadline += DISCOVERY_S
        self._refuse_second(own=0)
        while time.monotonic() < deadline:
            time.sleep(0.05)
            self._refuse_second(own=0)

    def watch(self) -> None:
        """Goes on looking for a while."""
        self._young_until = time.monotonic() + LATE_DISCOVERY_S
        self._node.create_timer(0.2, self._give_way_while_young, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _refuse_second(self, own: int) -> None:
        """Gives way where there are more than ``own`` publishers of /clock."""
        if self._node.count_publishers(names.CLOCK) > own:
            raise AlreadyRunningError(
                "another node publishes /clock in this ROS domain: stop that simulation, or choose another ROS_DOMAIN_ID"
            )

    def _give_way_while_young(self) -> None:
        if time.monotonic() < self._young_until:
            self._refuse_second(own=1)

    def close(self) -> None:
        """Gives the domain back; a second time does nothing."""
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.close()
