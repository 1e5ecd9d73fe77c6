"""Follows a path of waypoints by odometry, as on a real robot: subscribes to /odom, publishes /cmd_vel. Plain ROS 2.

In one terminal: gibson-sim run. In another, after `source env.sh`: python path_follower.py
"""

import math

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node

PATH = ((0.6, 0.0), (0.6, 0.4), (0.0, 0.4))
"""Waypoints, metres, odom frame: the robot starts at its origin and faces along x."""
REACHED, SPEED, TURN = 0.08, 0.3, 1.5
"""Distance at which a waypoint is reached, metres; speed, m/s; yaw rate per heading error, 1/s."""


class PathFollower(Node):
    """Turns towards the next waypoint, and drives."""

    def __init__(self) -> None:
        super().__init__("path_follower")
        self.waypoints = list(PATH)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(Odometry, "odom", self.on_odometry, 10)

    def on_odometry(self, message: Odometry) -> None:
        position, q = message.pose.pose.position, message.pose.pose.orientation
        while self.waypoints and math.dist(self.waypoints[0], (position.x, position.y)) < REACHED:
            self.get_logger().info(f"reached {self.waypoints.pop(0)}")
        command = Twist()
        if self.waypoints:
            yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
            heading = math.atan2(self.waypoints[0][1] - position.y, self.waypoints[0][0] - position.x)
            error = math.remainder(heading - yaw, math.tau)
            command.linear.x = SPEED * max(0.0, math.cos(error)) ** 3
            command.angular.z = TURN * error
        self.publisher.publish(command)


def main() -> None:
    rclpy.init()
    node = PathFollower()
    while node.waypoints:
        rclpy.spin_once(node, timeout_sec=1.0)
    print("the path is driven")
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
