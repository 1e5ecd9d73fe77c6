"""Time waits for images that have subscribers, where it passes as fast as possible without lockstep."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rclpy.node import Node

from gibson_msgs.msg import TickDone
from gibson_sim.quoting import quoted
from gibson_sim.ros.topics import names, qos
from gibson_sim.standard.lockstep import CAMERAS
from gibson_sim.types import NS_PER_S, CameraSpec

_LOOK_NS = NS_PER_S // 10
"""Wall time between two looks at who subscribes to images and who publishes them."""
_AGAIN_NS = NS_PER_S // 2
"""How often a render node that has not answered yet is given the present tick: its subscription may have come after that."""


class ImageGate:
    """Holds time until the render nodes have published those images of a tick that have subscribers.

    A render node that does not answer within the timeout is not waited for until it answers again.

    Subscribes, while it is switched on:
        tick_done (gibson_msgs/TickDone): which render nodes there are, and which ticks they have done.
    """

    def __init__(self, node: Node, timeout_s: float, go_on: Callable[[], None], publish_again: Callable[[bool], None]) -> None:
        """Holds nothing before it is switched on.

        Args:
            node: the physics node.
            timeout_s: timeout of a tick, seconds of wall time.
            go_on: is called when a tick is done.
            publish_again: publishes the state of the present tick once more, given False.
        """
        self._node, self._timeout_ns = node, round(timeout_s * NS_PER_S)
        self._go_on, self._publish_again = go_on, publish_again
        self._subscription: Any = None
        self._known: dict[str, bool] = {}
        """Whether a render node has answered yet, by its name; those that are not waited for are missing."""
        self._publishing: dict[str, frozenset[str]] = {}
        """Names of the nodes that publish images of a camera, by its name; only of cameras whose images have subscribers."""
        self._looked_ns = 0
        self._stamp_ns, self._opened_ns, self._again_ns = 0, 0, 0
        self._waits_for: set[str] = set()

    def switch(self, on: bool) -> None:
        """Begins to hold time, or ends it."""
        if on and self._subscription is None:
            self._subscription = self._node.create_subscription(TickDone, names.TICK_DONE, self._on_done, qos.TICK_DONE)
        elif not on and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            self._known.clear()
            self.restart()

    @property
    def is_open(self) -> bool:
        """Whether the present tick is done."""
        return not self._waits_for

    def restart(self) -> None:
        """Forgets the present tick: the simulation was reset."""
        self._waits_for.clear()

    def publish_tick(self, stamp_ns: int, cameras: Sequence[CameraSpec], due: Collection[int]) -> None:
        """Takes note that a tick was published.

        Args:
            stamp_ns: of the tick, simulation time.
            cameras: all cameras of the scene.
            due: indices of those that are due at this tick.
        """
        self._waits_for.clear()
        if not self._known or not due:
            return
        now_ns = time.monotonic_ns()
        if now_ns - self._looked_ns > _LOOK_NS:
            self._looked_ns = now_ns
            self._publishing = {camera.name: found for camera in cameras if (found := self._publishers(camera))}
        for i in due:
            self._waits_for |= self._publishing.get(cameras[i].name, frozenset()) & self._known.keys()
        self._stamp_ns, self._opened_ns, self._again_ns = stamp_ns, now_ns, now_ns

    def may_go(self) -> bool:
        """Returns whether the next step may be made; gives up those who are too late."""
        if not self._waits_for:
            return True
        now_ns = time.monotonic_ns()
        if now_ns - self._opened_ns < self._timeout_ns:
            if now_ns - self._again_ns > _AGAIN_NS and not all(self._known[name] for name in self._waits_for):
                self._again_ns = now_ns
                self._publish_again(False)
            return False
        late = ", ".join(map(quoted, sorted(self._waits_for)))
        self._node.get_logger().warning(
            f"images at {self._stamp_ns / NS_PER_S:.3f} s did not come from {late} within 'image_timeout', "
            f"{self._timeout_ns / NS_PER_S:g} s; time goes on without them"
        )
        for name in self._waits_for:
            del self._known[name]
        self._waits_for.clear()
        return True

    def _publishers(self, camera: CameraSpec) -> frozenset[str]:
        """Returns the names of the nodes that publish those images of a camera that have subscribers."""
        node, topics = self._node, names.image_topics(camera.name, camera.outputs)
        found = [p for t in topics if node.count_subscribers(t) for p in node.get_publishers_info_by_topic(t)]
        return frozenset(f"{p.node_namespace.strip('/')}/{p.node_name}".lstrip("/") for p in found)

    def _on_done(self, msg: TickDone) -> None:
        name, waits = msg.participant, bool(self._waits_for)
        if msg.event == TickDone.DONE:
            self._known[name] = True
            if msg.stamp.sec * NS_PER_S + msg.stamp.nanosec == self._stamp_ns:
                self._waits_for.discard(name)
        elif msg.event == TickDone.JOIN and msg.after == CAMERAS:
            self._known[name] = False
        else:
            self._known.pop(name, None)
            self._waits_for.discard(name)
        if waits and not self._waits_for:
            self._go_on()
