"""Who hears whom: nothing is published before those hear it who must, and nothing is lost at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher

from gibson_sim.ros.nodes.node_main import is_running

_START_LIMIT_S, _SAY_S = 120.0, 10.0
"""Wall time after which a run starts without what is missing, and after which it says what it waits for."""
_END_LIMIT_S = 1.0
"""Wall time that the last messages may take to their subscribers, s: one that was killed never confirms."""


def reaches_all(node: Node, publisher: Publisher) -> bool:
    """Returns whether all who are known to listen to a publisher of a node get what it publishes from now on."""
    return bool(publisher.get_subscription_count() >= node.count_subscribers(publisher.topic_name))


def wait_for_others(
    node: Node, executor: Executor, subscribers: Mapping[str, int], others: Mapping[str, Callable[[], bool]]
) -> None:
    """Works until all that a run needs is there; says after ten seconds what is missing, and after two minutes returns without it.

    Args:
        node: who waits.
        executor: of the node.
        subscribers: topic -> how many subscribers it must have; where the node publishes it, they must receive it.
        others: what else is awaited -> whether it is there.
    """
    began = time.monotonic()
    said = False
    own = {publisher.topic_name: publisher for publisher in node.publishers}
    while is_running():
        missing = [
            f"subscribers of {topic} ({count})" for topic, count in subscribers.items() if not _has(node, own, topic, count)
        ]
        missing += [what for what, is_there in others.items() if not is_there()]
        if not missing:
            return
        waited = time.monotonic() - began
        if waited > _SAY_S and not said:
            said = True
            node.get_logger().info(f"time waits for {', '.join(missing)}")
        if waited > _START_LIMIT_S:
            node.get_logger().warning(f"still missing after {_START_LIMIT_S:.0f} s, starting without: {', '.join(missing)}")
            return
        executor.spin_once(timeout_sec=0.05)


def _has(node: Node, own: Mapping[str, Publisher], topic: str, count: int) -> bool:
    publisher = own.get(node.resolve_topic_name(topic))
    return node.count_subscribers(topic) >= count and (publisher is None or publisher.get_subscription_count() >= count)


def wait_until_received(*publishers: Publisher) -> None:
    """Returns once all subscribers have what was published, or after a second: whoever ends then takes nothing with it."""
    deadline = time.monotonic() + _END_LIMIT_S
    for publisher in publishers:
        left = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(nanoseconds=int(left * 1e9)))
