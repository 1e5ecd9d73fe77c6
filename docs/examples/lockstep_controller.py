"""A controller in lockstep: time waits for its answer at each tick, so that runs repeat to the bit on any machine.

In one terminal: gibson-sim run --lockstep --participants lockstep_controller --duration 5
In another, after `source env.sh`: python lockstep_controller.py
"""

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant


class Controller(Node):
    """Drives forward while there is room ahead, otherwise turns; decides once per scan, at the scan's own stamp."""

    def __init__(self) -> None:
        super().__init__("lockstep_controller")
        self.publisher = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(LaserScan, "scan", self.on_scan, 10)
        self.lockstep = LockstepParticipant(self, after="scan")  # after it has subscribed
        self.scans = 0

    def on_scan(self, message: LaserScan) -> None:
        beams = len(message.ranges)
        ahead = min((*message.ranges[: beams // 12], *message.ranges[-beams // 12 :]))  # 30 degrees to either side
        command = Twist()
        command.linear.x, command.angular.z = (0.3, 0.0) if ahead > 0.6 else (0.0, 0.8)
        self.publisher.publish(command)
        self.lockstep.tick_done(message.header.stamp, sent=[self.publisher.topic_name])
        self.scans += 1


def main() -> None:
    rclpy.init()
    node = Controller()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():  # rclpy.spin() waits for ever if SIGTERM comes while it is between two waits
            executor.spin_once(timeout_sec=0.5)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    print(f"answered {node.scans} scans")


if __name__ == "__main__":
    main()
