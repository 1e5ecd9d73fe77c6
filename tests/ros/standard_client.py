"""A user's node that knows only rclpy and standard messages: drives a distance by odometry, prints how far that says it went.

It slows down towards the end, as real drivers do: then a machine that stalls for a moment does not make it overshoot.

Usage: standard_client.py twist|stamped METRES
"""

from __future__ import annotations

import math
import sys

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

FASTEST, SLOWEST, GAIN, NEAR = 0.25, 0.03, 1.0, 0.005
"""Greatest and least speed, m/s; speed per remaining distance, 1/s; distance at which it stops, m."""


class Client(Node):
    def __init__(self, stamped: bool, metres: float) -> None:
        super().__init__("standard_client")
        self.metres = metres
        self.driving = True
        self.type = TwistStamped if stamped else Twist
        self.publisher = self.create_publisher(self.type, "cmd_vel", 10)
        self.create_subscription(Odometry, "odom", self.on_odom, 10)
        self.first: Odometry | None = None
        self.travelled = 0.0
        self.still = 0
        self.matched = 0

    def on_odom(self, msg: Odometry) -> None:
        self.matched += self.publisher.get_subscription_count() > 0
        if self.matched < 30:  # messages sent while the peers are being matched may be lost
            return
        self.first = self.first or msg
        a, b = self.first.pose.pose.position, msg.pose.pose.position
        self.travelled = math.hypot(b.x - a.x, b.y - a.y)
        remaining = self.metres - self.travelled
        self.driving = self.driving and remaining > NEAR
        command = self.type()
        twist = command.twist if isinstance(command, TwistStamped) else command
        twist.linear.x = min(FASTEST, max(SLOWEST, GAIN * remaining)) if self.driving else 0.0
        self.publisher.publish(command)
        self.still = 0 if self.driving or abs(msg.twist.twist.linear.x) > 1e-3 else self.still + 1


def main() -> None:
    rclpy.init()
    client = Client(sys.argv[1] == "stamped", float(sys.argv[2]))
    while client.still < 30:
        rclpy.spin_once(client)
    print(client.travelled)
    client.destroy_node()
    rclpy.shutdown()


main()
