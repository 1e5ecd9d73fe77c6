"""Commands of a second type: they arrive in the thread of the node, in order, also those that came before the node was spun."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from support.simulation import Listener, new_context, require, wait_until

require("rclpy", "gibson_msgs")

from geometry_msgs.msg import Twist, TwistStamped  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402

from gibson_sim.ros.nodes.node_main import ExecutorKind, make_executor  # noqa: E402
from gibson_sim.ros.topics.stamped_commands import StampedCommands  # noqa: E402

pytestmark = pytest.mark.ros


def _command(linear: float) -> Any:
    message = TwistStamped()
    message.twist.linear.x = linear
    return message


@pytest.mark.parametrize("kind", ["events", "standard"])
def test_commands_of_the_second_type_arrive_in_the_thread_of_the_node_in_order(
    ros_domain: int, listener: Listener, kind: ExecutorKind
) -> None:
    context = new_context()
    node = Node("owner", context=context, use_global_arguments=False, start_parameter_services=False)
    node.create_subscription(Twist, "cmd_vel", lambda _: None, 10)
    received: list[tuple[float, bool]] = []
    owner = threading.current_thread()

    def on_command(message: Any) -> None:
        received.append((message.twist.linear.x, threading.current_thread() is owner))

    stamped = StampedCommands(node)
    executor = make_executor(kind, context=context)
    executor.add_node(node)
    try:
        subscription = stamped.subscribe(TwistStamped, "cmd_vel", on_command, QoSProfile(depth=100))
        assert stamped.types == {"/cmd_vel": TwistStamped}
        publisher = listener.node.create_publisher(TwistStamped, "cmd_vel", 100)
        listener.spin_until(lambda: publisher.get_subscription_count() > 0, "a subscription")
        for number in range(20):
            publisher.publish(_command(float(number)))
        wait_until(lambda: len(stamped._arrived) == 20, "commands in the thread of the second context")
        assert received == []  # the node is not spun yet
        stamped.start(executor)
        for number in range(20, 40):
            publisher.publish(_command(float(number)))

        def has_all() -> bool:
            executor.spin_once(timeout_sec=0.05)
            return len(received) == 40

        wait_until(has_all, "commands in the node")
        assert received == [(float(number), True) for number in range(40)]
        stamped.unsubscribe(subscription)
        assert stamped.types == {}
    finally:
        stamped.close()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
