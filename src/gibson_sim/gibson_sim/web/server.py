"""The HTTP and WebSocket server of the live page, in its own thread. Must not import ROS: a ``Backend`` handles the pages' requests.

By default it listens only on loopback; on another address every page needs a token. Request paths are never opened as files: the served files
are read once at the start. Requests from other origins or with a Host other than this server are rejected: no other web site in the same
browser can reach the robot.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import logging
import socket
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web

from gibson_sim.errors import ConfigError
from gibson_sim.web.connections import ConnectionGate, ConnectionLimits, RareWarnings, RequestErrors, listen
from gibson_sim.web.curves import CurveName, Sample
from gibson_sim.web.dead_man import DeadMan
from gibson_sim.web.pages import Backend, Page, send_queued
from gibson_sim.web.recordings import RecordingError, Recordings
from gibson_sim.web.requests import MAX_BYTES, Drive, Plot, Shown, Watch, parse_request
from gibson_sim.web.videos import Streamed

logger = logging.getLogger(__name__)

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MAX_PAGES = 20
"""Largest number of connected pages."""
MAX_ROBOTS = 100
"""Largest number of robots that pages drive at the same time."""
_TICK_S = 0.05
"""Period of velocity commands, seconds of wall time."""
_SILENT_S = 10.0
"""Timeout for the answer to a ping, after which a page counts as disconnected, seconds of wall time."""
_EXPECTED_S = 5.0
"""Time that a page may take from its request to its connection, seconds of wall time."""
_PRESENT_S, _MAX_KEPT = 0.3, 64
"""Age up to which an image counts as current, on the clock of the stamps, s; and largest number of kept images."""
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_POLICY = "default-src 'self'; img-src 'self' blob: data:; connect-src 'self' ws: wss:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
_REPORT_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox; frame-ancestors 'self'"
"""Policy of reports and plots, which a page shows in a frame: no scripts, no requests, an origin of their own."""


class PageServer:
    """Serves the page.

    Args:
        backend: handler of the pages' requests.
        host: address to listen on.
        port: TCP port; 0 = any free port.
        token: token that a page must present; "" = none, allowed only on loopback.
        recordings: what pages list, plot and open; None = nothing.
        limits: limits of the connections that are not pages; None = the usual ones.

    Raises:
        ConfigError: the address cannot be used, or is not loopback and has no token.
    """

    def __init__(
        self,
        backend: Backend,
        host: str = "127.0.0.1",
        port: int = 0,
        token: str = "",
        *,
        recordings: Recordings | None = None,
        limits: ConnectionLimits | None = None,
    ) -> None:
        if host not in LOOPBACK and not token:
            raise ConfigError(f"address {host} is reachable from other machines: a token is required")
        self._backend, self._host, self._token = backend, host, token
        self._recordings = recordings
        self._warnings = RareWarnings(logger)
        self._gate = ConnectionGate(limits or ConnectionLimits(), self._warnings)
        self._pages: set[Page] = set()
        self._watched: frozenset[str] = frozenset()
        self._expected: tuple[frozenset[str], float] = (frozenset(), 0.0)
        """Topics that a page that is being loaded will watch, and the time until which they are received for it, s of a monotonic clock."""
        self._plotted: frozenset[CurveName] = frozenset()
        self._newest: dict[str, Streamed] = {}
        """Topic -> latest image, for pages that are opened while time is paused."""
        self._switches: dict[str, DeadMan] = {}
        """Namespace of a robot -> its dead man's switch."""
        self._latched: dict[str, str] = {}
        self._files = {entry.name: entry.read_bytes() for entry in files("gibson_sim.web").joinpath("page").iterdir()}
        self._blobs: dict[str, bytes] = {}
        self._readers = ThreadPoolExecutor(4, "page-recordings")
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, args=(port,), name="page-server", daemon=True)
        self._ready, self._released = threading.Event(), threading.Event()
        self._error: OSError | None = None
        self.port = port
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise ConfigError(f"port {port} of {host} cannot be used: {self._error.strerror}; choose another one")

    @property
    def url(self) -> str:
        """URL for a browser."""
        host = socket.gethostname() if self._host in ("0.0.0.0", "::") else f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/" + (f"?token={self._token}" if self._token else "")

    def broadcast(self, kind: str, values: Any, *, keep: bool = False) -> None:
        """Sends values to all pages as JSON; may be called from any thread.

        Args:
            kind: type of the message.
            values: JSON values.
            keep: whether to latch the values: pages that connect later also receive the latest ones.
        """
        text = json.dumps({"type": kind, "value": values}, allow_nan=False)
        self._call(self._broadcast, kind, text, keep)

    def send_image(self, image: Streamed) -> None:
        """Sends an image or poses to the pages that watch the topic; may be called from any thread."""
        self._call(self._send_image, image)

    def drop_stale_images(self, now_s: float) -> None:
        """Drops kept images that are not current, so that a page does not mistake them for the present.

        Args:
            now_s: current time on the clock of the stamps, s.
        """
        self._call(self._drop_stale_images, now_s)

    def send_samples(self, now_s: float, samples: dict[CurveName, list[Sample]]) -> None:
        """Sends samples to the pages that plot the curves; may be called from any thread.

        Args:
            now_s: current time on the clock of the samples, s.
            samples: samples since the last call.
        """
        self._call(self._send_samples, now_s, samples)

    def serve_blob(self, name: str, data: bytes) -> None:
        """Serves bytes under ``/data/<name>``, such as the map and the mesh of the scene."""
        self._call(self._blobs.__setitem__, name, data)

    def close(self) -> None:
        """Ends the server. If a page drives a robot, the backend stops it before connections are closed, which may take seconds."""
        if self._recordings is not None:
            self._recordings.close()
        if self._loop.is_running():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._released.wait(timeout=5.0)

    def join(self) -> None:
        """Waits until the connections are closed, after ``close``."""
        self._thread.join(timeout=5.0)
        self._readers.shutdown(wait=False, cancel_futures=True)

    @property
    def _cookie(self) -> str:
        """Name of the cookie with the token; it includes the port, since browsers share cookies between the ports of a host."""
        return f"gibson_sim_token_{self.port}"

    # All methods below run in the server's thread.

    def _call(self, function: Callable[..., Any], *arguments: Any) -> None:
        if not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # the loop was closed meanwhile
                self._loop.call_soon_threadsafe(function, *arguments)

    def _run(self, port: int) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            listeners = listen(self._host, port)
        except OSError as error:
            self._loop.close()
            self._error = error
            self._ready.set()
            return
        self.port = listeners[0].getsockname()[1]
        protocol_logger = RequestErrors(logger, self._warnings)
        runner = web.AppRunner(self._application(), access_log=None, shutdown_timeout=1.0, logger=protocol_logger)
        self._loop.run_until_complete(runner.setup())
        assert runner.server is not None
        tasks = [self._loop.create_task(self._gate.accept(listener, runner.server)) for listener in listeners]
        self._ready.set()
        tasks.append(self._loop.create_task(self._tick()))
        try:
            self._loop.run_forever()
        finally:
            for task in tasks:
                task.cancel()
            for listener in listeners:
                self._loop.remove_reader(listener)
                listener.close()
            self._release(*self._pages)
            while self._drive():
                pass
            self._released.set()
            self._loop.run_until_complete(runner.cleanup())
            self._loop.close()

    def _application(self) -> web.Application:
        application = web.Application(middlewares=[self._guard], client_max_size=MAX_BYTES)
        application.add_routes(
            [
                web.get("/", self._file),
                web.get("/page/{name}", self._file),
                web.get("/data/{name}", self._blob),
                web.get("/socket", self._socket),
                web.get("/recordings", self._list_recordings),
                web.get("/recordings/{key}/{what:report|plots}", self._recording),
            ]
        )
        return application

    @web.middleware
    async def _guard(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        """Notes that the connection has sent a request, and answers it."""
        self._gate.begin(request.transport)
        try:
            return await self._answer(request, handler)
        finally:
            self._gate.end(request.transport)

    async def _answer(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        """Rejects other hosts, other origins and requests without the token, if one is set."""
        try:
            host = urlsplit(f"//{request.host}").hostname or ""
            origin = request.headers.get("Origin")
            is_foreign = origin is not None and urlsplit(origin).netloc != request.host
        except ValueError as error:
            raise web.HTTPForbidden(text="Host or Origin is not an address") from error
        if self._host in LOOPBACK and host not in LOOPBACK:
            raise web.HTTPForbidden(text="this server accepts only localhost as Host")
        if is_foreign:
            raise web.HTTPForbidden(text="requests from other origins are rejected")
        token = request.query.get("token") or request.cookies.get(self._cookie, "")
        if self._token and not hmac.compare_digest(token.encode(errors="replace"), self._token.encode()):
            raise web.HTTPForbidden(text="the token is missing or wrong: open the address that `gibson-sim` printed")
        response: web.StreamResponse = await handler(request)
        if not response.prepared:
            response.headers.setdefault("Content-Security-Policy", _POLICY)
            response.headers["X-Content-Type-Options"] = "nosniff"
            response.headers["Cache-Control"] = "no-store"
            if self._token and "token" in request.query:
                assert isinstance(response, web.Response)
                response.set_cookie(self._cookie, self._token, httponly=True, samesite="Strict")
        return response

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info.get("name", "index.html")
        if name == "index.html":
            self._expect_page()
        if name not in self._files:
            raise web.HTTPNotFound()
        return web.Response(
            body=self._files[name], content_type=_TYPES.get(name.rpartition(".")[2], "text/plain"), charset="utf-8"
        )

    def _expect_page(self) -> None:
        """Receives the first image topic for a page that is being loaded, so that its first image is there when it connects."""
        topics = json.loads(self._latched.get("topics", "{}")).get("value", [])
        self._expected = (frozenset(entry["topic"] for entry in topics[:1]), time.monotonic() + _EXPECTED_S)
        self._update_watched()

    async def _blob(self, request: web.Request) -> web.Response:
        data = self._blobs.get(request.match_info["name"])
        if data is None:
            raise web.HTTPNotFound()
        return web.Response(body=data, content_type="application/octet-stream")

    async def _list_recordings(self, request: web.Request) -> web.Response:
        if self._recordings is None:
            raise web.HTTPNotFound()
        return web.json_response(await self._loop.run_in_executor(self._readers, self._recordings.list))

    async def _recording(self, request: web.Request) -> web.Response:
        """Serves the report of a trial, or the plots of a bag, to be shown in a frame."""
        if self._recordings is None:
            raise web.HTTPNotFound()
        read = self._recordings.report if request.match_info["what"] == "report" else self._recordings.plots
        try:
            body = await self._loop.run_in_executor(self._readers, read, request.match_info["key"])
        except RecordingError as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        return web.Response(
            body=body, content_type="text/html", charset="utf-8", headers={"Content-Security-Policy": _REPORT_POLICY}
        )

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._pages) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{MAX_PAGES} pages are already connected")
        socket = web.WebSocketResponse(heartbeat=_SILENT_S / 2, max_msg_size=MAX_BYTES, compress=False)
        try:
            await socket.prepare(request)
        except ConnectionError as error:
            # The browser closed the page while loading it; any other exception would be logged with its traceback.
            raise web.HTTPServiceUnavailable(text="the page was closed") from error
        except ValueError as error:  # bytes that are not ASCII in a header of the handshake
            raise web.HTTPBadRequest(text="a header of the WebSocket handshake is malformed") from error
        self._gate.keep(request.transport)
        page = Page(socket, asyncio.Queue(maxsize=64))
        self._pages.add(page)
        for text in self._latched.values():
            page.put(text)
        sending = self._loop.create_task(send_queued(page))
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    self._received(page, message.data)
        finally:
            sending.cancel()
            self._pages.discard(page)
            self._release(page)
            self._update_watched()
            self._update_plotted()
        return socket

    def _received(self, page: Page, text: str) -> None:
        try:
            request = parse_request(text)
        except ConfigError as error:
            page.reply("", False, str(error))
            return
        if not isinstance(request, Shown | Drive) and not page.allow_request(time.monotonic()):
            return
        if isinstance(request, Watch):
            new = page.viewer.watch(request.topics)
            self._update_watched()
            for topic in new & self._newest.keys():
                page.viewer.offer(self._newest[topic])
        elif isinstance(request, Shown):
            page.viewer.shown(request.topic)
        elif isinstance(request, Plot):
            page.curves = frozenset(request.curves)
            self._update_plotted()
            self._backend.handle_request(request, lambda ok, text, value=None: self._call(page.send_history, value))
        elif isinstance(request, Drive):
            if not self._accept_drive(page, request):
                page.reply("drive", False, "another page is driving")
        else:
            kind = type(request).__name__
            self._backend.handle_request(request, lambda ok, text, value=None: self._call(page.reply, kind, ok, text, value))

    def _accept_drive(self, page: Page, request: Drive) -> bool:
        """Accepts a drive command; returns False if another page drives this robot."""
        switch = self._switches.get(request.robot)
        if switch is None and len(self._switches) < MAX_ROBOTS:
            switch = self._switches[request.robot] = DeadMan()
        return switch is not None and switch.drive(page, replace(request, robot=""), time.monotonic())

    def _release(self, *pages: Page) -> None:
        for switch in self._switches.values():
            for page in pages:
                switch.release(page)

    def _drive(self) -> bool:
        """Publishes the due commands; returns whether there were any."""
        now, sent = time.monotonic(), False
        for robot, switch in list(self._switches.items()):
            if (command := switch.due(now)) is not None:
                self._backend.drive(replace(command, robot=robot))
                sent = True
            if switch.idle:
                del self._switches[robot]
        return sent

    def _update_watched(self) -> None:
        watched = self._expected[0].union(*(page.viewer.topics for page in self._pages))
        if watched != self._watched:
            self._watched = watched
            self._backend.watch(watched)

    def _update_plotted(self) -> None:
        plotted = frozenset().union(*(page.curves for page in self._pages))
        if plotted != self._plotted:
            self._plotted = plotted
            self._backend.plot(plotted)

    def _send_samples(self, now_s: float, samples: dict[CurveName, list[Sample]]) -> None:
        for page in self._pages:
            page.send_samples("samples", now_s, samples)

    def _broadcast(self, kind: str, text: str, keep: bool) -> None:
        if keep:
            self._latched[kind] = text
        for page in self._pages:
            page.put(text)

    def _drop_stale_images(self, now_s: float) -> None:
        self._newest = {topic: image for topic, image in self._newest.items() if abs(image.stamp_s - now_s) < _PRESENT_S}

    def _send_image(self, image: Streamed) -> None:
        if image.topic in self._newest or len(self._newest) < _MAX_KEPT:
            self._newest[image.topic] = image
        for page in self._pages:
            page.viewer.offer(image)

    async def _tick(self) -> None:
        while True:
            self._drive()
            if self._expected[0] and time.monotonic() > self._expected[1]:
                self._expected = (frozenset(), 0.0)
                self._update_watched()
            self._gate.close_idle()
            await asyncio.sleep(_TICK_S)
