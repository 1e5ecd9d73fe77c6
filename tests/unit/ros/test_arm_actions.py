"""The actions of arms, with stand-ins for the server and for control_msgs, which many installations lack."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from support.arms import FINGERS, load_arm
from support.simulation import require

require("rclpy", "gibson_msgs")

from builtin_interfaces.msg import Duration, Time  # noqa: E402
from rclpy.action import CancelResponse, GoalResponse  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from gibson_sim.physics.world import PhysicsWorld  # noqa: E402
from gibson_sim.ros import conversions  # noqa: E402
from gibson_sim.ros.topics.arm_actions import GripperAction, TrajectoryAction  # noqa: E402
from gibson_sim.scenes.spec import SceneSpec  # noqa: E402

KIND = SimpleNamespace(Result=SimpleNamespace, Feedback=SimpleNamespace)


class Goal:
    """Replaces rclpy's goal handle: a goal executes when it is over."""

    def __init__(self, request: Any) -> None:
        self.request, self.feedback, self.result, self.status = request, [], SimpleNamespace(), ""  # type: ignore[var-annotated]
        self.is_cancel_requested = False

    def execute(self, finish: Any) -> None:
        self.result = finish(self)

    def publish_feedback(self, message: Any) -> None:
        self.feedback.append(message)

    def succeed(self) -> None:
        self.status = "succeeded"

    def abort(self) -> None:
        self.status = "aborted"

    def canceled(self) -> None:
        self.status = "canceled"


class Rig:
    """A world, an action, and a server that does what a test says."""

    def __init__(self, folder: Path) -> None:
        robot = load_arm(folder)
        self.world = PhysicsWorld(SceneSpec("test", folder, "", (), (), ground_z=0.0, gravity=(0.0, 0.0, 0.0), robots=(robot,)))
        self.sent: list[tuple[str, Any, Any]] = []
        self.callbacks: dict[str, Any] = {}
        self.warnings: list[str] = []
        self.node: Any = SimpleNamespace(get_logger=lambda: SimpleNamespace(warning=self.warnings.append))
        arm = robot.manipulators[0]
        self.arm = TrajectoryAction(
            self.node, KIND, "follow", "arm_topic", arm.joints, self._send, lambda: self.world.stamp_ns, make_server=self._server
        )
        self.of_arm = self.callbacks
        self.gripper = GripperAction(self.node, KIND, "grip", "gripper_topic", FINGERS, self._send, make_server=self._server)
        self.of_gripper = self.callbacks

    def _server(self, node: Any, kind: Any, name: str, **callbacks: Any) -> Any:
        self.callbacks = callbacks
        return SimpleNamespace(destroy=lambda: None)

    def _send(self, topic: str, message: Any, answer: Any) -> None:
        self.sent.append((topic, message, answer))

    def accept(self, callbacks: dict[str, Any], request: Any) -> Goal:
        assert callbacks["goal_callback"](request) is GoalResponse.ACCEPT, self.warnings
        goal = Goal(request)
        callbacks["handle_accepted_callback"](goal)
        return goal

    def ticks(self, count: int) -> None:
        for _ in range(count):
            for _, message, answer in self.sent:
                problem = ""
                try:
                    self.world.command_joints("robot", conversions.joint_command_from_msg(message))
                except Exception as error:
                    problem = str(error)
                answer(self.world, problem)
            self.sent.clear()
            self.world.step(4)
            self.arm.update("robot", self.world)
            self.gripper.update("robot", self.world)


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    yield made
    made.world.close()


def request(name: str, position: float, *, milliseconds: int = 500, stamp_s: int = 0, path: float | None = None) -> Any:
    time = Duration(nanosec=milliseconds * 1_000_000)
    trajectory = JointTrajectory(joint_names=[name], points=[JointTrajectoryPoint(positions=[position], time_from_start=time)])
    trajectory.header.stamp = Time(sec=stamp_s)
    tolerance = [] if path is None else [SimpleNamespace(name=name, position=path, velocity=0.0)]
    return SimpleNamespace(trajectory=trajectory, path_tolerance=tolerance, goal_tolerance=[], goal_time_tolerance=Duration())


