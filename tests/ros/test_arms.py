"""Arms as their clients see them: topics, the service, the actions. Physics and clients are in one process."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from support.arms import FINGERS, load_arm
from support.simulation import Listener, require

require("rclpy", "gibson_msgs")

from builtin_interfaces.msg import Duration  # noqa: E402
from geometry_msgs.msg import TwistStamped  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.node import Node  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint  # noqa: E402

from gibson_msgs.msg import CollisionCount, GraspState  # noqa: E402
from gibson_sim.description.body import BodySpec  # noqa: E402
from gibson_sim.description.shapes import Shape  # noqa: E402
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel  # noqa: E402
from gibson_sim.physics.world import PhysicsWorld  # noqa: E402
from gibson_sim.ros.nodes.node_main import make_executor  # noqa: E402
from gibson_sim.ros.topics.arm_actions import control_actions  # noqa: E402
from gibson_sim.ros.topics.arm_interface import ArmInterface  # noqa: E402
from gibson_sim.scenes.spec import SceneSpec  # noqa: E402
from gibson_sim.types import Pose  # noqa: E402

pytestmark = pytest.mark.ros
STEPS = 4
"""Physics steps in a tick."""


class Rig:
    """A world, and the topics of its robot's arm; ticks are made as fast as possible."""

    def __init__(self, context: Any, folder: Path) -> None:
        box = UrdfCollision(Shape("box", (0.06, 0.06, 0.06)), Pose())
        link = UrdfLink("body", (), (box,), Inertial(0.2, Pose(), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)))
        cup = BodySpec("cup", UrdfModel("cup", Path("/nowhere/x.urdf"), (link,), ()), Pose((0.85, 0.0, 0.17)))
        robot = load_arm(folder)
        self.scene = SceneSpec(
            "test",
            folder,
            "",
            (),
            (),
            ground_z=0.0,
            gravity=(0.0, 0.0, 0.0),
            robots=(replace(robot, namespace="bot"),),
            bodies=(cup,),
        )
        self.world = PhysicsWorld(self.scene)
        self.node = Node("physics", context=context, use_global_arguments=False, start_parameter_services=False)
        self._executor = make_executor(context=context)
        self._executor.add_node(self.node)
        self.arms = ArmInterface(self.node, self.scene.robots[0], lambda topic: None, 0)
        self.inputs: list[tuple[int, str, Any]] = []
        self.positions: dict[int, Any] = {}
        """Step -> poses of all links."""
        self.refused = 0

    def record(self, name: str, message: Any) -> None:
        """Replaces the journal."""
        self.inputs.append((self.world.step_count, name, message))

    def tick(self) -> None:
        """Applies commands, makes a tick, publishes."""
        self._executor.spin_once(timeout_sec=0.001)
        self.arms.latch_commands()
        self.refused += self.arms.apply_commands(self.world, self)[1]  # type: ignore[arg-type]
        self.world.step(STEPS)
        self.positions[self.world.step_count] = self.world.state().positions
        self.arms.publish(self.world)

    def run_until(self, listener: Listener, condition: Callable[[], bool], what: str) -> None:
        """Makes ticks until a client's condition holds."""

        def look() -> bool:
            self.tick()
            return condition()

        listener.spin_until(look, what)

    def joints(self) -> dict[str, float]:
        states = self.world.joint_states("robot")
        return dict(zip(states.names, states.positions.tolist(), strict=True))

    def close(self) -> None:
        self.arms.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self.world.close()


@pytest.fixture
def rig(ros_context: Any, tmp_path: Path) -> Iterator[Rig]:
    made = Rig(ros_context, tmp_path)
    yield made
    made.close()


def trajectory(positions: dict[str, float], seconds: float = 0.5) -> JointTrajectory:
    whole = int(seconds)
    time = Duration(sec=whole, nanosec=round((seconds - whole) * 1e9))
    return JointTrajectory(
        joint_names=list(positions), points=[JointTrajectoryPoint(positions=list(positions.values()), time_from_start=time)]
    )


