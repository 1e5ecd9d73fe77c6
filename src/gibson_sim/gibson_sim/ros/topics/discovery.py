"""DDS discovery: waits until publishers and subscribers are matched before time starts, and until messages are acknowledged at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher

from gibson_sim.ros.nodes.node_main import is_running

_START_TIMEOUT_S = 120.0
"""Wall time after which a run starts without the peers that are missing, s."""
_LOG_AFTER_S = 10.0
"""Wall time after which it logs what it waits for, s."""
_ACKNOWLEDGE_TIMEOUT_S = 1.0
"""Wall time that the last messages may take to their subscribers, s: one that was killed never acknowledges."""


def is_fully_matched(node: Node, publisher: Publisher) -> bool:
    """Returns whether a publisher is matched with all known subscribers of its topic, so that they get what it publishes from now on."""
    return bool(publisher.get_subscription_count() >= node.count_subscribers(publisher.topic_name))


def wait_for_peers(
    node: Node,
    executor: Executor,
    subscribers: Mapping[str, int],
    others: Mapping[str, Callable[[], bool]],
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Spins until all peers of a run are there; logs after ten seconds which are missing, and goes on without them after two minutes.

    Args:
        node: that waits.
        executor: of the node.
        subscribers: topic -> number of subscribers that it must have; where the node publishes the topic, they must be matched.
        others: name of another condition -> whether it holds.
        meanwhile: called again and again.
    """
    began = time.monotonic()
    logged = False
    own = {publisher.topic_name: publisher for publisher in node.publishers}
    while is_running():
        meanwhile()
        missing = [
            f"subscribers of {topic} ({count})" for topic, count in subscribers.items() if not _has(node, own, topic, count)
        ]
        missing += [what for what, is_there in others.items() if not is_there()]
        if not missing:
            return
        waited = time.monotonic() - began
        if waited > _LOG_AFTER_S and not logged:
            logged = True
            node.get_logger().info(f"before time starts, waiting for {', '.join(missing)}")
        if waited > _START_TIMEOUT_S:
            node.get_logger().warning(f"still missing after {_START_TIMEOUT_S:.0f} s, starting without: {', '.join(missing)}")
            return
        executor.spin_once(timeout_sec=0.05)


def _has(node: Node, own: Mapping[str, Publisher], topic: str, count: int) -> bool:
    publisher = own.get(node.resolve_topic_name(topic))
    return node.count_subscribers(topic) >= count and (publisher is None or publisher.get_subscription_count() >= count)


def wait_until_acknowledged(*publishers: Publisher) -> None:
    """Blocks until all subscribers have acknowledged what was published, at most a second, so that a process that ends loses nothing."""
    deadline = time.monotonic() + _ACKNOWLEDGE_TIMEOUT_S
    for publisher in publishers:
        left = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(nanoseconds=int(left * 1e9)))
