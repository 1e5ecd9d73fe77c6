"""The robot's own node: drives ahead and stops half a metre before whatever its lidar sees. It knows nothing of a simulator."""

import math

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

STOP_M = 0.5
"""Distance to an obstacle ahead at which it stops."""
SPEED = 0.3
"""m/s."""
AHEAD = math.radians(25.0)
"""Half of the sector that counts as ahead."""


class CarefulDrive(Node):
    def __init__(self) -> None:
        super().__init__("careful_drive")
        self.publisher = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(LaserScan, "scan", self.on_scan, 10)

    def on_scan(self, scan: LaserScan) -> None:
        nearest = math.inf
        for i, distance in enumerate(scan.ranges):
            bearing = math.remainder(scan.angle_min + i * scan.angle_increment, math.tau)
            if abs(bearing) < AHEAD and distance > scan.range_min:
                nearest = min(nearest, distance)
        command = Twist()
        command.linear.x = SPEED if nearest > STOP_M else 0.0
        self.publisher.publish(command)


def main() -> None:
    rclpy.init()
    try:
        rclpy.spin(CarefulDrive())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
