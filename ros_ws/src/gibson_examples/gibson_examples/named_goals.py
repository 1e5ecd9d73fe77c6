"""Sends a robot to named poses of the scene: ``get_named_poses`` of simulation_interfaces, then Nav2's NavigateToPose.

python -m gibson_examples.named_goals --tag room --goals 10
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.node import Node

from gibson_examples.errors import NavigationError

TIMEOUT_S = 30.0
"""Time that the simulator and Nav2 have to appear, wall time."""
SUCCEEDED = 4
"""``STATUS_SUCCEEDED`` of action_msgs/GoalStatus."""


def goals_of(poses: Sequence[Any], tag: str, floor: str, count: int) -> list[Any]:
    """Returns ``count`` of the named poses with both tags, sorted by name and repeated cyclically.

    Raises:
        NavigationError: no pose has both tags.
    """
    found = sorted((pose for pose in poses if {tag, floor} <= set(pose.tags)), key=lambda pose: str(pose.name))
    if not found:
        tags = sorted({tag for pose in poses for tag in pose.tags})
        raise NavigationError(f"no named pose has the tags {tag!r} and {floor!r}; there are: {', '.join(tags) or 'none'}")
    return [found[i % len(found)] for i in range(count)]


def interface(package: str, kind: str, name: str, remedy: str) -> Any:
    """Returns a message type of an optional package.

    Raises:
        NavigationError: the package is not installed.
    """
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except ImportError as error:
        raise NavigationError(f"the package {package} is not installed; {remedy}") from error


class NamedGoals(Node):
    """Requests named poses and sends them to Nav2, one after the other."""

    def __init__(self) -> None:
        super().__init__("named_goals")
        self._odometry: Odometry | None = None

    def named_poses(self) -> Sequence[Any]:
        """Returns the named poses of the scene."""
        kind = interface("simulation_interfaces", "srv", "GetNamedPoses", "see docs/simulation_interfaces.md")
        client = self.create_client(kind, "get_named_poses")
        if not client.wait_for_service(TIMEOUT_S):
            raise NavigationError(
                "no service get_named_poses: start gibson-sim run; with --service-prefix, remap get_named_poses"
            )
        future = client.call_async(kind.Request())
        rclpy.spin_until_future_complete(self, future)
        poses: Sequence[Any] = future.result().poses
        return poses

    def publish_initial_pose(self) -> None:
        """Publishes the true pose on ``initialpose`` for AMCL."""
        subscription = self.create_subscription(Odometry, "ground_truth/odom", self._on_odometry, 1)
        publisher = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 1)
        for _ in range(round(TIMEOUT_S / 0.1)):
            rclpy.spin_once(self, timeout_sec=0.1)
            if self._odometry is not None and publisher.get_subscription_count():
                break
        else:
            raise NavigationError(
                "no ground_truth/odom, or no subscriber of initialpose: is AMCL running? --no-initial-pose skips this step"
            )
        message = PoseWithCovarianceStamped(header=self._odometry.header)
        message.header.frame_id = "map"
        message.pose.pose = self._odometry.pose.pose
        for i, variance in ((0, 0.02), (7, 0.02), (35, 0.01)):
            message.pose.covariance[i] = variance
        publisher.publish(message)
        self.destroy_subscription(subscription)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def drive_to(self, goals: Sequence[Any]) -> int:
        """Sends the goals one after the other; returns the number of goals reached."""
        kind = interface("nav2_msgs", "action", "NavigateToPose", "install Nav2: apt install ros-jazzy-navigation2")
        client = ActionClient(self, kind, "navigate_to_pose")
        if not client.wait_for_server(TIMEOUT_S):
            raise NavigationError("no action navigate_to_pose: ros2 launch gibson_examples nav2.launch.py")
        reached = 0
        for number, place in enumerate(goals, 1):
            # A stamp of 0 stands for the newest transform.
            goal = PoseStamped()
            goal.header.frame_id, goal.pose = "map", place.pose
            sent = client.send_goal_async(kind.Goal(pose=goal))
            rclpy.spin_until_future_complete(self, sent)
            handle = sent.result()
            status = None
            if handle.accepted:
                result = handle.get_result_async()
                rclpy.spin_until_future_complete(self, result)
                status = result.result().status
            reached += status == SUCCEEDED
            outcome = "reached" if status == SUCCEEDED else "refused" if status is None else f"failed (status {status})"
            self.get_logger().info(f"{number} of {len(goals)}: {place.name}, {place.description}: {outcome}")
        return reached


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 if every goal was reached."""
    parser = argparse.ArgumentParser(prog="named_goals", description=__doc__.splitlines()[0])
    parser.add_argument("--tag", default="room", help="room, door, free or start, or a class such as bedroom (default: room)")
    parser.add_argument("--floor", default="floor_0", help="tag of the floor (default: floor_0)")
    parser.add_argument("--goals", type=int, default=10, help="number of goals (default: 10)")
    parser.add_argument(
        "--initial-pose", action=argparse.BooleanOptionalAction, default=True, help="first send AMCL the true pose"
    )
    parser.add_argument("--list", action="store_true", help="print the goals, send none")
    args, ros_args = parser.parse_known_args(argv)
    rclpy.init(args=ros_args)
    node = NamedGoals()
    try:
        goals = goals_of(node.named_poses(), args.tag, args.floor, args.goals)
        if args.list:
            for goal in goals:
                position = goal.pose.position
                print(f"{goal.name}: {position.x:.2f} {position.y:.2f} ({goal.description})")
            return 0
        if args.initial_pose:
            node.publish_initial_pose()
        return 0 if node.drive_to(goals) == len(goals) else 1
    except NavigationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
