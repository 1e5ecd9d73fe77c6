"""Which page gets which image when: the newest one, as soon as it has shown the one before. A slow page slows no other. Pure."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

IN_FLIGHT = 2
"""Images of one video that may be on their way to a page: with one alone it would wait for the link each time."""
SCENE = "@scene"
"""What a page watches to get the poses of the 3-D scene: no topic has this name."""
_HEAD = struct.Struct("<BBHd")
"""Kind (1 = image), 0, length of the topic in bytes, stamp in seconds; the topic and a JPEG file follow."""


class Streamed(Protocol):
    """What is worth sending only while it is the newest of its topic."""

    @property
    def topic(self) -> str:
        """What a page watches to get it."""

    @property
    def stamp_s(self) -> float:
        """Stamp of its message, s."""

    def message(self) -> bytes:
        """Returns it as it goes over a WebSocket."""


@dataclass(frozen=True, slots=True)
class Poses:
    """The poses of all links of the scene, as ``scene_model.poses_message`` packs them."""

    data: bytes
    stamp_s: float
    topic: str = SCENE

    def message(self) -> bytes:
        """Returns it as it goes over a WebSocket."""
        return self.data


@dataclass(frozen=True, slots=True)
class Image:
    """A JPEG file of a video, and the stamp of its message in seconds."""

    topic: str
    stamp_s: float
    jpeg: bytes

    def message(self) -> bytes:
        """Returns it as it goes over a WebSocket."""
        topic = self.topic.encode()
        return _HEAD.pack(1, 0, len(topic), self.stamp_s) + topic + self.jpeg


@dataclass(slots=True)
class _Window:
    """One video of one page."""

    in_flight: int = 0
    newest: Streamed | None = None


@dataclass(eq=False)
class Viewer:
    """A page, as far as videos go.

    Args:
        send: hands an image to the page's connection; never blocks.
    """

    send: Callable[[Streamed], None]
    _windows: dict[str, _Window] = field(default_factory=dict)

    @property
    def topics(self) -> frozenset[str]:
        """What it watches."""
        return frozenset(self._windows)

    def watch(self, topics: tuple[str, ...]) -> frozenset[str]:
        """Shows these videos from now on; what is in flight of those that it showed already still counts. Returns the new ones."""
        before = self.topics
        self._windows = {topic: self._windows.get(topic) or _Window() for topic in topics}
        return self.topics - before

    def offer(self, image: Streamed) -> None:
        """Sends an image if it watches that video and is ready; else keeps it until it is, or until a newer one comes."""
        window = self._windows.get(image.topic)
        if window is None:
            return
        if window.in_flight < IN_FLIGHT:
            window.in_flight += 1
            self.send(image)
        else:
            window.newest = image

    def shown(self, topic: str) -> None:
        """Notes that the page has shown an image, and sends it the newest if one waits."""
        window = self._windows.get(topic)
        if window is None or not window.in_flight:
            return
        window.in_flight -= 1
        if window.newest is not None:
            image, window.newest = window.newest, None
            self.offer(image)
