"""DDS discovery: waits until publishers and subscribers are matched before time starts, and until messages are acknowledged at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible

from gibson_sim.ros.nodes.node_main import is_running
from gibson_sim.ros.wire.message_types import type_name_of

DISCOVERY_S, LATE_DISCOVERY_S = 3.0, 10.0
"""Time in which a new DDS participant discovers the endpoints of the others, s of wall time: normally, and on a busy machine.

Most endpoints are known after 0.6 s; a lost packet of the discovery is repeated after 2 s."""
_START_TIMEOUT_S = 120.0
"""Timeout after which a run starts without the missing peers, s of wall time."""
_LOG_AFTER_S = 10.0
"""Time after which the missing peers are logged, s of wall time."""
_ACKNOWLEDGE_TIMEOUT_S = 1.0
"""Timeout for the acknowledgement of the last messages, s of wall time: a subscriber that was killed never acknowledges."""


def offered_service(node: Node, kind: Any) -> str:
    """Returns the name of a service that another node offers, of the type ``kind``, a class; empty = there is none."""
    type_name, services = type_name_of(kind), node.get_service_names_and_types()
    return next((name for name, types in services if type_name in types and node.count_services(name)), "")


def is_fully_matched(node: Node, publisher: Publisher) -> bool:
    """Returns whether a publisher is matched with all discovered subscribers of its topic, so that they receive its later messages.

    Subscribers of another type or with an incompatible QoS profile can never be matched and do not count: a topic such as ``cmd_vel`` may
    have subscribers for Twist and for TwistStamped.
    """
    type_name, profile = type_name_of(publisher.msg_type), publisher.qos_profile
    expected = sum(
        endpoint.topic_type == type_name and qos_check_compatible(profile, endpoint.qos_profile)[0] != QoSCompatibility.ERROR
        for endpoint in node.get_subscriptions_info_by_topic(publisher.topic_name)
    )
    return bool(publisher.get_subscription_count() >= expected)


def wait_for_peers(
    node: Node,
    executor: Executor,
    subscribers: Mapping[str, int],
    conditions: Mapping[str, Callable[[], bool]],
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Spins until all peers of a run are discovered; logs the missing ones after ten seconds, and continues without them after two minutes.

    Args:
        node: node that waits.
        executor: executor of the node.
        subscribers: topic -> number of subscribers that it must have; if the node publishes the topic, they must be matched.
        conditions: name of another condition -> function that returns whether it holds.
        meanwhile: called in every iteration.
    """
    start = time.monotonic()
    logged = False
    publishers = {publisher.topic_name: publisher for publisher in node.publishers}
    while is_running():
        meanwhile()
        missing = [
            f"subscribers of {topic} ({count})"
            for topic, count in subscribers.items()
            if not _has(node, publishers, topic, count)
        ]
        missing += [name for name, holds in conditions.items() if not holds()]
        if not missing:
            return
        waited = time.monotonic() - start
        if waited > _LOG_AFTER_S and not logged:
            logged = True
            node.get_logger().info(f"before time starts, waiting for {', '.join(missing)}")
        if waited > _START_TIMEOUT_S:
            node.get_logger().warning(f"still missing after {_START_TIMEOUT_S:.0f} s, starting without: {', '.join(missing)}")
            return
        executor.spin_once(timeout_sec=0.05)


def _has(node: Node, publishers: Mapping[str, Publisher], topic: str, count: int) -> bool:
    publisher = publishers.get(node.resolve_topic_name(topic))
    return node.count_subscribers(topic) >= count and (publisher is None or publisher.get_subscription_count() >= count)


def wait_until_acknowledged(*publishers: Publisher) -> None:
    """Blocks until all subscribers have acknowledged the published messages, at most a second, so that the end of the process loses none."""
    deadline = time.monotonic() + _ACKNOWLEDGE_TIMEOUT_S
    for publisher in publishers:
        remaining = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(nanoseconds=int(remaining * 1e9)))
