"""What clients of a running simulation do beside listening: call services, read stamps, drive."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from gibson_sim.cli.environment import node_environment
from gibson_sim.ros.client.simulation_client import Awaited, SimulationClient
from support.simulation import PATIENCE_S, Launched, Listener

STEP_HZ = 240
"""Physics steps per second, unless a test sets another rate."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
"""For what a test wants to hear whole, also on a machine that stalls."""


def stamp_ns(message: Any) -> int:
    """Returns the stamp of a message with a header, of a clock, or of the first transform."""
    if hasattr(message, "transforms"):
        message = message.transforms[0]
    stamp = message.clock if hasattr(message, "clock") else message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def step_of(stamp: int, step_hz: int = STEP_HZ) -> int:
    """Returns the physics step that a stamp in nanoseconds belongs to; fails where it belongs to none."""
    step = -(-stamp * step_hz // 10**9)
    assert step * 10**9 // step_hz == stamp, f"{stamp} ns is no step at {step_hz} Hz: the nearest is {step * 10**9 // step_hz} ns"
    return step


def steps_of(messages: Sequence[Any]) -> list[int]:
    """Returns the physics steps of messages."""
    return [step_of(stamp_ns(message)) for message in messages]


class LaunchedNode(Launched):
    """One node as a user starts it by hand, without the launcher."""

    def __init__(self, node: str, *ros_arguments: str, env: dict[str, str] | None = None) -> None:
        command = [sys.executable, "-u", "-m", f"gibson_sim.ros.nodes.{node}_node", "--ros-args", *ros_arguments]
        self._start(command, {**node_environment(), **(env or {})})

    def kill(self) -> None:
        """Ends it at once, if it is still there."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait(timeout=PATIENCE_S)


def client_of(listener: Listener) -> SimulationClient:
    """Returns a client of the simulation that works as the listener does while it waits."""

    def wait(condition: Callable[[], bool], awaited: Awaited) -> None:
        listener.spin_until(condition, str(awaited))

    return SimulationClient(listener.node, wait)


def drive_until(listener: Listener, topic: str, linear: float, angular: float, condition: Callable[[], bool], what: str) -> None:
    """Sends a velocity (m/s, rad/s) again and again until ``condition`` holds, then a stop."""
    publisher = listener.node.create_publisher(Twist, topic, 1)
    listener.spin_until(lambda: publisher.get_subscription_count() > 0, f"a robot that listens to {topic}")
    command = Twist()
    command.linear.x, command.angular.z = linear, angular

    def done() -> bool:
        publisher.publish(command)
        return condition()

    listener.spin_until(done, what)
    publisher.publish(Twist())
