"""Commands that wait for a step: their order, and which are dropped."""

from __future__ import annotations

from support.simulation import require

require("rclpy", "gibson_msgs")

from gibson_sim.ros.topics.qos import MAX_COMMANDS  # noqa: E402
from gibson_sim.ros.topics.robot_interface import CommandQueue  # noqa: E402


def test_many_velocities_of_a_pause_do_not_drop_a_trajectory() -> None:
    queue = CommandQueue()
    queue.append("cmd_vel", -1)
    queue.append("joint_trajectory", "up")
    for number in range(MAX_COMMANDS):
        queue.append("cmd_vel", number)
    queue.append("joint_trajectory", "down")
    commands = queue.take()
    assert commands[0] == ("joint_trajectory", "up"), "the oldest velocity is dropped, not the trajectory"
    assert commands[1:-1] == [("cmd_vel", number) for number in range(MAX_COMMANDS)]
    assert commands[-1] == ("joint_trajectory", "down")
    assert queue.take() == []
