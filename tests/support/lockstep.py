"""A controller in a process of its own that takes part in lockstep, and notes the digests of what it controls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Image, LaserScan

from gibson_msgs.msg import TickDigest
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from support.clients import DEEP, stamp_ns
from support.simulation import Listener

ALL_OF_IT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NAME = "test_listener"
"""Of the node, and so of the participant."""
Digests = dict[tuple[int, int, str], int]
"""(epoch, step since it began, topic) -> digest."""


class Controller:
    """Turns away from what is near, by odometry and the scans before it; the same inputs give the same commands."""

    def __init__(self, listener: Listener, *, images: tuple[str, ...] = (), takes_part: bool = True) -> None:
        node = self.node = listener.node
        self.digests, self.ticks = Digests(), 0
        self.hangs_after = math.inf
        self.images: dict[str, list[int]] = {topic: [] for topic in images}
        self._scans: list[Any] = []
        self._publisher = node.create_publisher(Twist, "cmd_vel", 1)
        self._scan_subscription = node.create_subscription(LaserScan, "scan", lambda msg: self._scans.append(msg), DEEP)
        for topic in images:
            node.create_subscription(Image, topic, lambda msg, t=topic: self.images[t].append(stamp_ns(msg)), 5)
        node.create_subscription(TickDigest, "tick_digest", self._on_digest, ALL_OF_IT)
        node.create_subscription(Odometry, "odom", self._on_odometry, DEEP)
        if images:
            listener.spin_until(lambda: all(node.count_publishers(t) for t in images), "cameras")
        self._participant = LockstepParticipant(node, after="odom") if takes_part else None

    def _on_digest(self, msg: Any) -> None:
        for topic, digest in zip(msg.topics, msg.digests, strict=True):
            self.digests[msg.epoch, msg.step, topic] = int(digest)

    def _on_odometry(self, msg: Any) -> None:
        self.ticks += 1
        if self.ticks > self.hangs_after:
            return
        # The scan of this very tick may be here or not; those before it are, but perhaps in the queue.
        self._scans += _waiting(self._scan_subscription)
        before = [scan for scan in self._scans if stamp_ns(scan) < stamp_ns(msg)]
        command = Twist()
        command.linear.x = 0.3
        if before:
            self._scans = [before[-1], *(scan for scan in self._scans if stamp_ns(scan) >= stamp_ns(msg))]
            ranges = np.nan_to_num(np.asarray(before[-1].ranges), posinf=10.0)
            left, right = float(ranges[20:90].min()), float(ranges[-90:-20].min())
            command.linear.x = 0.3 * min(1.0, float(ranges[[*range(20), *range(-20, 0)]].min()))
            command.angular.z = max(-1.5, min(1.5, left - right)) + 0.2 * msg.twist.twist.linear.x
        self._publisher.publish(command)
        if self._participant is not None:
            self._participant.tick_done(msg.header.stamp, [self._publisher.topic_name])


def _waiting(subscription: Any) -> Iterator[Any]:
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken[0]