def test_commands_on_topics_are_applied_and_noted_so_that_a_run_can_be_repeated(rig: Rig, listener: Listener) -> None:
    client = listener.node
    states = listener.collect(GraspState, "bot/grasp_state")
    counts = listener.collect(CollisionCount, "bot/collisions")
    arm = client.create_publisher(JointTrajectory, "bot/arm_controller/joint_trajectory", 1)
    fingers = client.create_publisher(JointTrajectory, "bot/gripper_controller/joint_trajectory", 1)
    tool = client.create_publisher(TwistStamped, "bot/arm_servo/delta_twist_cmds", 1)
    grasp = client.create_publisher(Bool, "bot/grasp", 1)
    service = client.create_client(SetBool, "bot/grasp")
    listener.spin_until(
        lambda: all(p.get_subscription_count() for p in (arm, fingers, tool, grasp)) and service.service_is_ready(), "topics"
    )
    grasp.publish(Bool(data=True))
    rig.run_until(listener, lambda: bool(states) and states[-1].holding, "grasp")
    assert (states[-1].arm, states[-1].mode, states[-1].body, states[-1].link) == ("arm", "assisted", "cup", "body")
    arm.publish(trajectory({"turn": 0.3}))
    rig.run_until(listener, lambda: abs(rig.joints()["turn"] - 0.3) < 2e-3, "turned arm")
    assert rig.world.body_pose("cup").position[1] > 0.1
    before = rig.world.arms.tool_pose("robot").position
    twist = TwistStamped()
    twist.header.frame_id, twist.twist.linear.z = "tool", 0.2
    tool.publish(twist)
    rig.run_until(listener, lambda: rig.world.arms.tool_pose("robot").position[2] > before[2] + 0.03, "raised tool")
    fingers.publish(trajectory({FINGERS[0]: 0.045, FINGERS[1]: 0.02}))
    arm.publish(trajectory({"nose": 0.3}))
    rig.run_until(listener, lambda: rig.refused == 1 and rig.joints()[FINGERS[1]] < 0.03, "closed finger, and a refusal")
    answers = [service.call_async(SetBool.Request(data=data)) for data in (True, False)]
    rig.run_until(listener, lambda: all(answer.done() for answer in answers), "answers")
    assert [(answer.result().success, answer.result().message) for answer in answers] == [
        (True, "holds cup/body"),
        (True, "let go: on command"),
    ]
    rig.run_until(listener, lambda: not states[-1].holding, "state")
    rig.world.remove("cup")
    answer = service.call_async(SetBool.Request(data=True))
    rig.run_until(listener, answer.done, "answer")
    assert (answer.result().success, answer.result().message) == (False, "no movable link is within 0.2 m of tool")
    assert counts[-1].count == 0
    removed = rig.inputs.pop()[0]
    with PhysicsWorld(rig.scene) as again:
        arms = ArmInterface(rig.node, rig.scene.robots[0], lambda topic: None, 0)
        while again.step_count < removed - STEPS:
            for _, name, message in [item for item in rig.inputs if item[0] == again.step_count]:
                assert name in arms.command_topics
                arms.receive_command(name, message)
            arms.latch_commands()
            arms.apply_commands(again, _Nowhere())  # type: ignore[arg-type]
            again.step(STEPS)
            assert np.array_equal(again.state().positions, rig.positions[again.step_count]), again.step_count
        arms.close()


class _Nowhere:
    def record(self, name: str, message: Any) -> None:
        """Clears what was received."""


@pytest.fixture
def actions() -> Any:
    found = control_actions()
    assert found is not None, "no package control_msgs: `make setup` builds it, and so does colcon in ros_ws"
    return found


def test_arm_follows_the_trajectories_of_an_action(actions: Any, rig: Rig, listener: Listener) -> None:
    kind = actions.FollowJointTrajectory
    client = ActionClient(listener.node, kind, "bot/arm_controller/follow_joint_trajectory")
    listener.spin_until(client.server_is_ready, "action")
    feedback: list[Any] = []

    def send(goal: Any) -> Any:
        sent = client.send_goal_async(goal, feedback_callback=lambda message: feedback.append(message.feedback))
        rig.run_until(listener, sent.done, "goal")
        return sent.result()

    def result(handle: Any) -> tuple[int, int, str]:
        future = handle.get_result_async()
        rig.run_until(listener, future.done, "result")
        return future.result().status, future.result().result.error_code, future.result().result.error_string

    assert result(send(kind.Goal(trajectory=trajectory({"turn": 0.3})))) == (4, 0, "")
    assert rig.joints()["turn"] == pytest.approx(0.3, abs=0.01)
    assert list(feedback[-1].joint_names) == ["turn"]
    assert not send(kind.Goal(trajectory=trajectory({"nose": 0.3}))).accepted
    first, second = (
        send(kind.Goal(trajectory=trajectory({"turn": 0.9}, 2.0))),
        send(kind.Goal(trajectory=trajectory({"turn": 0.5}))),
    )
    assert result(first) == (6, -1, "another command for these joints arrived")
    assert result(second) == (4, 0, "")
    assert result(send(kind.Goal(trajectory=trajectory({"turn": 9.0}))))[:2] == (6, -1)
    slow = send(kind.Goal(trajectory=trajectory({"turn": -0.9}, 3.0)))
    canceled = slow.cancel_goal_async()
    rig.run_until(listener, canceled.done, "cancel")
    assert result(slow)[0] == 5
    there = rig.joints()["turn"]
    for _ in range(60):
        rig.tick()
    assert rig.joints()["turn"] == pytest.approx(there, abs=0.03)
    client.destroy()


def test_gripper_stalls_at_what_it_holds(actions: Any, rig: Rig, listener: Listener) -> None:
    kind = actions.GripperCommand
    rig.world.set_state("cup", Pose(rig.world.arms.tool_pose("robot").position))
    client = ActionClient(listener.node, kind, "bot/gripper_controller/gripper_cmd")
    listener.spin_until(client.server_is_ready, "action")
    for position, expected in ((0.0, (True, False)), (0.05, (False, True))):
        goal = kind.Goal()
        goal.command.position, goal.command.max_effort = position, 20.0
        sent = client.send_goal_async(goal)
        rig.run_until(listener, sent.done, "goal")
        future = sent.result().get_result_async()
        rig.run_until(listener, future.done, "result")
        found = future.result().result
        assert (future.result().status, found.stalled, found.reached_goal) == (4, *expected)
    assert math.isfinite(found.effort)
    client.destroy()


def test_actions_that_cannot_be_offered_are_named(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr("gibson_sim.ros.topics.arm_interface.control_actions", lambda: None)
    monkeypatch.setattr(rig.node, "get_logger", lambda: SimpleNamespace(warning=said.append))
    arms = ArmInterface(rig.node, replace(rig.scene.robots[0], namespace="lone"), lambda topic: None, 0)
    arms.close()
    assert said == [
        "no package control_msgs here: lone/arm_controller/follow_joint_trajectory, lone/gripper_controller/gripper_cmd are not offered, "
        "the topics are; install ros-jazzy-control-msgs, or build and source ros_ws, which has control_msgs"
    ]
