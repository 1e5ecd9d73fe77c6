"""A tiny stack, as a user might write it: drives to the goal by exact odometry, and reports its arrival.

It sends one command per odometry message, so that runs repeat in lockstep.
``python drive.py [crash|nan|hang|daemon|service|lifecycle]`` does as the word says.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from nav_msgs.srv import GetPlan
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import String

CRASH_S = HANG_S = 3.0
"""Simulation time of the crash, and after which no answer comes, seconds."""
ACTIVE_AFTER_S = 0.5
"""Wall time after which a lifecycle node becomes active, seconds."""
NEAR = 0.05
"""Distance at which it stops, metres."""


class Drive(LifecycleNode):
    def __init__(self, how: str) -> None:
        super().__init__("drive")
        self._how, self._goal = how, None
        self._commands = self.create_publisher(Twist, "cmd_vel", 10)
        self._status = self.create_publisher(String, "status", 10)
        self.create_subscription(Odometry, "ground_truth/odom", self._on_odometry, 10)
        if how == "service":
            self.create_service(GetPlan, "plan", self._on_request)
        else:
            self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)

    def _on_goal(self, msg: PoseStamped) -> None:
        self._goal = msg.pose.position

    def _on_request(self, request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        self._on_goal(request.goal)
        return response

    def _on_odometry(self, msg: Odometry) -> None:
        time_s = msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec
        if self._how == "crash" and time_s >= CRASH_S:
            raise RuntimeError("no more memory for the costmap")
        while self._how == "hang" and time_s >= HANG_S:
            time.sleep(1.0)
        command = Twist()
        if self._how == "nan":
            command.linear.x = math.nan
        elif self._goal is not None:
            p, q = msg.pose.pose.position, msg.pose.pose.orientation
            ahead, left = self._goal.x - p.x, self._goal.y - p.y
            turn = math.remainder(math.atan2(left, ahead) - 2.0 * math.atan2(q.z, q.w), 2.0 * math.pi)
            distance = math.hypot(ahead, left)
            if distance > NEAR:
                command.linear.x = min(0.5, distance) * max(0.0, math.cos(turn))
                command.angular.z = max(-1.0, min(1.0, 2.0 * turn))
            else:
                self._status.publish(String(data="reached"))
        self._commands.publish(command)


def main() -> None:
    how = sys.argv[1] if len(sys.argv) > 1 else ""
    if how == "daemon":
        waits = [sys.executable, "-c", "import time; time.sleep(600)"]
        subprocess.Popen(waits, start_new_session=True)
        print("without environment:", subprocess.Popen(waits, start_new_session=True, env={}).pid, flush=True)
    print("the stack starts", os.getpid(), flush=True)
    rclpy.init()
    node = Drive(how)
    if how == "lifecycle":
        node.trigger_configure()
        timer = node.create_timer(ACTIVE_AFTER_S, lambda: (timer.cancel(), node.trigger_activate()))
    rclpy.spin(node)


if __name__ == "__main__":
    main()
