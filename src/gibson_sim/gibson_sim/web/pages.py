"""One page that is connected to the server, and what stands behind all of them. Knows no ROS."""

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

MOST_AT_ONCE, MOST_PER_S = 60, 30.0
"""Requests that a page may send at once, and each second after that: they would delay the stop of a robot that another page drives."""


class Answer(Protocol):
    """Tells the page that asked for something what has become of it; may be called later and from any thread."""

    def __call__(self, ok: bool, text: str, value: Any = None) -> None:
        """Whether it worked, what to say (empty = nothing), and what was asked for, as far as JSON can hold it."""


class Backend(Protocol):
    """What stands behind the pages. Every method is called in the server's thread and must not block."""

    def watch(self, topics: frozenset[str]) -> None:
        """The videos that any page shows now: nothing else need be received."""

    def plot(self, curves: frozenset[CurveName]) -> None:
        """The curves that any page plots now."""

    def drive(self, command: Drive) -> None:
        """Sends a velocity command."""

    def ask(self, request: Request, answer: Answer) -> None:
        """Does anything else. For ``Plot`` the value of the answer is the time now and the samples of the last minute."""


@dataclass(eq=False)
class Page:
    """One connection."""

    socket: web.WebSocketResponse
    queue: asyncio.Queue[bytes | str]
    viewer: Viewer = field(init=False)
    curves: frozenset[CurveName] = frozenset()
    """What it plots."""
    _left: float = MOST_AT_ONCE
    """Requests that it may send now."""
    _asked_s: float = 0.0
    """When it sent the last one."""
    _refused: bool = False

    def __post_init__(self) -> None:
        self.viewer = Viewer(lambda image: self.put(image.message()))

    def may_ask(self, now_s: float) -> bool:
        """Returns whether the page may send a request now, and counts it; tells the page once that it sends too many.

        Args:
            now_s: a clock that never goes back.
        """
        self._left = min(self._left + MOST_PER_S * (now_s - self._asked_s), MOST_AT_ONCE)
        self._asked_s = now_s
        may = self._left >= 1.0
        if may:
            self._left -= 1.0
        elif not self._refused:
            self.reply("", False, f"too many requests: at most {MOST_PER_S:.0f} a second are answered")
        self._refused = not may
        return may

    def put(self, message: bytes | str) -> None:
        """Queues a message; drops it where the page has not taken the ones before."""
        with contextlib.suppress(asyncio.QueueFull):
            self.queue.put_nowait(message)

    def reply(self, kind: str, ok: bool, text: str, value: Any = None) -> None:
        """Answers a request."""
        more = {} if value is None else {"value": value}
        self.put(json.dumps({"type": "reply", "value": {"to": kind, "ok": ok, "text": text, **more}}))

    def send_samples(self, kind: str, now_s: float, samples: Mapping[CurveName, list[Sample]]) -> None:
        """Sends the samples of the curves that it plots; the time alone keeps its plots moving."""
        if self.curves:
            rows = [[*name, values] for name, values in samples.items() if name in self.curves]
            self.put(json.dumps({"type": kind, "value": {"now": now_s, "curves": rows}}, allow_nan=False))

    def send_history(self, value: tuple[float, Mapping[CurveName, list[Sample]]] | None) -> None:
        """Sends the last minute of the curves that it plots."""
        if value is not None:
            self.send_samples("history", *value)


async def send_queued(page: Page) -> None:
    """Sends what is queued for a page, one after the other."""
    with contextlib.suppress(ConnectionError):
        while not page.socket.closed:
            message = await page.queue.get()
            if isinstance(message, bytes):
                await page.socket.send_bytes(message)
            else:
                await page.socket.send_str(message)
