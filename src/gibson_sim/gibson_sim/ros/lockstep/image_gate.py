"""Holds time for images that have subscribers, while the simulation runs as fast as possible without lockstep."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.quoting import quoted
from gibson_sim.ros.topics import names, qos
from gibson_sim.standard.lockstep import CAMERAS
from gibson_sim.types import NS_PER_S, CameraSpec

_GRAPH_PERIOD_NS = NS_PER_S // 10
"""Period of the queries of the publishers and subscribers of images, ns of wall time."""
_REPUBLISH_PERIOD_NS = NS_PER_S // 2
"""Period at which the present tick is republished for a render node that has never answered, ns of wall time: it may have subscribed late."""


class ImageGate:
    """Holds time until the render nodes have published the images of a tick that have subscribers.

    After a timeout of a render node, time does not wait for it until it answers again.

    Subscribes, while it is enabled:
        tick_done (gibson_msgs/TickDone): the render nodes, and the ticks that they have finished.
    """

    def __init__(self, node: Node, timeout_s: float, on_open: Callable[[], None], publish_again: Callable[[bool], None]) -> None:
        """Creates the gate, which is disabled.

        Args:
            node: the physics node.
            timeout_s: timeout of a tick, s of wall time.
            on_open: called when a tick is done.
            publish_again: called with False; publishes the state of the present tick again.
        """
        self._node, self._timeout_ns = node, round(timeout_s * NS_PER_S)
        self._on_open, self._publish_again = on_open, publish_again
        self._subscription: Any = None
        self._has_answered: dict[str, bool] = {}
        """Render node -> whether it has answered yet; only nodes that time waits for."""
        self._publishing: dict[str, frozenset[str]] = {}
        """Camera -> names of the nodes that publish its images; only cameras whose images have subscribers."""
        self._queried_ns = 0
        self._stamp_ns, self._opened_ns, self._republished_ns = 0, 0, 0
        self._waits_for: set[str] = set()

    def enable(self, on: bool) -> None:
        """Enables or disables the gate."""
        if on and self._subscription is None:
            self._subscription = self._node.create_subscription(TickDone, names.TICK_DONE, self._on_tick_done, qos.TICK_DONE)
        elif not on and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._has_answered.clear()
            self.reset()

    @property
    def is_open(self) -> bool:
        """Whether the present tick is done."""
        return not self._waits_for

    def reset(self) -> None:
        """Discards the present tick: the simulation was reset."""
        self._waits_for.clear()

    def begin_tick(self, stamp_ns: int, cameras: Sequence[CameraSpec], due: Collection[int]) -> None:
        """Closes the gate for a tick that was published, if an image of it has subscribers.

        Args:
            stamp_ns: stamp of the tick, simulation time, ns.
            cameras: all cameras of the scene.
            due: indices of the cameras that are due at this tick.
        """
        self._waits_for.clear()
        if not self._has_answered or not due:
            return
        now_ns = time.monotonic_ns()
        if now_ns - self._queried_ns > _GRAPH_PERIOD_NS:
            self._queried_ns = now_ns
            self._publishing = {camera.name: nodes for camera in cameras if (nodes := self._publishers(camera))}
        for i in due:
            self._waits_for |= self._publishing.get(cameras[i].name, frozenset()) & self._has_answered.keys()
        self._stamp_ns, self._opened_ns, self._republished_ns = stamp_ns, now_ns, now_ns

    def may_step(self) -> bool:
        """Returns whether the next step may be executed; stops waiting for render nodes that have timed out."""
        if not self._waits_for:
            return True
        now_ns = time.monotonic_ns()
        if now_ns - self._opened_ns < self._timeout_ns:
            answered = all(self._has_answered[name] for name in self._waits_for)
            if now_ns - self._republished_ns > _REPUBLISH_PERIOD_NS and not answered:
                self._republished_ns = now_ns
                self._publish_again(False)
            return False
        late = ", ".join(map(quoted, sorted(self._waits_for)))
        self._node.get_logger().warning(
            f"images at {self._stamp_ns / NS_PER_S:.3f} s did not arrive from {late} within 'image_timeout', "
            f"{self._timeout_ns / NS_PER_S:g} s; time goes on without them"
        )
        for name in self._waits_for:
            del self._has_answered[name]
        self._waits_for.clear()
        return True

    def _publishers(self, camera: CameraSpec) -> frozenset[str]:
        """Returns the names of the nodes that publish images of a camera on topics with subscribers."""
        node, topics = self._node, names.image_topics(camera.name, camera.outputs)
        publishers = [p for t in topics if node.count_subscribers(t) for p in node.get_publishers_info_by_topic(t)]
        return frozenset(names.participant(p.node_namespace, p.node_name) for p in publishers)

    def _on_tick_done(self, msg: TickDone) -> None:
        name, was_closed = msg.participant, bool(self._waits_for)
        if msg.event == TickDone.DONE:
            self._has_answered[name] = True
            if time_from_msg(msg.stamp) == self._stamp_ns:
                self._waits_for.discard(name)
        elif msg.event == TickDone.JOIN and msg.after == CAMERAS:
            self._has_answered[name] = False
        else:
            self._has_answered.pop(name, None)
            self._waits_for.discard(name)
        if was_closed and not self._waits_for:
            self._on_open()
