"""What clients of a running simulation do beside listening: call services, set parameters, read stamps, drive."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import Twist
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import GetSimulationState, ResetSimulation, SetSimulationState, StepSimulation

from gibson_sim.cli.environment import node_environment
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


class Control:
    """The services that rule time, as a client calls them."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener
        self._clients: dict[str, Any] = {}

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Returns the response of a service."""
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.listener.node.create_client(kind, name)
            self.listener.spin_until(client.service_is_ready, f"service {name}")
        future = client.call_async(request)
        self.listener.spin_until(future.done, f"answer of {name}")
        return future.result()

    @property
    def state(self) -> int:
        """What the simulation is doing: a constant of SimulationState."""
        return int(self.call(GetSimulationState, "get_simulation_state", GetSimulationState.Request()).state.state)

    def set_state(self, state: int) -> None:
        """Plays, pauses or stops; being there already is fine."""
        request = SetSimulationState.Request(state=SimulationState(state=state))
        result = self.call(SetSimulationState, "set_simulation_state", request).result
        allowed = (result.RESULT_OK, SetSimulationState.Response.ALREADY_IN_TARGET_STATE)
        assert result.result in allowed, f"{result.result}: {result.error_message}"

    def play(self) -> None:
        """Lets time pass."""
        self.set_state(SimulationState.STATE_PLAYING)

    def pause(self) -> None:
        """Lets time stand still."""
        self.set_state(SimulationState.STATE_PAUSED)

    def step(self, steps: int) -> None:
        """Makes so many physics steps of a paused simulation."""
        result = self.call(StepSimulation, "step_simulation", StepSimulation.Request(steps=steps)).result
        assert result.result == result.RESULT_OK, result.error_message

    def reset(self, scope: int = ResetSimulation.Request.SCOPE_DEFAULT) -> None:
        """Puts back what ``scope`` names."""
        result = self.call(ResetSimulation, "reset_simulation", ResetSimulation.Request(scope=scope)).result
        assert result.result == result.RESULT_OK, result.error_message

    def set_parameter(self, node: str, name: str, value: float) -> tuple[bool, str]:
        """Sets a number as ``ros2 param set`` does; returns whether it was taken, and why not."""
        number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=number)])
        result = self.call(SetParameters, f"{node}/set_parameters", request).results[0]
        return result.successful, result.reason


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
