"""What a node beside a simulation waits for: it says so after two seconds, and gives up after a timeout."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from rclpy.node import Node

from gibson_sim.errors import GibsonSimError
from gibson_sim.reach import is_local
from gibson_sim.ros.nodes.node_main import started_by_launcher

SAY_S = 2.0
"""Wall time after which a node says what it waits for."""


def how_to_find_a_simulation() -> str:
    """Returns what a user can do who has none: how to start one, and where else to look for it."""
    elsewhere = ", or look for one on other machines with --reach subnet" if is_local(os.environ) else ""
    return f"`gibson-sim run`, or name its domain with --domain-id{elsewhere}"


class Awaited:
    """Something that a node needs before it can work; a node of ``gibson-sim run`` says nothing, since its simulation is starting."""

    def __init__(
        self, node: Node, what: str | Callable[[], str], is_there: Callable[[], bool], *, timeout_s: float = 0.0, remedy: str = ""
    ) -> None:
        """Begins to wait.

        Args:
            node: says in its log what it waits for.
            what: is awaited, as in ``waiting for <what>``; or what returns that.
            is_there: whether it is there.
            timeout_s: wall time after which the node gives up; 0 = never.
            remedy: what a user can do.
        """
        self._node, self._what, self._is_there, self._timeout_s = node, what, is_there, timeout_s
        self._remedy = f"; {remedy}" if remedy else ""
        self._began = time.monotonic()
        self._said = started_by_launcher()
        self._found = False

    @classmethod
    def simulation(cls, node: Node, topic: str, timeout_s: float = 0.0) -> Awaited:
        """Returns what waits for a simulation, which has a publisher of ``topic``; the launcher knows how long its own may take."""
        return cls(
            node,
            f"a simulation that publishes {node.resolve_topic_name(topic)} in ROS domain {node.context.get_domain_id()}",
            lambda: node.count_publishers(topic) > 0,
            timeout_s=0.0 if started_by_launcher() else timeout_s,
            remedy=f"start one with {how_to_find_a_simulation()}",
        )

    def look(self) -> bool:
        """Returns whether it is there; says once that it is not.

        Raises:
            GibsonSimError: it is not there after ``timeout_s``.
        """
        if self._found or self._is_there():
            self._found = True
            return True
        waited_s = time.monotonic() - self._began
        what = self._what if isinstance(self._what, str) else self._what()
        if self._timeout_s and waited_s > self._timeout_s:
            raise GibsonSimError(f"waited {self._timeout_s:g} s for {what}{self._remedy}")
        if not self._said and waited_s > SAY_S:
            self._said = True
            limit = f"at most {self._timeout_s:g} s, " if self._timeout_s else ""
            self._node.get_logger().info(f"waiting, {limit}for {what}{self._remedy}")
        return False
