"""Roles of the benchmarks of lockstep: a controller that looks and makes ticks when it is asked, and both nodes in one process."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.parameter import Parameter

from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import make_executor
from gibson_sim.ros.nodes.physics_node import PhysicsNode
from gibson_sim.ros.nodes.render_node import RenderNode
from gibson_sim.ros.topics import names, qos
from gibson_sim.types import NS_PER_S
from gibson_sim_bench.protocol import SETTLE_S
from gibson_sim_bench.roles.table1 import Driver, Eyes
from gibson_sim_bench.roles.waiting import STRAGGLERS_S, wait_until


def one_process(physics: dict[str, Any], render: dict[str, Any]) -> None:
    """Plays physics node and render node, with these parameters, in one process and one thread, until it is ended."""
    drawing = RenderNode(parameter_overrides=[Parameter(name, value=value) for name, value in render.items()])
    moving = PhysicsNode(parameter_overrides=[Parameter(name, value=value) for name, value in physics.items()])
    try:
        moving.spin(drawing)
    finally:
        moving.close()
        drawing.close()


def controller(cases: list[list[str]], substeps: int) -> None:
    """Takes part in lockstep: answers every odometry with a command, and takes the images of one case of topics at a time, as bytes.

    To each line ``{"case": K, "ticks": N}`` on stdin it answers, once N more ticks have come, with ``tick_ns``: when each of them came, and
    the one before, and ``sets``: how many sets of images came meanwhile. Between two lines time stands still. First of all, what lies still
    falls asleep.
    """
    node = Node("bench_controller")
    eyes, driver = Eyes(node), Driver(node, substeps)
    ticks = _Ticks(node, driver.send)
    case = -1
    for line in sys.stdin:
        question = json.loads(line)
        if case < 0:
            while ticks.stamp_ns < SETTLE_S * NS_PER_S:
                ticks.make(1)
        if question["case"] != case:
            case = question["case"]
            eyes.look_at(cases[case])
            while cases[case] and not eyes.sets:
                ticks.make(1)
                ticks.wait_for(lambda: eyes.oldest_ns >= ticks.stamp_ns)
        before = len(eyes.sets)
        tick_ns = ticks.make(question["ticks"])
        ticks.wait_for(lambda: eyes.oldest_ns >= ticks.stamp_ns)
        sys.stdout.write(json.dumps({"tick_ns": tick_ns, "sets": len(eyes.sets) - before}) + "\n")
        sys.stdout.flush()


class _Ticks:
    """Lets ticks go by when it is asked to.

    Args:
        node: the participant.
        command: sends a command, and returns its topic.
    """

    def __init__(self, node: Node, command: Callable[[], str]) -> None:
        self._command = command
        self._came: list[int] = []
        self._left = 0
        self._held: Odometry | None = None
        node.create_subscription(Odometry, names.ODOM, self._on_odometry, qos.STATE)
        self._participant = LockstepParticipant(node, after=names.ODOM)
        self._executor = make_executor()
        self._executor.add_node(node)

    def make(self, count: int) -> list[int]:
        """Lets so many ticks come; returns when each did, and the one before them, steady clock, nanoseconds."""
        self._came = self._came[-1:]
        self._left = count if self._came else count + 1
        if self._held is not None:
            held, self._held = self._held, None
            self._obey(held)
        wait_until(lambda: self._held is not None, self._executor, progress=lambda: len(self._came))
        return list(self._came)

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Works until ``condition`` holds, so that nobody works any more, or half a second is over."""
        deadline = time.monotonic() + STRAGGLERS_S
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)

    @property
    def stamp_ns(self) -> int:
        """Of the last tick; 0 before the first."""
        return 0 if self._held is None else conversions.time_from_msg(self._held.header.stamp)

    def _on_odometry(self, msg: Odometry) -> None:
        self._came.append(time.monotonic_ns())
        self._left -= 1
        if self._left > 0:
            self._obey(msg)
        else:
            self._held = msg

    def _obey(self, msg: Odometry) -> None:
        self._participant.done(msg.header.stamp, (self._command(),))
