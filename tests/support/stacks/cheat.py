"""A stack that does not drive: it changes the world with the services of the simulation, and says that it has reached the goal.

``python cheat.py teleport|steps|pause`` does as the word says, once it has its goal.
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
        else:
            self._move()

    def _move(self) -> None:
        count = STEPS if self._how == "steps" else 1
        if self._done == count:
            self.create_timer(0.2, lambda: self._status.publish(String(data="reached")))
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
