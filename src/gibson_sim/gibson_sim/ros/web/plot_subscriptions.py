"""Subscriptions for the plots of pages: numeric fields of any topic, subscribed to only while a page plots them."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from gibson_sim.quoting import quoted
from gibson_sim.ros.topics import names
from gibson_sim.ros.web.message_fields import Step, has_numbers, number_at, number_fields, parse_path
from gibson_sim.ros.web.video_subscriptions import Subscriber
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.web.curves import CurveName, Curves

_QUEUE = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Profile that matches every publisher, and never blocks one."""
_FIRST_MESSAGE_S = 2.0
"""Timeout for a message whose fields are listed, s of wall time; afterwards the fields of an empty message are listed."""
_MAX_LISTINGS = 8
"""Maximum number of topics whose fields are being listed."""
_LARGE = (
    "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2", "gibson_msgs/msg/Scene", "gibson_msgs/msg/SceneState",
    "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate", "gibson_msgs/msg/Input",
)  # fmt: skip
"""Types of large messages, which are not offered for plots."""
Reply = Callable[..., None]


def plottable(graph: list[tuple[str, list[str]]]) -> dict[str, str]:
    """Returns topic -> type of the topics that can be plotted; ``graph`` has (topic, types), as rclpy returns them."""
    # Without cmd_vel: a participant cannot have a topic with two types, and this node must be able to publish commands of either.
    return {
        topic: types[0]
        for topic, types in sorted(graph)
        if len(types) == 1 and types[0] not in _LARGE and not topic.endswith(f"/{names.CMD_VEL}") and has_numbers(types[0])
    }


class PlotSubscriptions:
    """The subscriptions of all curves that pages plot.

    Args:
        node: node of the subscriptions.
    """

    def __init__(self, node: Subscriber) -> None:
        self._node = node
        self.curves = Curves()
        self.types: dict[str, str] = {}
        """Topic -> type of the topics that can be plotted."""
        self._subscriptions: dict[str, Any] = {}
        self._steps: dict[str, list[tuple[str, tuple[Step, ...]]]] = {}
        """Topic -> paths of its plotted fields, with their steps."""
        self._listings: list[_Listing] = []

    def update(self, plotted: frozenset[CurveName]) -> None:
        """Sets the plotted curves, and subscribes to their topics only, as soon as they exist; curves with an invalid path are skipped."""
        self.curves.update(plotted)
        self._steps = {}
        for topic, path in sorted(plotted):
            try:
                self._steps.setdefault(topic, []).append((path, parse_path(path)))
            except ValueError as error:
                self._node.get_logger().warning(str(error))
        self.update_subscriptions()

    def update_subscriptions(self) -> None:
        """Subscribes to plotted topics that have appeared, and unsubscribes from those that no page plots."""
        for topic in set(self._subscriptions) - set(self._steps):
            self._node.destroy_subscription(self._subscriptions.pop(topic))
        for topic in set(self._steps) - set(self._subscriptions):
            kind = _class(self.types.get(topic, ""))
            if kind is not None:
                self._subscriptions[topic] = self._node.subscribe(kind, topic, partial(self._on_message, topic), _QUEUE)

    def list_fields(self, topic: str, reply: Reply) -> None:
        """Replies with the numeric fields of a topic, from its next message, which shows the lengths of its arrays."""
        kind = _class(self.types.get(topic, ""))
        if len(self._listings) >= _MAX_LISTINGS:
            reply(False, "too many topics are being listed: try again in a moment", None)
            return
        if kind is None:
            reply(False, f"topic {quoted(topic)} cannot be plotted", None)
            return
        listing = _Listing(topic, kind, time.monotonic() + _FIRST_MESSAGE_S, reply)
        listing.subscription = self._node.subscribe(kind, topic, partial(self._on_listed, listing), _QUEUE)
        self._listings.append(listing)

    def end_listings(self) -> None:
        """Ends listings that are done, or have timed out."""
        for listing in [item for item in self._listings if item.done or time.monotonic() > item.deadline_s]:
            if not listing.done:
                self._on_listed(listing, listing.kind())
            self._node.destroy_subscription(listing.subscription)
            self._listings.remove(listing)

    def _on_listed(self, listing: _Listing, message: Any) -> None:
        if not listing.done:
            listing.done = True
            fields = [list(field) for field in number_fields(message)]
            listing.reply(True, "", {"topic": listing.topic, "fields": fields})

    def _on_message(self, topic: str, message: Any) -> None:
        now = time.monotonic()
        for path, steps in self._steps.get(topic, ()):
            value = number_at(message, steps)
            if value is not None:
                self.curves.add((topic, path), now, value)


class _Listing:
    """A pending request of a page for the fields of a topic."""

    def __init__(self, topic: str, kind: Any, deadline_s: float, reply: Reply) -> None:
        self.topic, self.kind, self.deadline_s, self.reply = topic, kind, deadline_s, reply
        self.subscription: Any = None
        self.done = False


def _class(type_name: str) -> Any:
    try:
        return message_class(type_name)
    except UNKNOWN:
        return None
