"""Nodes of the lockstep benchmarks: a controller that completes ticks on request, and physics and render node in one process."""

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
from gibson_sim_bench.nodes.spinning import IN_TRANSIT_S, spin_until
from gibson_sim_bench.nodes.table1 import CommandPublisher, ImageSetCounter
from gibson_sim_bench.protocol import SETTLE_S


def one_process(physics: dict[str, Any], render: dict[str, Any]) -> None:
    """Runs physics node and render node, with these parameters, in one process and one thread until the process ends."""
    render_node = RenderNode(parameter_overrides=[Parameter(name, value=value) for name, value in render.items()])
    physics_node = PhysicsNode(parameter_overrides=[Parameter(name, value=value) for name, value in physics.items()])
    try:
        physics_node.spin(render_node)
    finally:
        physics_node.close()
        render_node.close()


def controller(cases: list[list[str]], substeps: int) -> None:
    """Joins the lockstep: replies to every odometry message with a command, and receives the images of one case at a time, as bytes.

    A line ``{"case": K, "ticks": N}`` on stdin requests N more ticks. The response is a line on stdout with ``tick_ns``: arrival times of
    these ticks and of the previous one, steady clock, nanoseconds, and ``sets``: the number of sets of images received. Between two requests
    simulation time stands still. Before the first response ``SETTLE_S`` of simulation time pass, so that bodies at rest sleep.
    """
    node = Node("bench_controller")
    images, commands = ImageSetCounter(node), CommandPublisher(node, substeps)
    ticks = _Ticks(node, commands.send)
    case = -1
    for line in sys.stdin:
        request = json.loads(line)
        if case < 0:
            while ticks.stamp_ns < SETTLE_S * NS_PER_S:
                ticks.make(1)
        if request["case"] != case:
            case = request["case"]
            images.subscribe(cases[case])
            while cases[case] and not images.sets:
                ticks.make(1)
                ticks.wait_for(lambda: images.oldest_ns >= ticks.stamp_ns)
        before = len(images.sets)
        tick_ns = ticks.make(request["ticks"])
        ticks.wait_for(lambda: images.oldest_ns >= ticks.stamp_ns)
        sys.stdout.write(json.dumps({"tick_ns": tick_ns, "sets": len(images.sets) - before}) + "\n")
        sys.stdout.flush()


class _Ticks:
    """Completes ticks on request.

    Args:
        node: the participant.
        command: sends a command, and returns its topic.
    """

    def __init__(self, node: Node, command: Callable[[], str]) -> None:
        self._command = command
        self._arrivals: list[int] = []
        self._left = 0
        self._held: Odometry | None = None
        node.create_subscription(Odometry, names.ODOM, self._on_odometry, qos.STATE)
        self._participant = LockstepParticipant(node, after=names.ODOM)
        self._executor = make_executor()
        self._executor.add_node(node)

    def make(self, count: int) -> list[int]:
        """Completes ``count`` ticks; returns their arrival times and that of the one before, steady clock, nanoseconds."""
        self._arrivals = self._arrivals[-1:]
        self._left = count if self._arrivals else count + 1
        if self._held is not None:
            held, self._held = self._held, None
            self._complete(held)
        spin_until(lambda: self._held is not None, self._executor, progress=lambda: len(self._arrivals))
        return list(self._arrivals)

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Spins until ``condition`` holds, or ``IN_TRANSIT_S`` have passed."""
        deadline = time.monotonic() + IN_TRANSIT_S
        while not condition() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.05)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the last tick; 0 before the first."""
        return 0 if self._held is None else conversions.time_from_msg(self._held.header.stamp)

    def _on_odometry(self, msg: Odometry) -> None:
        self._arrivals.append(time.monotonic_ns())
        self._left -= 1
        if self._left > 0:
            self._complete(msg)
        else:
            self._held = msg

    def _complete(self, msg: Odometry) -> None:
        self._participant.tick_done(msg.header.stamp, (self._command(),))
