"""Sends a robot to named poses of the scene: ``get_named_poses`` of simulation_interfaces, then Nav2's NavigateToPose.

python -m gibson_examples.named_goals --tag room --goals 10
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from gibson_examples.errors import NavigationError

TIMEOUT_S = 60.0
"""Default time limit of each thing that is waited for, wall time."""
RETRY_S = 1.0
"""Between two initial poses, and between two questions for the navigator's state; wall time."""
DISCOVERY_S = 2.0
"""Time that a service has to be discovered after an action of the same node, wall time."""
LOCALISED_M = 0.5
"""A localiser whose pose is this close to the true one has received it."""
NAVIGATOR = "bt_navigator"
"""Nav2's node of the action navigate_to_pose, which refuses goals until its lifecycle manager activates it."""
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


def initial_pose(odometry: Odometry) -> PoseWithCovarianceStamped:
    """Returns the pose of an odometry message in the frame map, with the variances of a pose set by hand: m^2 and rad^2."""
    message = PoseWithCovarianceStamped(header=odometry.header)
    message.header.frame_id = "map"
    message.pose.pose = odometry.pose.pose
    for i, variance in ((0, 0.02), (7, 0.02), (35, 0.01)):
        message.pose.covariance[i] = variance
    return message


class NamedGoals(Node):
    """Requests named poses and sends them to Nav2, one after the other."""

    def __init__(self, timeout_s: float = TIMEOUT_S, **options: Any) -> None:
        """Waits for nothing yet. ``timeout_s``: limit of each wait, wall time; ``options`` of the node."""
        super().__init__("named_goals", **options)
        self._timeout_s = timeout_s
        self._odometry: Odometry | None = None
        self._sent: PoseWithCovarianceStamped | None = None
        self._localised = False

    def named_poses(self) -> Sequence[Any]:
        """Returns the named poses of the scene."""
        kind = interface("simulation_interfaces", "srv", "GetNamedPoses", "see docs/simulation_interfaces.md")
        client = self.create_client(kind, "get_named_poses")
        if not client.wait_for_service(self._timeout_s):
            raise NavigationError(
                "no service get_named_poses: start gibson-sim run; with --service-prefix, remap get_named_poses"
            )
        poses: Sequence[Any] = self._result(client.call_async(kind.Request())).poses
        return poses

    def set_initial_pose(self) -> None:
        """Publishes the true pose on ``initialpose`` each second, until the localiser has it.

        A localiser has it when ``amcl_pose`` is close to it, or, if nobody publishes ``amcl_pose``, when map -> odom is in /tf.
        One message is not enough: it is lost if the localiser has not discovered this node yet, and other subscribers, such
        as a recorder, do not tell.

        Raises:
            NavigationError: there is no true pose, or no localiser has it in time.
        """
        subscriptions = [
            self.create_subscription(Odometry, "ground_truth/odom", self._on_odometry, 1),
            self.create_subscription(PoseWithCovarianceStamped, "amcl_pose", self._on_amcl_pose, 1),
            self.create_subscription(TFMessage, "/tf", self._on_tf, 10),
        ]
        publisher = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 1)
        deadline, due = time.monotonic() + self._timeout_s, 0.0
        while not self._localised:
            now = time.monotonic()
            if now > deadline:
                limit = f"within {self._timeout_s:g} s (--timeout)"
                if self._odometry is None:
                    raise NavigationError(f"no ground_truth/odom {limit}: start gibson-sim run")
                raise NavigationError(
                    f"neither amcl_pose near the pose sent on initialpose nor map -> odom in /tf {limit}: is AMCL running "
                    "(ros2 launch gibson_examples nav2.launch.py)? --no-initial-pose skips this step"
                )
            if self._odometry is not None and now >= due:
                self._sent, due = initial_pose(self._odometry), now + RETRY_S
                publisher.publish(self._sent)
            self._spin()
        for subscription in subscriptions:
            self.destroy_subscription(subscription)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def _on_amcl_pose(self, message: PoseWithCovarianceStamped) -> None:
        if self._sent is not None:
            here, sent = message.pose.pose.position, self._sent.pose.pose.position
            self._localised |= math.hypot(here.x - sent.x, here.y - sent.y) <= LOCALISED_M

    def _on_tf(self, message: TFMessage) -> None:
        # AMCL keeps publishing the transform of an old pose, after a reset for one: its amcl_pose decides.
        if self._sent is not None and not self.count_publishers("amcl_pose"):
            self._localised |= any((t.header.frame_id, t.child_frame_id) == ("map", "odom") for t in message.transforms)

    def wait_until_active(self) -> None:
        """Waits until Nav2's navigator is active, which it is only after the robot is localised. Other navigators have no such state.

        Raises:
            NavigationError: it is not active in time.
        """
        client = self.create_client(GetState, f"{NAVIGATOR}/get_state")
        if not client.wait_for_service(DISCOVERY_S):
            return
        deadline, state = time.monotonic() + self._timeout_s, "silent"
        while True:
            future = client.call_async(GetState.Request())
            answer = self._result(future, RETRY_S)
            if answer is None:
                client.remove_pending_request(future)
            elif answer.current_state.id == State.PRIMARY_STATE_ACTIVE:
                return
            else:
                state = answer.current_state.label
            self.get_logger().info(f"waiting for {NAVIGATOR} to be active: it is {state}", once=True)
            again = time.monotonic() + RETRY_S
            if again > deadline:
                raise NavigationError(
                    f"{NAVIGATOR} was not active within {self._timeout_s:g} s (--timeout) but {state}: "
                    "see the log of lifecycle_manager_navigation; if it has aborted, restart nav2.launch.py"
                )
            while time.monotonic() < again:
                self._spin()

    def _spin(self) -> None:
        """Handles a message, or waits 0.1 s for one."""
        rclpy.spin_once(self, timeout_sec=0.1)

    def _result(self, future: Any, timeout_s: float | None = None) -> Any:
        """Returns the result of a future, or None if it does not arrive in ``timeout_s``, wall time."""
        rclpy.spin_until_future_complete(self, future, timeout_sec=timeout_s)
        return future.result()

    def drive_to(self, goals: Sequence[Any]) -> int:
        """Sends the goals one after the other, once the navigator is active; returns the number of goals reached."""
        kind = interface("nav2_msgs", "action", "NavigateToPose", "install Nav2: apt install ros-jazzy-navigation2")
        client = ActionClient(self, kind, "navigate_to_pose")
        if not client.wait_for_server(self._timeout_s):
            raise NavigationError("no action navigate_to_pose: ros2 launch gibson_examples nav2.launch.py")
        self.wait_until_active()
        reached = 0
        for number, place in enumerate(goals, 1):
            # A stamp of 0 stands for the newest transform.
            goal = PoseStamped()
            goal.header.frame_id, goal.pose = "map", place.pose
            handle = self._result(client.send_goal_async(kind.Goal(pose=goal)))
            status = self._result(handle.get_result_async()).status if handle.accepted else None
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
    parser.add_argument(
        "--timeout", type=float, default=TIMEOUT_S, help=f"limit of each wait for simulator and Nav2, s (default: {TIMEOUT_S:g})"
    )
    parser.add_argument("--list", action="store_true", help="print the goals, send none")
    args, ros_args = parser.parse_known_args(argv)
    rclpy.init(args=ros_args)
    node = NamedGoals(args.timeout)
    try:
        goals = goals_of(node.named_poses(), args.tag, args.floor, args.goals)
        if args.list:
            for goal in goals:
                position = goal.pose.position
                print(f"{goal.name}: {position.x:.2f} {position.y:.2f} ({goal.description})")
            return 0
        if args.initial_pose:
            node.set_initial_pose()
        return 0 if node.drive_to(goals) == len(goals) else 1
    except NavigationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
