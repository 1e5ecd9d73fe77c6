"""Lets a node wait for a simulation, or another condition, before it works: it logs that after two seconds, and gives up after a timeout."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from rclpy.node import Node

from gibson_sim.errors import GibsonSimError
from gibson_sim.reach import is_local
from gibson_sim.ros.nodes.node_main import started_by_launcher

LOG_AFTER_S = 2.0
"""Wall time after which a node logs what it waits for, s."""


def start_hint() -> str:
    """Returns how to start a simulation, and where else to look for one."""
    elsewhere = ", or look for one on other machines with --reach subnet" if is_local(os.environ) else ""
    return f"`gibson-sim run`, or name its domain with --domain-id{elsewhere}"


class WaitCondition:
    """A condition that must hold before a node can work. A node of ``gibson-sim run`` logs nothing: its simulation is starting, too."""

    def __init__(
        self,
        node: Node,
        what: str | Callable[[], str],
        condition: Callable[[], bool],
        *,
        timeout_s: float = 0.0,
        remedy: str = "",
    ) -> None:
        """Starts the timeout.

        Args:
            node: logs what it waits for.
            what: completes ``waiting for <what>``; or a function that returns it.
            condition: whether the node can work.
            timeout_s: wall time after which the node gives up; 0 = never.
            remedy: what a user can do.
        """
        self._node, self._what, self._condition, self._timeout_s = node, what, condition, timeout_s
        self._remedy = f"; {remedy}" if remedy else ""
        self._began = time.monotonic()
        self._logged = started_by_launcher()
        self._met = False

    @classmethod
    def for_simulation(cls, node: Node, topic: str, timeout_s: float = 0.0) -> WaitCondition:
        """Returns the condition that a simulation publishes ``topic``. There is no timeout under the launcher, which has its own."""
        return cls(
            node,
            f"a simulation that publishes {node.resolve_topic_name(topic)} in ROS domain {node.context.get_domain_id()}",
            lambda: node.count_publishers(topic) > 0,
            timeout_s=0.0 if started_by_launcher() else timeout_s,
            remedy=f"start one with {start_hint()}",
        )

    def is_met(self) -> bool:
        """Returns whether the condition holds or has held before; logs once that the node waits for it.

        Raises:
            GibsonSimError: it does not hold after ``timeout_s``.
        """
        if self._met or self._condition():
            self._met = True
            return True
        waited_s = time.monotonic() - self._began
        what = self._what if isinstance(self._what, str) else self._what()
        if self._timeout_s and waited_s > self._timeout_s:
            raise GibsonSimError(f"waited {self._timeout_s:g} s for {what}{self._remedy}")
        if not self._logged and waited_s > LOG_AFTER_S:
            self._logged = True
            limit = f"at most {self._timeout_s:g} s, " if self._timeout_s else ""
            self._node.get_logger().info(f"waiting, {limit}for {what}{self._remedy}")
        return False
