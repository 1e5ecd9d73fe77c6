"""A page connected to the server, and the backend of all pages. Must not import ROS."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from aiohttp import web

from gibson_sim.web.curves import CurveName, Sample
from gibson_sim.web.requests import Drive, Request
from gibson_sim.web.videos import Viewer

MAX_AT_ONCE, MAX_PER_S = 60, 30.0
"""Rate limit of a page's requests: burst size, and requests per second. More could delay the stop of a robot that another page drives."""


class Answer(Protocol):
    """Callback with the result of a request; may be called later and from any thread."""

    def __call__(self, ok: bool, text: str, value: Any = None) -> None:
        """Sends success, text (empty = none) and the requested value, which must be representable in JSON."""


class Backend(Protocol):
    """Handler of the pages' requests. Every method is called in the server's thread and must not block."""

    def watch(self, topics: frozenset[str]) -> None:
        """Sets the topics of the videos that any page shows; no others need to be received."""

    def plot(self, curves: frozenset[CurveName]) -> None:
        """Sets the curves that any page plots."""

    def drive(self, command: Drive) -> None:
        """Publishes a velocity command."""

    def handle_request(self, request: Request, answer: Answer) -> None:
        """Handles any other request. For ``Plot`` the value of the answer is the current time and the samples of the last minute."""


@dataclass(eq=False)
class Page:
    """A connected page."""

    socket: web.WebSocketResponse
    queue: asyncio.Queue[bytes | str]
    viewer: Viewer = field(init=False)
    curves: frozenset[CurveName] = frozenset()
    """Plotted curves."""
    _remaining: float = MAX_AT_ONCE
    """Number of requests that the page may send now."""
    _last_request_s: float = 0.0
    """Time of the last request, s."""
    _refused: bool = False

    def __post_init__(self) -> None:
        self.viewer = Viewer(lambda image: self.put(image.message()))

    def allow_request(self, now_s: float) -> bool:
        """Counts a request and returns whether the rate limit allows it; notifies the page once when the limit is exceeded.

        Args:
            now_s: time of a monotonic clock, s.
        """
        self._remaining = min(self._remaining + MAX_PER_S * (now_s - self._last_request_s), MAX_AT_ONCE)
        self._last_request_s = now_s
        is_allowed = self._remaining >= 1.0
        if is_allowed:
            self._remaining -= 1.0
        elif not self._refused:
            self.reply("", False, f"too many requests: at most {MAX_PER_S:.0f} per second are answered")
        self._refused = not is_allowed
        return is_allowed

    def put(self, message: bytes | str) -> None:
        """Queues a message; drops it if the queue is full."""
        with contextlib.suppress(asyncio.QueueFull):
            self.queue.put_nowait(message)

    def reply(self, kind: str, ok: bool, text: str, value: Any = None) -> None:
        """Answers a request."""
        optional = {} if value is None else {"value": value}
        self.put(json.dumps({"type": "reply", "value": {"to": kind, "ok": ok, "text": text, **optional}}))

    def send_samples(self, kind: str, now_s: float, samples: Mapping[CurveName, list[Sample]]) -> None:
        """Sends the samples of the plotted curves; sent even without samples, since the time scrolls the plots."""
        if self.curves:
            rows = [[*name, values] for name, values in samples.items() if name in self.curves]
            self.put(json.dumps({"type": kind, "value": {"now": now_s, "curves": rows}}, allow_nan=False))

    def send_history(self, value: tuple[float, Mapping[CurveName, list[Sample]]] | None) -> None:
        """Sends the history of the plotted curves."""
        if value is not None:
            self.send_samples("history", *value)


async def send_queued(page: Page) -> None:
    """Sends the queued messages of a page until its connection closes."""
    with contextlib.suppress(ConnectionError):
        while not page.socket.closed:
            message = await page.queue.get()
            if isinstance(message, bytes):
                await page.socket.send_bytes(message)
            else:
                await page.socket.send_str(message)
