"""The HTTP and WebSocket server of the live page, in a thread of its own. Knows no ROS: a ``Backend`` is told what pages ask for.

It answers on loopback alone, unless it is given another address; then every page needs a token. No path of a request is opened as a file:
what there is to serve is read once, at the start. Pages of other origins are refused, and so are requests whose Host is not this
server's: no other web site in the same browser can reach the robot.
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
from dataclasses import replace
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web

from gibson_sim.errors import ConfigError
from gibson_sim.web.curves import CurveName, Sample
from gibson_sim.web.dead_man import DeadMan
from gibson_sim.web.pages import Backend, Page, send_queued
from gibson_sim.web.requests import MAX_BYTES, Drive, PageRequestError, Plot, Shown, Watch, parse_request
from gibson_sim.web.videos import Streamed

logger = logging.getLogger(__name__)

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MAX_PAGES = 20
"""Pages that may be connected at a time."""
MAX_ROBOTS = 100
"""Robots that pages may drive at a time."""
_TICK_S = 0.05
"""Seconds between two looks at who drives."""
_SILENT_S = 10.0
"""A page that answers no ping for this long is gone."""
_PRESENT_S, _MOST_KEPT = 0.3, 64
"""Age up to which an image shows the present, on the clock of the stamps, s; and number of images that are kept."""
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_POLICY = "default-src 'self'; img-src 'self' blob: data:; connect-src 'self' ws: wss:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"


class PageServer:
    """Serves the page.

    Args:
        backend: what stands behind it.
        host: address to listen on.
        port: of TCP; 0 = any that is free.
        token: what a page must know; "" = nothing, which is allowed on loopback alone.

    Raises:
        ConfigError: the address cannot be used, or is not loopback and has no token.
    """

    def __init__(self, backend: Backend, host: str = "127.0.0.1", port: int = 0, token: str = "") -> None:
        if host not in LOOPBACK and not token:
            raise ConfigError(f"address {host} is not of this machine alone: a token is needed")
        self._backend, self._host, self._token = backend, host, token
        self._pages: set[Page] = set()
        self._watched: frozenset[str] = frozenset()
        self._plotted: frozenset[CurveName] = frozenset()
        self._newest: dict[str, Streamed] = {}
        """Topic -> its newest image: a page that is opened while time is paused gets it."""
        self._dead_men: dict[str, DeadMan] = {}
        """Robot -> who drives it."""
        self._kept: dict[str, str] = {}
        self._files = {entry.name: entry.read_bytes() for entry in files("gibson_sim.web").joinpath("page").iterdir()}
        self._blobs: dict[str, bytes] = {}
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
        """The address for a browser."""
        host = socket.gethostname() if self._host in ("0.0.0.0", "::") else f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/" + (f"?token={self._token}" if self._token else "")

    def tell(self, kind: str, values: Any, *, keep: bool = False) -> None:
        """Sends values to every page, as JSON; may be called from any thread.

        Args:
            kind: what they are.
            values: anything that JSON can hold.
            keep: pages that come later get the newest ones, too.
        """
        text = json.dumps({"type": kind, "value": values}, allow_nan=False)
        self._call(self._tell, kind, text, keep)

    def show(self, image: Streamed) -> None:
        """Sends an image or poses to the pages that watch them; may be called from any thread."""
        self._call(self._show, image)

    def forget_images(self, now_s: float) -> None:
        """Forgets images, but for those of this moment: others are of a past that a page must not take for the present.

        Args:
            now_s: the time now on the clock of their stamps, s.
        """
        self._call(self._forget_images, now_s)

    def show_curves(self, now_s: float, samples: dict[CurveName, list[Sample]]) -> None:
        """Sends values to the pages that plot them; may be called from any thread.

        Args:
            now_s: the time now, on the clock of the samples.
            samples: what came since the last call.
        """
        self._call(self._show_curves, now_s, samples)

    def serve_blob(self, name: str, data: bytes) -> None:
        """Serves bytes under ``/data/<name>`` from now on: the map, the mesh of the scene."""
        self._call(self._blobs.__setitem__, name, data)

    def close(self) -> None:
        """Ends the server. The backend is told to stop the robot, if a page drove it, before connections are closed, which may take seconds."""
        if self._loop.is_running():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._released.wait(timeout=5.0)

    def join(self) -> None:
        """Waits until the connections are closed, after ``close``."""
        self._thread.join(timeout=5.0)

    @property
    def _cookie(self) -> str:
        """The cookie with the token: browsers share cookies between the ports of a host."""
        return f"gibson_sim_token_{self.port}"

    # All below runs in the server's thread.

    def _call(self, function: Callable[..., Any], *arguments: Any) -> None:
        if not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # it was closed at this moment
                self._loop.call_soon_threadsafe(function, *arguments)

    def _run(self, port: int) -> None:
        asyncio.set_event_loop(self._loop)
        runner = web.AppRunner(self._application(), access_log=None, shutdown_timeout=1.0)
        try:
            self._loop.run_until_complete(runner.setup())
            site = web.TCPSite(runner, self._host, port)
            self._loop.run_until_complete(site.start())
            self.port = runner.addresses[0][1]
        except OSError as error:
            self._loop.run_until_complete(runner.cleanup())
            self._loop.close()
            self._error = error
            self._ready.set()
            return
        self._ready.set()
        ticking = self._loop.create_task(self._tick())
        try:
            self._loop.run_forever()
        finally:
            ticking.cancel()
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
            ]
        )
        return application

    @web.middleware
    async def _guard(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        """Refuses other hosts, other origins and, where there is a token, who does not know it."""
        try:
            host = urlsplit(f"//{request.host}").hostname or ""
            origin = request.headers.get("Origin")
            foreign = origin is not None and urlsplit(origin).netloc != request.host
        except ValueError as error:
            raise web.HTTPForbidden(text="Host or Origin is no address") from error
        if self._host in LOOPBACK and host not in LOOPBACK:
            raise web.HTTPForbidden(text="this server answers to localhost alone")
        if foreign:
            raise web.HTTPForbidden(text="pages of other web sites are refused")
        given = request.query.get("token") or request.cookies.get(self._cookie, "")
        if self._token and not hmac.compare_digest(given.encode(errors="replace"), self._token.encode()):
            raise web.HTTPForbidden(text="the token is missing or wrong: open the address that `gibson-sim` printed")
        response: web.StreamResponse = await handler(request)
        if not response.prepared:
            response.headers["Content-Security-Policy"] = _POLICY
            response.headers["X-Content-Type-Options"] = "nosniff"
            response.headers["Cache-Control"] = "no-store"
            if self._token and "token" in request.query:
                assert isinstance(response, web.Response)
                response.set_cookie(self._cookie, self._token, httponly=True, samesite="Strict")
        return response

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info.get("name", "index.html")
        if name not in self._files:
            raise web.HTTPNotFound()
        return web.Response(
            body=self._files[name], content_type=_TYPES.get(name.rpartition(".")[2], "text/plain"), charset="utf-8"
        )

    async def _blob(self, request: web.Request) -> web.Response:
        data = self._blobs.get(request.match_info["name"])
        if data is None:
            raise web.HTTPNotFound()
        return web.Response(body=data, content_type="application/octet-stream")

    async def _socket(self, request: web.Request) -> web.WebSocketResponse:
        if len(self._pages) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{MAX_PAGES} pages are connected already")
        socket = web.WebSocketResponse(heartbeat=_SILENT_S / 2, max_msg_size=MAX_BYTES, compress=False)
        try:
            await socket.prepare(request)
        except ConnectionError as error:
            # The browser closed the page while it loaded; as another exception this would be logged with its traceback.
            raise web.HTTPServiceUnavailable(text="the page was closed") from error
        page = Page(socket, asyncio.Queue(maxsize=64))
        self._pages.add(page)
        for text in self._kept.values():
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
        except PageRequestError as error:
            page.reply("", False, str(error))
            return
        if not isinstance(request, Shown | Drive) and not page.may_ask(time.monotonic()):
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
            self._backend.ask(request, lambda ok, text, value=None: self._call(page.send_history, value))
        elif isinstance(request, Drive):
            if not self._driven(page, request):
                page.reply("drive", False, "another page drives")
        else:
            kind = type(request).__name__
            self._backend.ask(request, lambda ok, text, value=None: self._call(page.reply, kind, ok, text, value))

    def _driven(self, page: Page, request: Drive) -> bool:
        """Takes a command; returns False where another page drives this robot."""
        man = self._dead_men.get(request.robot)
        if man is None and len(self._dead_men) < MAX_ROBOTS:
            man = self._dead_men[request.robot] = DeadMan()
        return man is not None and man.drive(page, replace(request, robot=""), time.monotonic())

    def _release(self, *pages: Page) -> None:
        for man in self._dead_men.values():
            for page in pages:
                man.release(page)

    def _drive(self) -> bool:
        """Has the commands that are due sent; returns whether there were any."""
        now, sent = time.monotonic(), False
        for robot, man in list(self._dead_men.items()):
            if (command := man.due(now)) is not None:
                self._backend.drive(replace(command, robot=robot))
                sent = True
            if man.idle:
                del self._dead_men[robot]
        return sent

    def _update_watched(self) -> None:
        watched = frozenset().union(*(page.viewer.topics for page in self._pages))
        if watched != self._watched:
            self._watched = watched
            self._backend.watch(watched)

    def _update_plotted(self) -> None:
        plotted = frozenset().union(*(page.curves for page in self._pages))
        if plotted != self._plotted:
            self._plotted = plotted
            self._backend.plot(plotted)

    def _show_curves(self, now_s: float, samples: dict[CurveName, list[Sample]]) -> None:
        for page in self._pages:
            page.send_samples("samples", now_s, samples)

    def _tell(self, kind: str, text: str, keep: bool) -> None:
        if keep:
            self._kept[kind] = text
        for page in self._pages:
            page.put(text)

    def _forget_images(self, now_s: float) -> None:
        self._newest = {topic: image for topic, image in self._newest.items() if abs(image.stamp_s - now_s) < _PRESENT_S}

    def _show(self, image: Streamed) -> None:
        if image.topic in self._newest or len(self._newest) < _MOST_KEPT:
            self._newest[image.topic] = image
        for page in self._pages:
            page.viewer.offer(image)

    async def _tick(self) -> None:
        while True:
            self._drive()
            await asyncio.sleep(_TICK_S)
