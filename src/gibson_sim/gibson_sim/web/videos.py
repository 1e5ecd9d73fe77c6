"""Flow control of videos: a page receives the latest image when it has shown an earlier one. A slow page does not slow others."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

IN_FLIGHT = 2
"""Largest number of unacknowledged images of a video; with only one, each image would wait for a round trip."""
SCENE = "@scene"
"""Pseudo-topic for the poses of the 3-D scene; not a valid topic name."""
_HEAD = struct.Struct("<BBHd")
"""Header of an image message: kind (1 = image), 0, length of the topic in bytes, stamp in seconds; topic and JPEG file follow."""


class Streamed(Protocol):
    """Data of which only the latest of each topic is sent."""

    @property
    def topic(self) -> str:
        """Topic that pages watch."""

    @property
    def stamp_s(self) -> float:
        """Stamp of the message, s."""

    def message(self) -> bytes:
        """Returns the WebSocket message."""


@dataclass(frozen=True, slots=True)
class Poses:
    """The poses of all links of the scene, packed by ``scene_model.poses_message``."""

    data: bytes
    stamp_s: float
    topic: str = SCENE

    def message(self) -> bytes:
        """Returns the WebSocket message."""
        return self.data


@dataclass(frozen=True, slots=True)
class Image:
    """A JPEG image of a video, with the stamp of its message in seconds."""

    topic: str
    stamp_s: float
    jpeg: bytes

    def message(self) -> bytes:
        """Returns the WebSocket message."""
        topic = self.topic.encode()
        return _HEAD.pack(1, 0, len(topic), self.stamp_s) + topic + self.jpeg


@dataclass(slots=True)
class _Window:
    """State of one video of a page."""

    in_flight: int = 0
    newest: Streamed | None = None


@dataclass(eq=False)
class Viewer:
    """The videos of a page.

    Args:
        send: sends an image to the page; must not block.
    """

    send: Callable[[Streamed], None]
    _windows: dict[str, _Window] = field(default_factory=dict)

    @property
    def topics(self) -> frozenset[str]:
        """Watched topics."""
        return frozenset(self._windows)

    def watch(self, topics: tuple[str, ...]) -> frozenset[str]:
        """Replaces the watched videos; unacknowledged images of retained videos still count. Returns the new topics."""
        previous = self.topics
        self._windows = {topic: self._windows.get(topic) or _Window() for topic in topics}
        return self.topics - previous

    def offer(self, image: Streamed) -> None:
        """Sends an image of a watched video if the page is ready; otherwise keeps it until the page is ready or a newer image arrives."""
        window = self._windows.get(image.topic)
        if window is None:
            return
        if window.in_flight < IN_FLIGHT:
            window.in_flight += 1
            self.send(image)
        else:
            window.newest = image

    def shown(self, topic: str) -> None:
        """Records that the page has shown an image; sends the latest waiting image, if any."""
        window = self._windows.get(topic)
        if window is None or not window.in_flight:
            return
        window.in_flight -= 1
        if window.newest is not None:
            image, window.newest = window.newest, None
            self.offer(image)
