"""A stack that does not drive: it changes the world or the recording with services, and says that it has reached the goal.

``python cheat.py teleport|steps|pause|record`` does as the word says, once it has its goal.
"""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import SetEntityState, SetSimulationState
from std_msgs.msg import String

STEPS = 60
ROBOT = "robot"


class Cheat(Node):
    def __init__(self, how: str) -> None:
        super().__init__("cheat")
        self._how, self._done = how, 0
        self._status = self.create_publisher(String, "status", 10)
        self._place = self.create_client(SetEntityState, "set_entity_state")
        self._state = self.create_client(SetSimulationState, "set_simulation_state")
        self._place.wait_for_service()
        self._state.wait_for_service()
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 10)

    def _on_goal(self, msg: PoseStamped) -> None:
        self._goal, self._ready = msg, self.create_timer(0.5, self._begin)

    def _begin(self) -> None:
        self._ready.cancel()
        if self._how == "pause":
            self._state.call_async(SetSimulationState.Request(state=SimulationState(state=SimulationState.STATE_PAUSED)))
        elif self._how == "record":
            self._interrupt_recording()
        else:
            self._move()

    def _interrupt_recording(self) -> None:
        """Pauses the recorder for 3 s."""
        from rosbag2_interfaces.srv import Pause, Resume

        pause, resume = self.create_client(Pause, "record/pause"), self.create_client(Resume, "record/resume")

        def go_on() -> None:
            timer.cancel()
            resume.call_async(Resume.Request()).add_done_callback(lambda _: self._end())

        pause.call_async(Pause.Request())
        timer = self.create_timer(3.0, go_on)

    def _end(self) -> None:
        self.create_timer(0.2, lambda: self._status.publish(String(data="reached")))

    def _move(self) -> None:
        count = STEPS if self._how == "steps" else 1
        if self._done == count:
            self._end()
            return
        self._done += 1
        request = SetEntityState.Request(entity=ROBOT)
        request.state.header.frame_id = "map"
        request.state.pose.position.x = self._goal.pose.position.x * self._done / count
        request.state.pose.orientation.w = 1.0
        if hasattr(request, "set_pose"):
            request.set_pose = True
        self._place.call_async(request).add_done_callback(lambda _: self._move())


def main() -> None:
    rclpy.init()
    rclpy.spin(Cheat(sys.argv[1]))


if __name__ == "__main__":
    main()
