"""A program of somebody else, plain rclpy with ROS's own settings: looks, drives, tries to end the simulation, prints what it found.

``python visitor.py SECONDS [end]``: it ends as soon as it has seen everything; with ``end`` it then ends the simulation, too.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import SetSimulationState


def main() -> None:
    """Prints a line of JSON."""
    rclpy.init()
    node = rclpy.create_node("visitor")
    clocks: list[Any] = []
    moved: list[float] = [0.0]
    node.create_subscription(Clock, "/clock", clocks.append, 10)
    node.create_subscription(Odometry, "/odom", lambda message: moved.append(message.pose.pose.position.x), 10)
    wheel = node.create_publisher(Twist, "/cmd_vel", 10)
    ending = node.create_client(SetSimulationState, "/set_simulation_state")
    answers: list[int] = []
    command = Twist()
    command.linear.x = 0.3

    ends = "end" in sys.argv[2:]

    def seen() -> bool:
        return bool(clocks) and max(moved) > 0.05 and "physics" in node.get_node_names() and ending.service_is_ready()

    def drive() -> None:
        wheel.publish(command)
        if ends and seen() and not answers:
            request = SetSimulationState.Request(state=SimulationState(state=SimulationState.STATE_QUITTING))
            ending.call_async(request).add_done_callback(lambda done: answers.append(done.result().result.result))

    node.create_timer(0.1, drive)
    deadline = time.monotonic() + float(sys.argv[1])

    while time.monotonic() < deadline and not (answers if ends else seen()):
        rclpy.spin_once(node, timeout_sec=0.1)
    found = {
        "nodes": sorted(set(node.get_node_names()) - {"visitor"}),
        "topics": sorted({name for name, _ in node.get_topic_names_and_types()} & {"/scan", "/scene", "/tf"}),
        "clocks": len(clocks),
        "service": ending.service_is_ready(),
        "answers": answers,
        "moved": max(moved) > 0.05,
    }
    print(json.dumps(found))


main()
