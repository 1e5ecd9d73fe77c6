"""The messages that count as answers of nodes that know nothing of lockstep: any topic, any type, whatever quality of service it has."""

from __future__ import annotations

import pytest

rclpy = pytest.importorskip("rclpy")

import logging  # noqa: E402
from collections.abc import Callable, Iterator  # noqa: E402
from types import SimpleNamespace  # noqa: E402
from typing import Any  # noqa: E402

from geometry_msgs.msg import PoseStamped, Twist  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402

from gibson_sim.config import SyncSettings  # noqa: E402
from gibson_sim.ros.lockstep import lockstep_gate  # noqa: E402
from gibson_sim.ros.lockstep.answer_subscriptions import AnswerSubscriptions  # noqa: E402
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate  # noqa: E402
from support.simulation import wait_until  # noqa: E402

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Two:
    """A simulation's node in the namespace ``/lab``, and a stack's node."""

    def __init__(self, context: Any) -> None:
        self.sim = Node("physics", namespace="/lab", context=context, use_global_arguments=False)
        self.stack = Node("stack", context=context, use_global_arguments=False)
        self.received: list[str] = []
        self._executor = SingleThreadedExecutor(context=context)
        for node in (self.sim, self.stack):
            self._executor.add_node(node)

    def answers(self, *topics: str, is_command: Callable[[str], bool] = lambda topic: False) -> AnswerSubscriptions:
        return AnswerSubscriptions(self.sim, topics, self.received.append, is_command)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        def looks() -> bool:
            self._executor.spin_once(timeout_sec=0.02)
            return condition()

        wait_until(looks, what)

    def close(self) -> None:
        self._executor.shutdown()
        self.sim.destroy_node()
        self.stack.destroy_node()


@pytest.fixture
def two(ros_context: Any) -> Iterator[Two]:
    found = Two(ros_context)
    yield found
    found.close()


def found(answers: AnswerSubscriptions, topic: str) -> Callable[[], bool]:
    """Returns whether a topic has a publisher whose messages arrive, looking again each time."""
    now_ns = iter(range(0, 10**15, 10**9))

    def looks() -> bool:
        answers.find(next(now_ns), again=True)
        return not answers.problem(topic) and answers.is_matched(topic)

    return looks


def pretend(two: Two, monkeypatch: pytest.MonkeyPatch, *types: str) -> None:
    """Lets the simulation see a publisher of each type."""
    info = [SimpleNamespace(topic_type=kind, qos_profile=LATCHED) for kind in types]
    monkeypatch.setattr(two.sim, "get_publishers_info_by_topic", lambda topic: info)
    monkeypatch.setattr(two.sim, "count_publishers", lambda topic: len(info))


@pytest.mark.parametrize("qos", [BEST_EFFORT, LATCHED, QoSProfile(depth=10)], ids=["best effort", "latched", "default"])
def test_messages_arrive_whatever_the_quality_of_service_of_their_publisher(two: Two, qos: QoSProfile) -> None:
    answers = two.answers("r1/pose")
    assert answers.problem("r1/pose") == "no publisher on r1/pose"
    publisher = two.stack.create_publisher(PoseStamped, "/r1/pose", qos)
    two.until(found(answers, "r1/pose"), "a subscription")
    two.until(lambda: publisher.get_subscription_count() == 1, "its match")
    publisher.publish(PoseStamped())
    two.until(lambda: two.received == ["r1/pose"], "a message")


def test_an_awaited_topic_is_subscribed_to_before_it_has_a_publisher(two: Two) -> None:
    answers = two.answers("goal_pose")
    assert answers.is_matched("goal_pose"), "nobody has it"
    two.stack.create_subscription(PoseStamped, "/goal_pose", lambda msg: None, 10)
    two.until(lambda: two.sim.count_subscribers("/goal_pose") == 1 and not answers.is_matched("goal_pose"), "who waits for it")
    now_ns = iter(range(0, 10**15, 10**9))
    two.until(lambda: not answers.find(next(now_ns)) and two.sim.count_subscribers("/goal_pose") == 2, "a subscription")  # type: ignore[func-returns-value]
    assert answers.is_matched("goal_pose")
    assert answers.problem("goal_pose") == "no publisher on goal_pose"