def test_trajectory_succeeds_with_feedback_on_the_way(rig: Rig) -> None:
    goal = rig.accept(rig.of_arm, request("turn", 0.3))
    rig.ticks(60)
    assert (goal.status, goal.result.error_code) == ("succeeded", 0)
    # Every 0.05 s of half a second.
    assert 8 <= len(goal.feedback) <= 12
    middle = goal.feedback[len(goal.feedback) // 2]
    assert middle.joint_names == ["turn"]
    assert 0.05 < middle.desired.positions[0] < 0.3
    assert middle.error.positions[0] == pytest.approx(middle.desired.positions[0] - middle.actual.positions[0])


def test_new_goal_and_a_reset_end_the_one_before(rig: Rig) -> None:
    first, second = (rig.accept(rig.of_arm, request("turn", at)) for at in (0.3, -0.3))
    assert (first.status, first.result.error_code, first.result.error_string) == (
        "aborted", -1, "another command for these joints arrived",
    )  # fmt: skip
    rig.ticks(3)
    rig.arm.preempt("the simulation was reset")
    assert (second.status, second.result.error_string) == ("aborted", "the simulation was reset")


def test_cancel_stops_the_joints(rig: Rig) -> None:
    goal = rig.accept(rig.of_arm, request("turn", 0.5))
    rig.ticks(10)
    goal.is_cancel_requested = True
    assert rig.of_arm["cancel_callback"](goal) is CancelResponse.ACCEPT
    assert goal.status == "canceled"
    assert rig.of_arm["cancel_callback"](goal) is CancelResponse.REJECT
    rig.ticks(5)
    there = rig.world.joint_states("robot").positions[0]
    rig.ticks(30)
    assert rig.world.joint_states("robot").positions[0] == pytest.approx(there, abs=2e-3)
    assert there < 0.3


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        (request("nose", 0.3), "joint 'nose' does not belong to this controller"),
        (request("turn", float("nan")), "must be finite"),
        (SimpleNamespace(trajectory=JointTrajectory(), path_tolerance=[], goal_tolerance=[]), "joint trajectory has no points"),
        (
            request("turn", 0.3, stamp_s=1),
            "joint trajectory ended at 1.5 s, now it is 2 s; set its stamp to 0 to start it immediately",
        ),
    ],
)
def test_impossible_goal_is_refused_with_a_reason(rig: Rig, asked: Any, reason: str) -> None:
    rig.world.set_step_count(480)
    assert rig.of_arm["goal_callback"](asked) is GoalResponse.REJECT
    assert reason in rig.warnings[-1]


def test_impossible_motion_of_the_arm_ends_the_goal(rig: Rig) -> None:
    goal = rig.accept(rig.of_arm, request("turn", 9.0))
    rig.ticks(1)
    assert (goal.status, goal.result.error_code) == ("aborted", -1)
    assert "joint 'turn': position of point 0 is 9, must be -2 to 2" in goal.result.error_string
    goal = rig.accept(rig.of_arm, request("turn", 0.6, path=1e-5))
    rig.ticks(20)
    assert (goal.status, goal.result.error_code) == ("aborted", -4)
    assert "off its path, allowed are 1e-05" in goal.result.error_string


def test_gripper_closes_and_can_be_canceled(rig: Rig) -> None:
    goal = rig.accept(rig.of_gripper, SimpleNamespace(command=SimpleNamespace(position=0.0, max_effort=0.0)))
    rig.ticks(60)
    assert (goal.status, goal.result.reached_goal, goal.result.stalled) == ("succeeded", True, False)
    assert goal.result.position == pytest.approx(0.0, abs=1e-3)
    goal = rig.accept(rig.of_gripper, SimpleNamespace(command=SimpleNamespace(position=0.05, max_effort=20.0)))
    rig.ticks(5)
    goal.is_cancel_requested = True
    assert rig.of_gripper["cancel_callback"](goal) is CancelResponse.ACCEPT
    rig.ticks(5)
    there = rig.world.joint_states("robot").positions[-1]
    rig.ticks(30)
    assert rig.world.joint_states("robot").positions[-1] == pytest.approx(there, abs=1e-3)
    assert there < 0.04
    goal = rig.accept(rig.of_gripper, SimpleNamespace(command=SimpleNamespace(position=0.5, max_effort=20.0)))
    rig.ticks(1)
    assert goal.status == "aborted"
