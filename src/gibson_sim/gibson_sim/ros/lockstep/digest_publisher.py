"""Publishes digests of all data that a node publishes at a tick, by which two runs are compared."""

from __future__ import annotations

from array import array
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDigest
from gibson_sim.digests import digest_of
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos


class DigestPublisher:
    """Collects digests of published data and publishes them once per tick.

    Publishes:
        tick_digest (gibson_msgs/TickDigest).
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(TickDigest, names.TICK_DIGEST, **qos.overridable(qos.INPUTS))
        self._digests: dict[str, int] = {}

    def add(self, topic: str, *values: Any) -> None:
        """Adds the digest of values published on a topic; a second digest within a tick is combined with the first."""
        topic, digest = self._node.resolve_topic_name(topic), digest_of(values)
        previous = self._digests.get(topic)
        self._digests[topic] = digest if previous is None else digest_of((previous, digest))

    def publish(self, stamp_ns: int, epoch: int, step: int) -> None:
        """Publishes the collected digests, if there are any."""
        if not self._digests:
            return
        message = TickDigest(header=conversions.header_to_msg(stamp_ns, ""), epoch=epoch, step=step)
        message.topics, message.digests = list(self._digests), array("Q", self._digests.values())
        self._digests = {}
        self._publisher.publish(message)

    def clear(self) -> None:
        """Discards the digests collected since the last tick: the simulation was reset."""
        self._digests = {}