def test_messages_of_a_late_publisher_arrive_whatever_its_quality_of_service(two: Two) -> None:
    answers = two.answers("goal_pose")
    two.stack.create_subscription(PoseStamped, "/goal_pose", lambda msg: None, BEST_EFFORT)
    looks = found(answers, "goal_pose")
    two.until(lambda: not looks() and two.sim.count_subscribers("/goal_pose") == 2, "a subscription")
    publisher = two.stack.create_publisher(PoseStamped, "/goal_pose", BEST_EFFORT)
    two.until(looks, "another one")
    two.until(lambda: publisher.get_subscription_count() == 2, "its match")
    publisher.publish(PoseStamped())
    two.until(lambda: two.received == ["goal_pose"], "a message")


def test_a_latched_goal_arrives_though_it_was_given_before_the_simulation_subscribed(two: Two) -> None:
    answers = two.answers("goal_pose")
    two.stack.create_publisher(PoseStamped, "/goal_pose", LATCHED).publish(PoseStamped())
    two.until(found(answers, "goal_pose"), "a subscription")
    two.until(lambda: two.received == ["goal_pose"], "the goal")


def test_a_topic_of_several_types_is_named_with_them(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = two.answers("pose")
    pretend(two, monkeypatch, "std_msgs/msg/String", "geometry_msgs/msg/PoseStamped", "std_msgs/msg/String")
    answers.find(0)
    assert (
        answers.problem("pose") == "pose has several types, geometry_msgs/msg/PoseStamped, std_msgs/msg/String; remap all but one"
    )


def test_a_topic_that_the_simulation_has_under_another_type_is_named(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = two.answers("pose")
    two.sim.create_publisher(PoseStamped, "/pose", 10)
    pretend(two, monkeypatch, "std_msgs/msg/String")
    answers.find(0)
    assert answers.problem("pose") == "the simulation itself uses pose with another type than std_msgs/msg/String"


def test_commands_are_left_to_the_node_that_receives_them(two: Two) -> None:
    answers = two.answers("cmd_vel", is_command=lambda topic: topic == "/cmd_vel")
    two.stack.create_publisher(Twist, "/cmd_vel", 10)
    two.until(found(answers, "cmd_vel"), "a publisher")
    assert two.sim.count_subscribers("/cmd_vel") == 0


def test_a_type_that_is_not_installed_is_named(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = two.answers("pose")
    pretend(two, monkeypatch, "my_msgs/msg/Guess")
    answers.find(0)
    assert answers.problem("pose") == "the type of pose, 'my_msgs/msg/Guess', is not installed where the simulation runs"


def gate_of(node: Any, rules: str) -> LockstepGate:
    return LockstepGate(node, SyncSettings(lockstep=True, participants=rules), lambda: None, lambda again: None)


def test_names_of_rules_are_relative_to_the_namespace_of_the_simulation_or_absolute(two: Two) -> None:
    gate = gate_of(two.sim, "a=pose after scan from /goal; b=/r1/detections after camera/image_raw")
    assert gate.core.received_topics == {"lab/pose", "goal", "r1/detections"}
    assert gate.core.topics == {"lab/scan", "lab/camera/image_raw"}
    gate.begin_tick(1, lambda: {"lab/scan", "camera/image_raw"})
    assert gate.core.waits_for == ("b",), "a begins with its goal"


def test_time_begins_once_the_answers_of_a_rule_arrive(two: Two, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lockstep_gate, "_SETTLED_NS", 0)
    gate = gate_of(two.sim, "a=pose after scan")
    assert not gate.may_step()
    assert gate._describe_late() == "'a' to be discovered (no publisher on lab/pose)"
    publisher = two.stack.create_publisher(PoseStamped, "/lab/pose", 10)
    two.until(gate.may_step, "the start of time")
    assert publisher.get_subscription_count() == 1


def test_a_resting_participant_is_reported_and_a_slow_one_makes_the_run_unrepeatable(
    two: Two, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(lockstep_gate, "_SETTLED_NS", 0)
    monkeypatch.setattr(lockstep_gate, "IDLE_NS", -1)
    monkeypatch.setattr(two.sim, "get_logger", lambda: logging.getLogger("simulation"))
    gate = gate_of(two.sim, "nav=/plan every 0.05 from /goal")
    two.stack.create_publisher(PoseStamped, "/plan", 10)
    two.until(gate.may_step, "the start of time")
    gate.receive_command("/goal")
    gate.begin_tick(50_000_000, lambda: ())
    with caplog.at_level(logging.INFO):
        assert gate.may_step()
    assert "'nav' has sent nothing on plan in answer to 0.050 s; time goes on without it until" in caplog.text
    assert gate.timeouts == 0, "it may have been idle"
    gate.receive_command("/plan")
    assert gate.timeouts == 1
    assert "'nav' sends again on plan" in caplog.text
