"""A user's node that knows only rclpy and standard messages: drives a distance, prints how far odometry says it went.

Usage: standard_client.py twist|stamped METRES
"""

from __future__ import annotations

import math
import sys

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

SPEED = 0.25


class Client(Node):
    def __init__(self, stamped: bool, metres: float) -> None:
        super().__init__("standard_client")
        self.seconds = metres / SPEED
        self.type = TwistStamped if stamped else Twist
        self.publisher = self.create_publisher(self.type, "cmd_vel", 10)
        self.create_subscription(Odometry, "odom", self.on_odom, 10)
        self.first: Odometry | None = None
        self.started = 0.0
        self.travelled = 0.0
        self.still = 0
        self.heard = 0

    def on_odom(self, msg: Odometry) -> None:
        self.heard += self.publisher.get_subscription_count() > 0
        if self.heard < 30:  # what is sent while the peers still match may be lost
            return
        now = msg.header.stamp.sec + msg.header.stamp.nanosec * 1e-9
        if self.first is None:
            self.first, self.started = msg, now
        driving = now - self.started < self.seconds
        command = self.type()
        twist = command.twist if isinstance(command, TwistStamped) else command
        twist.linear.x = SPEED if driving else 0.0
        self.publisher.publish(command)
        a, b = self.first.pose.pose.position, msg.pose.pose.position
        self.travelled = math.hypot(b.x - a.x, b.y - a.y)
        self.still = 0 if driving or abs(msg.twist.twist.linear.x) > 1e-3 else self.still + 1


def main() -> None:
    rclpy.init()
    client = Client(sys.argv[1] == "stamped", float(sys.argv[2]))
    while client.still < 30:
        rclpy.spin_once(client)
    print(client.travelled)
    client.destroy_node()
    rclpy.shutdown()


main()
