"""``gibson-sim topic`` while the nodes of a topic are being discovered."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from support.simulation import PATIENCE_S, new_context, require

require("rclpy", "gibson_msgs")

import rclpy  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data  # noqa: E402
from std_msgs.msg import Int8, String  # noqa: E402

from gibson_sim.errors import GibsonSimError  # noqa: E402
from gibson_sim.ros.tools import topics  # noqa: E402
from gibson_sim.ros.tools.subscription import relaxed  # noqa: E402
from gibson_sim.ros.tools.tool import Tool  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_domain")]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TYPE = "std_msgs/msg/String"


@pytest.fixture
def tool(ros_domain: int) -> Iterator[Tool]:
    """A tool in this process."""
    rclpy.init(args=[])
    tool = Tool(lambda tool: 0)
    yield tool
    tool.close()
    tool.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def others(ros_domain: int) -> Iterator[list[Node]]:
    """Two nodes in participants of their own: a recorder and a publisher."""
    contexts = [new_context() for _ in range(2)]
    nodes = [
        Node(name, context=context, use_global_arguments=False, start_parameter_services=False)
        for name, context in zip(("recorder", "publisher"), contexts, strict=True)
    ]
    yield nodes
    for node, context in zip(nodes, contexts, strict=True):
        node.destroy_node()
        context.shutdown()


def test_a_latched_message_is_received_once_if_only_a_subscriber_is_discovered_at_first(
    tool: Tool, others: list[Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder, publisher = others
    recorder.create_subscription(String, "/slow", lambda msg: None, 1)
    latched = publisher.create_publisher(String, "/slow", LATCHED)
    latched.publish(String(data="once"))
    assert tool.spin_until(PATIENCE_S, lambda: tool.count_publishers("/slow") == 1)
    received: list[Any] = []
    with monkeypatch.context() as undiscovered:
        undiscovered.setattr(tool, "get_publishers_info_by_topic", lambda topic: [])
        assert tool.subscribe("/slow", lambda msg: received.append(msg.data)) == ("/slow", TYPE)
    assert tool.spin_until(PATIENCE_S, lambda: bool(received))
    tool.spin_until(0.5)
    assert received == ["once"]


@pytest.mark.parametrize("profile", [LATCHED, QoSProfile(depth=1), qos_profile_sensor_data])
def test_a_message_is_received_once_that_arrives_before_its_publisher_is_discovered(
    tool: Tool, others: list[Node], profile: QoSProfile
) -> None:
    received: list[Any] = []
    tool.subscribe("/slow", lambda msg: received.append(msg.data), kind=TYPE)
    publisher = others[1].create_publisher(String, "/slow", profile)
    deadline = time.monotonic() + PATIENCE_S
    while not publisher.get_subscription_count():  # the tool does not spin, and does not see it
        assert time.monotonic() < deadline
        time.sleep(0.01)
    publisher.publish(String(data="once"))
    assert tool.spin_until(PATIENCE_S, lambda: bool(received))
    tool.spin_until(0.5)
    assert received == ["once"]


def test_messages_of_a_best_effort_publisher_are_received_that_is_discovered_after_a_latched_one(
    tool: Tool, others: list[Node]
) -> None:
    publisher, other = others
    publisher.create_publisher(String, "/slow", LATCHED).publish(String(data="latched"))
    received: list[Any] = []
    tool.subscribe("/slow", lambda msg: received.append(msg.data))
    assert tool.spin_until(PATIENCE_S, lambda: bool(received))
    volatile = other.create_publisher(String, "/slow", qos_profile_sensor_data)

    def arrives() -> bool:
        volatile.publish(String(data="volatile"))
        return "volatile" in received

    assert tool.spin_until(PATIENCE_S, arrives)
    assert received.count("latched") == 1


def test_a_publisher_that_is_discovered_last_is_counted(
    tool: Tool, others: list[Node], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder, publisher = others
    recorder.create_subscription(String, "/slow", lambda msg: None, 1)
    monkeypatch.setattr(tool, "discover", lambda *_: publisher.create_publisher(String, "/slow", LATCHED))
    topics.topic_info(tool, "/slow", verbose=True)
    assert capsys.readouterr().out == (
        f"Type: {TYPE}\nPublisher count: 1\n  node /publisher: RELIABLE, TRANSIENT_LOCAL\n"
        "Subscription count: 1\n  node /recorder: RELIABLE, VOLATILE\n"
    )


def test_the_type_of_a_topic_is_printed(tool: Tool, others: list[Node], capsys: pytest.CaptureFixture[str]) -> None:
    others[1].create_publisher(String, "/slow", LATCHED)
    topics.topic_type(tool, "/slow")
    assert capsys.readouterr().out == f"{TYPE}\n"


def test_a_given_type_is_that_of_a_topic_that_does_not_exist_yet(tool: Tool, others: list[Node]) -> None:
    received: list[Any] = []
    assert tool.subscribe("/later", lambda msg: received.append(msg.data), kind=TYPE) == ("/later", TYPE)
    others[1].create_publisher(String, "/later", LATCHED).publish(String(data="once"))
    assert tool.spin_until(PATIENCE_S, lambda: bool(received))


def test_a_given_type_selects_one_of_two(tool: Tool, others: list[Node]) -> None:
    for node, kind in zip(others, (String, Int8), strict=True):
        node.create_publisher(kind, "/both", 1)
    assert tool.spin_until(PATIENCE_S, lambda: len(tool.known_topics().get("/both", ())) == 2)
    with pytest.raises(GibsonSimError, match=r"has several types: .*`gibson-sim topic echo /both std_msgs/msg/"):
        tool.type_of("/both")
    assert tool.subscribe("/both", lambda msg: None, kind=TYPE) == ("/both", TYPE)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("std_msgs/msg/Int8", "topic '/slow' has the type std_msgs/msg/String, not 'std_msgs/msg/Int8'"),
        ("std_msgs/msg/Sting", "the message type 'std_msgs/msg/Sting' is not installed in this environment"),
        ("std_srvs/srv/Trigger", "the message type 'std_srvs/srv/Trigger' is not installed in this environment"),
        ("String", "a type is written as in std_msgs/msg/String"),
    ],
)
def test_a_given_type_that_a_topic_does_not_have_is_refused(tool: Tool, others: list[Node], given: str, said: str) -> None:
    others[1].create_publisher(String, "/slow", LATCHED)
    with pytest.raises(GibsonSimError, match=said):
        tool.subscribe("/slow", lambda msg: None, kind=given)


def test_a_requested_profile_is_never_stricter_than_before() -> None:
    strict = relaxed(LATCHED, [])
    assert (strict.reliability, strict.durability) == (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
    volatile = relaxed(strict, [LATCHED, QoSProfile(depth=1)])
    assert (volatile.reliability, volatile.durability) == (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
    assert relaxed(volatile, [LATCHED]) == volatile
    assert relaxed(volatile, [qos_profile_sensor_data]).reliability == ReliabilityPolicy.BEST_EFFORT
