"""When a new participant counts as matched: not before its subscriptions are discovered, whatever else is."""

from __future__ import annotations

import logging

import pytest

rclpy = pytest.importorskip("rclpy")

from collections.abc import Callable  # noqa: E402
from types import SimpleNamespace  # noqa: E402
from typing import Any  # noqa: E402

from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402

from gibson_msgs.msg import TickDone  # noqa: E402
from gibson_sim.config import SyncSettings  # noqa: E402
from gibson_sim.ros.lockstep import lockstep_gate  # noqa: E402
from gibson_sim.ros.lockstep.lockstep_gate import LockstepGate  # noqa: E402
from gibson_sim.ros.nodes.physics_node import PhysicsNode  # noqa: E402
from gibson_sim.ros.topics import names  # noqa: E402
from gibson_sim.standard.lockstep import CAMERAS  # noqa: E402


class Graph:
    """The node of a simulation, as far as the gate asks it, and what it has discovered of another one called ``nav``."""

    def __init__(self) -> None:
        self.listens_to: list[str] = []
        """Subscriptions of ``nav`` that were discovered."""
        self.nodes = ["nav"]
        """Those that publish ``tick_done``."""
        self.matched: dict[str, int] = {"/odom": 0, "/scene_state": 0, "/tf": 0}
        """Topic that the simulation publishes -> matched subscribers."""

    @property
    def publishers(self) -> list[Any]:
        return [
            SimpleNamespace(
                topic_name=t, get_subscription_count=lambda n=n: n, msg_type=TickDone, qos_profile=QoSProfile(depth=1)
            )
            for t, n in self.matched.items()
        ]

    def create_subscription(self, *_: Any, **__: Any) -> None:
        pass

    def get_logger(self) -> logging.Logger:
        return logging.getLogger("simulation")

    def get_namespace(self) -> str:
        return "/"

    def resolve_topic_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{topic}"

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(name, "/") for name in self.nodes]

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(node_name=name, node_namespace="/") for name in self.nodes if topic == names.TICK_DONE]

    def get_subscriber_names_and_types_by_node(self, name: str, namespace: str) -> list[tuple[str, list[str]]]:
        return [(topic, []) for topic in self.listens_to]

    def get_subscriptions_info_by_topic(self, topic: str) -> list[Any]:
        endpoint = SimpleNamespace(topic_type="gibson_msgs/msg/TickDone", qos_profile=QoSProfile(depth=1))
        return [endpoint] * self.listens_to.count(topic)


@pytest.mark.parametrize(("after", "topic"), [("odom", "/odom"), (CAMERAS, "/scene_state")])
def test_a_participant_is_not_matched_before_its_subscription_is(after: str, topic: str) -> None:
    graph = Graph()
    gate = LockstepGate(graph, SyncSettings(), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.core.join("nav", after)
    assert not gate._is_matched("nav")  # its publishers were discovered first
    graph.listens_to = ["/tf"]
    graph.matched["/tf"] = 1
    assert not gate._is_matched("nav")
    graph.listens_to.append(topic)
    assert not gate._is_matched("nav")
    graph.matched[topic] = 1
    assert gate._is_matched("nav")


class Beside:
    """The context of commands of a second type: no JOIN has arrived in it yet."""

    def __init__(self) -> None:
        self.callback: Callable[[Any], None] | None = None

    def subscribe(self, kind: type[Any], topic: str, callback: Callable[[Any], None], profile: Any) -> str:
        self.callback = callback
        return topic

    def unsubscribe(self, subscription: str) -> None:
        assert subscription == names.TICK_DONE
        self.callback = None


def test_time_waits_until_a_join_has_arrived_in_both_contexts() -> None:
    graph, beside = Graph(), Beside()
    graph.listens_to, graph.matched = ["/odom"], {"/odom": 1}
    gate = LockstepGate(graph, SyncSettings(lockstep=True, participants="nav"), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.subscribe(beside)  # type: ignore[arg-type]
    joins = TickDone(event=TickDone.JOIN, participant="nav", after="odom")
    gate._on_tick_done(serialize_message(joins))
    assert not gate.may_step()  # its commands as TwistStamped might be lost
    assert beside.callback is not None
    beside.callback(joins)
    assert gate.may_step()
    assert gate.may_step() and beside.callback is None  # nor does it receive each tick that is done


def test_a_participant_that_can_join_has_discovered_all_command_subscriptions(ros_context: Any) -> None:
    """Subscriptions are announced in the order in which they were made."""
    settings = {"scene": "flat", "robot": "gibson_bot", "lockstep": True}
    node = PhysicsNode(
        context=ros_context, use_global_arguments=False, parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    try:
        topics = [subscription.topic_name for subscription in node.subscriptions]
        assert f"/{names.CMD_VEL}" in topics
        assert topics[-1] == f"/{names.TICK_DONE}"
    finally:
        node.close()
        node.destroy_node()


def test_a_participant_without_after_is_matched_once_its_known_subscriptions_are() -> None:
    graph = Graph()
    gate = LockstepGate(graph, SyncSettings(), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.core.join("nav")
    graph.listens_to = ["/tf"]
    assert not gate._is_matched("nav")
    graph.matched["/tf"] = 1
    assert gate._is_matched("nav")


@pytest.mark.parametrize("event", [TickDone.JOIN, TickDone.WATCH])
def test_time_goes_on_without_a_watcher_that_has_gone(event: int, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, beside = Graph(), Beside()
    gate = LockstepGate(graph, SyncSettings(lockstep=True), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.subscribe(beside)  # type: ignore[arg-type]
    gate._on_tick_done(serialize_message(TickDone(event=event, participant="nav")))
    gate.begin_tick(1, lambda: ())
    monkeypatch.setattr(lockstep_gate, "LATE_NS", -1)
    assert not gate.may_step()
    graph.nodes = []
    assert gate.may_step() == (event == TickDone.WATCH)
    assert bool(gate.core.participants) == (event == TickDone.JOIN)
