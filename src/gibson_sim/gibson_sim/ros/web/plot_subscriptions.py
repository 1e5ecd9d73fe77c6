"""Numbers of any topic for the plots of pages: a topic is subscribed to while a page plots it, and no longer."""

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
"""Matches whatever is offered, and holds no publisher up."""
_FIRST_MESSAGE_S = 2.0
"""Wall time to wait for a message whose arrays are to be listed; afterwards the fields of an empty one are told, s."""
_MOST_LISTINGS = 8
"""Topics that may be listed at a time."""
_LARGE = (
    "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2", "gibson_msgs/msg/Scene", "gibson_msgs/msg/SceneState",
    "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate", "gibson_msgs/msg/Input",
)  # fmt: skip
"""Types that are worth no plot, and cost much."""
Reply = Callable[..., None]


def plottable(graph: list[tuple[str, list[str]]]) -> dict[str, str]:
    """Returns topic -> type of what can be plotted. ``graph``: (topic, types), as rclpy returns them."""
    # One participant cannot know a topic under two types, and this node must stay free to publish commands of either.
    return {
        topic: types[0]
        for topic, types in sorted(graph)
        if len(types) == 1 and types[0] not in _LARGE and not topic.endswith(f"/{names.CMD_VEL}") and has_numbers(types[0])
    }


class PlotSubscriptions:
    """The subscriptions of all curves that any page plots.

    Args:
        node: subscribes.
    """

    def __init__(self, node: Subscriber) -> None:
        self._node = node
        self.curves = Curves()
        self.types: dict[str, str] = {}
        """Topic -> type, of what can be plotted."""
        self._subscriptions: dict[str, Any] = {}
        self._steps: dict[str, list[tuple[str, tuple[Step, ...]]]] = {}
        """Topic -> its fields, and their steps."""
        self._listings: list[_Listing] = []

    def update(self, plotted: frozenset[CurveName]) -> None:
        """Subscribes to the topics of these curves as soon as they exist, and to nothing else; a field that cannot be one is left out."""
        self.curves.update(plotted)
        self._steps = {}
        for topic, path in sorted(plotted):
            try:
                self._steps.setdefault(topic, []).append((path, parse_path(path)))
            except ValueError as error:
                self._node.get_logger().warning(str(error))
        self.look()

    def look(self) -> None:
        """Subscribes to plotted topics that have appeared, and unsubscribes from those that no page plots."""
        for topic in set(self._subscriptions) - set(self._steps):
            self._node.destroy_subscription(self._subscriptions.pop(topic))
        for topic in set(self._steps) - set(self._subscriptions):
            kind = _class(self.types.get(topic, ""))
            if kind is not None:
                self._subscriptions[topic] = self._node.subscribe(kind, topic, partial(self._on_message, topic), _QUEUE)

    def list_fields(self, topic: str, reply: Reply) -> None:
        """Tells the numbers in the messages of a topic, by its next message, since only that has its arrays."""
        kind = _class(self.types.get(topic, ""))
        if len(self._listings) >= _MOST_LISTINGS:
            reply(False, "too many topics are being listed: try again in a moment", None)
            return
        if kind is None:
            reply(False, f"{quoted(topic)} is no topic that can be plotted", None)
            return
        listing = _Listing(topic, kind, time.monotonic() + _FIRST_MESSAGE_S, reply)
        listing.subscription = self._node.subscribe(kind, topic, partial(self._on_listed, listing), _QUEUE)
        self._listings.append(listing)

    def end_listings(self) -> None:
        """Ends listings that are done, or whose topic is silent."""
        for listing in [one for one in self._listings if one.done or time.monotonic() > one.deadline_s]:
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
    """A page waits for the fields of a topic."""

    def __init__(self, topic: str, kind: Any, deadline_s: float, reply: Reply) -> None:
        self.topic, self.kind, self.deadline_s, self.reply = topic, kind, deadline_s, reply
        self.subscription: Any = None
        self.done = False


def _class(type_name: str) -> Any:
    try:
        return message_class(type_name)
    except UNKNOWN:
        return None
