"""Logs why a node receives no images, or cannot use them: a wrong topic, a wrong message type, stamps that stand still."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.clock import Clock, ClockType

_PERIOD_S = 5.0
"""Time between two warnings, seconds of wall time: with ``use_sim_time`` there may be no other time."""
_EQUAL_STAMPS = 10
"""Successive images with one stamp from which on a warning is due."""


class ImageWatch:
    """Warns every 5 s of topics without images, or of another type, and of images whose stamps do not change.

    Args:
        node: the node that subscribes.
        topics: topic -> message type of its images.
        setting: what names the topics: a parameter, or a remapping.
    """

    def __init__(self, node: Any, topics: Mapping[str, Any], setting: str) -> None:
        self._node, self._setting = node, setting
        self._silent = {topic: f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}" for topic, kind in topics.items()}
        """Topics from which no image has come -> their type."""
        self._newest: dict[str, tuple[int, int]] = {}
        """Newest stamp of a topic, ns, and number of successive images that had it."""
        self._timer = node.create_timer(_PERIOD_S, self.warn, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def is_waiting(self) -> bool:
        """Whether no image has come from one of the topics."""
        return bool(self._silent)

    def note(self, topic: str, stamp_ns: int) -> None:
        """Notes an image.

        Args:
            topic: one of the topics.
            stamp_ns: its stamp, ns.
        """
        self._silent.pop(topic, None)
        newest_ns, count = self._newest.get(topic, (0, 0))
        count = count + 1 if stamp_ns == newest_ns else 1
        self._newest[topic] = (stamp_ns, count)
        if count >= _EQUAL_STAMPS:
            self._node.get_logger().warning(
                f"the last {count} images from {topic} all have the stamp {stamp_ns / 1e9:.3f} s; correct the camera's driver",
                throttle_duration_sec=_PERIOD_S,
            )

    def warn(self) -> None:
        """Warns of the topics without images."""
        for topic, expected in self._silent.items():
            name = self._node.resolve_topic_name(topic)
            types = {publisher.topic_type for publisher in self._node.get_publishers_info_by_topic(name)}
            if types and expected not in types:
                self._node.get_logger().warning(
                    f"{name} is published as {', '.join(sorted(types))}, this node subscribes to {expected} there; choose another topic with "
                    f"{self._setting}: names that end in /compressed are sensor_msgs/msg/CompressedImage"
                )
                continue
            self._node.get_logger().warning(f"no image has come from {name}; does the camera run, and is {self._setting} right?")

    def close(self) -> None:
        """Ends the warnings; a second call does nothing."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
