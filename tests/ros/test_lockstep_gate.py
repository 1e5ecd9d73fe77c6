"""When a new participant is believed to hear the simulation: not before its subscriptions are known, whatever else is."""

from __future__ import annotations

import pytest

rclpy = pytest.importorskip("rclpy")

from types import SimpleNamespace  # noqa: E402
from typing import Any  # noqa: E402

from gibson_sim.config import PhysicsConfig  # noqa: E402
from gibson_sim.ros import names  # noqa: E402
from gibson_sim.ros.lockstep_gate import LockstepGate  # noqa: E402
from gibson_sim.simulation.lockstep import CAMERAS  # noqa: E402


class Graph:
    """The node of a simulation, as far as the gate asks it, and what it has heard of another one called ``nav``."""

    def __init__(self) -> None:
        self.listens_to: list[str] = []
        """Topics of ``nav`` that have become known."""
        self.matched: dict[str, int] = {"/odom": 0, "/scene_state": 0, "/tf": 0}
        """Of each topic that the simulation publishes: how many are known to get it."""

    @property
    def publishers(self) -> list[Any]:
        return [SimpleNamespace(topic_name=t, get_subscription_count=lambda n=n: n) for t, n in self.matched.items()]

    def create_subscription(self, *_: Any, **__: Any) -> None:
        pass

    def resolve_topic_name(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{topic}"

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(node_name="nav", node_namespace="/")] if topic == names.TICK_DONE else []

    def get_subscriber_names_and_types_by_node(self, name: str, namespace: str) -> list[tuple[str, list[str]]]:
        return [(topic, []) for topic in self.listens_to]

    def count_subscribers(self, topic: str) -> int:
        return self.listens_to.count(topic)


@pytest.mark.parametrize(("after", "topic"), [("odom", "/odom"), (CAMERAS, "/scene_state")])
def test_one_whose_subscription_is_not_known_yet_is_waited_for(after: str, topic: str) -> None:
    graph = Graph()
    gate = LockstepGate(graph, PhysicsConfig(), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.core.join("nav", after)
    assert not gate._hears_us("nav")  # its news of publishers were the quicker ones
    graph.listens_to = ["/tf"]
    graph.matched["/tf"] = 1
    assert not gate._hears_us("nav")
    graph.listens_to.append(topic)
    assert not gate._hears_us("nav")
    graph.matched[topic] = 1
    assert gate._hears_us("nav")


def test_one_that_does_not_say_what_it_waits_for_hears_us_once_all_that_is_known_reaches_it() -> None:
    graph = Graph()
    gate = LockstepGate(graph, PhysicsConfig(), lambda: None, lambda again: None)  # type: ignore[arg-type]
    gate.core.join("nav")
    graph.listens_to = ["/tf"]
    assert not gate._hears_us("nav")
    graph.matched["/tf"] = 1
    assert gate._hears_us("nav")
