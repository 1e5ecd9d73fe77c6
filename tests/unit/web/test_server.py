"""The server of the live page: admission of pages, distribution of messages, the stop of the robot."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import aiohttp
import aiohttp.web
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.web.curves import CurveName, Sample
from gibson_sim.web.pages import Answer, Page
from gibson_sim.web.recordings import Recordings
from gibson_sim.web.requests import Drive, Plot, Request, Time
from gibson_sim.web.server import MAX_PAGES, PageServer
from gibson_sim.web.videos import Image


class Backend:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.watched: list[frozenset[str]] = []
        self.commands: list[Drive] = []
        self.asked: list[Request] = []
        self.plotted: list[frozenset[CurveName]] = []
        self.history: dict[CurveName, list[Sample]] = {}

    def watch(self, topics: frozenset[str]) -> None:
        self.watched.append(topics)

    def plot(self, curves: frozenset[CurveName]) -> None:
        self.plotted.append(curves)

    def drive(self, command: Drive) -> None:
        self.commands.append(command)

    def handle_request(self, request: Request, answer: Answer) -> None:
        self.asked.append(request)
        if isinstance(request, Plot):
            answer(True, "", (10.0, self.history))
        else:
            answer(True, "done")


@pytest.fixture
def backend() -> Backend:
    return Backend()


@pytest.fixture
def server(backend: Backend) -> Iterator[PageServer]:
    server = PageServer(backend)
    yield server
    server.close()
    server.join()


def _get(url: str, **headers: str) -> tuple[int, str]:
    async def get() -> tuple[int, str]:
        async with aiohttp.ClientSession() as session, session.get(url, headers=headers) as response:
            return response.status, await response.text()

    return asyncio.run(get())


def _talk(server: PageServer, talk: Callable[[aiohttp.ClientWebSocketResponse], Any], **headers: str) -> Any:
    async def run() -> Any:
        url = f"http://127.0.0.1:{server.port}/socket"
        async with aiohttp.ClientSession() as session, session.ws_connect(url, headers=headers) as socket:
            return await talk(socket)

    return asyncio.run(run())


def _until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


async def _reply(socket: aiohttp.ClientWebSocketResponse) -> Any:
    while True:
        message = await socket.receive_json()
        if message["type"] == "reply":
            return message["value"]


def test_the_page_and_its_parts_are_served(server: PageServer) -> None:
    status, text = _get(server.url)
    assert status == 200 and "<title>Gibson Sim</title>" in text
    for name in (
        "app.js",
        "dom.js",
        "drive.js",
        "inspector.js",
        "layout.js",
        "log.js",
        "map.js",
        "plots.js",
        "recordings.js",
        "scene3d.js",
        "task.js",
        "tree.js",
        "videos.js",
        "zip.js",
        "style.css",
        "icon.svg",
    ):
        assert _get(f"{server.url}page/{name}")[0] == 200


@pytest.mark.parametrize(
    "path", ["page/..%2f__init__.py", "page/%2e%2e/server.py", "page//etc/passwd", "data/..%2f..", "page/none"]
)
def test_no_path_is_opened(server: PageServer, path: str) -> None:
    assert _get(server.url + path)[0] == 404


def test_another_web_site_is_refused(server: PageServer) -> None:
    assert _get(server.url, Origin="http://evil.example")[0] == 403
    assert _get(server.url, Host="evil.example")[0] == 403  # a name that an attacker's DNS has turned to loopback
    with pytest.raises(aiohttp.WSServerHandshakeError):
        _talk(server, lambda socket: socket.close(), Origin="http://evil.example")


def test_another_address_needs_a_token(backend: Backend) -> None:
    with pytest.raises(ConfigError, match="a token is required"):
        PageServer(backend, "0.0.0.0")
    server = PageServer(backend, "0.0.0.0", token="correct-horse")
    try:
        for query, status in (("", 403), ("?token=wrong", 403), ("?token=correct-horse", 200)):
            assert _get(f"http://127.0.0.1:{server.port}/{query}")[0] == status
    finally:
        server.close()
        server.join()


def test_a_port_that_is_taken_is_one_line(server: PageServer, backend: Backend) -> None:
    with pytest.raises(ConfigError, match=f"port {server.port} of 127.0.0.1 cannot be used"):
        PageServer(backend, port=server.port)


def test_requests_of_a_page_reach_the_backend_and_are_answered(server: PageServer, backend: Backend) -> None:
    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        await socket.send_json({"type": "time", "action": "pause"})
        done = await _reply(socket)
        await socket.send_str("nonsense")
        return done, await _reply(socket)

    done, refused = _talk(server, talk)
    assert done == {"to": "Time", "ok": True, "text": "done"}
    assert not refused["ok"] and "is not JSON" in refused["text"]
    assert backend.asked == [Time("pause")]


def test_images_are_sent_only_to_pages_that_watch_them(server: PageServer, backend: Backend) -> None:
    async def talk(socket: aiohttp.ClientWebSocketResponse) -> bytes:
        await socket.send_json({"type": "watch", "topics": ["/a"]})
        while not backend.watched:
            await asyncio.sleep(0.005)
        server.send_image(Image("/b", 1.0, b"other"))
        server.send_image(Image("/a", 2.0, b"jpeg"))
        return await socket.receive_bytes()

    assert _talk(server, talk).endswith(b"/ajpeg")
    _until(lambda: backend.watched[-1] == frozenset())
    assert backend.watched[0] == frozenset({"/a"})


def test_a_lost_connection_stops_the_robot(server: PageServer, backend: Backend) -> None:
    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        await socket.send_json({"type": "drive", "linear": 0.5})
        while not backend.commands:
            await asyncio.sleep(0.005)
        socket._response.connection.transport.abort()

    _talk(server, talk)
    _until(lambda: Drive(0.0, 0.0, 0.0) in backend.commands)
    assert backend.commands[0] == Drive(0.5, 0.0, 0.0)


def test_a_server_that_ends_stops_the_robot_before_it_closes_connections(backend: Backend) -> None:
    server = PageServer(backend)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> int:
        await socket.send_json({"type": "drive", "linear": 0.5})
        while not backend.commands:
            await asyncio.sleep(0.005)
        server.close()
        return backend.commands[-3:].count(Drive(0.0, 0.0, 0.0))

    assert _talk(server, talk) == 3
    server.join()


@pytest.mark.parametrize("headers", [{"Cookie": "gibson_sim_token=\xff"}, {"Host": "[::1"}, {"Origin": "http://[::1"}])
def test_odd_headers_are_refused(backend: Backend, headers: dict[str, str]) -> None:
    server = PageServer(backend, "0.0.0.0", token="correct-horse")
    assert _get(f"http://127.0.0.1:{server.port}/", **headers)[0] in (400, 403)
    server.close()
    server.join()


def test_a_second_page_cannot_take_the_robot(server: PageServer, backend: Backend) -> None:
    async def talk(first: aiohttp.ClientWebSocketResponse) -> Any:
        async def keep_driving() -> None:
            while True:
                await first.send_json({"type": "drive", "linear": 0.5})
                await asyncio.sleep(0.05)

        driving = asyncio.create_task(keep_driving())
        while not backend.commands:
            await asyncio.sleep(0.005)
        async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{server.port}/socket") as second:
            await second.send_json({"type": "drive", "linear": -1.0})
            refused = await _reply(second)
        driving.cancel()
        return refused

    assert _talk(server, talk)["text"] == "another page is driving"
    assert Drive(-1.0, 0.0, 0.0) not in backend.commands


def test_a_page_that_connects_later_gets_the_kept_messages(server: PageServer) -> None:
    server.broadcast("map", {"width": 3}, keep=True)
    server.broadcast("scan", [1])

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        return await socket.receive_json()

    assert _talk(server, talk) == {"type": "map", "value": {"width": 3}}


def test_a_page_that_reads_nothing_delays_no_other(server: PageServer, backend: Backend) -> None:
    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        for number in range(20_000):
            server.broadcast("status", {"number": number, "text": "x" * 1000})
        async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{server.port}/socket") as second:
            await second.send_json({"type": "time", "action": "play"})
            return await _reply(second)

    assert _talk(server, talk)["ok"]


def test_the_number_of_pages_is_limited(server: PageServer) -> None:
    async def run() -> int:
        async with aiohttp.ClientSession() as session:
            url = f"http://127.0.0.1:{server.port}/socket"
            sockets = [await session.ws_connect(url) for _ in range(MAX_PAGES)]
            async with session.get(url) as response:
                status = response.status
            for socket in sockets:
                await socket.close()
            return status

    assert asyncio.run(run()) == 503


def test_pages_drive_two_robots_at_once_and_each_is_stopped(server: PageServer, backend: Backend) -> None:
    async def talk(first: aiohttp.ClientWebSocketResponse) -> None:
        async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{server.port}/socket") as second:
            await first.send_json({"type": "drive", "linear": 0.5, "robot": "left"})
            await second.send_json({"type": "drive", "linear": 0.7, "robot": "right"})
            while len({command.robot for command in backend.commands}) < 2:
                await asyncio.sleep(0.005)

    _talk(server, talk)
    for robot, speed in (("left", 0.5), ("right", 0.7)):
        _until(lambda robot=robot: backend.commands.count(Drive(0.0, 0.0, 0.0, robot)) == 3)  # type: ignore[misc]
        assert {c.linear for c in backend.commands if c.robot == robot} == {0.0, speed}


def test_a_page_gets_the_curves_that_it_plots_and_no_others(server: PageServer, backend: Backend) -> None:
    backend.history = {("/a", "x"): [(9.0, 1.0)], ("/b", "y"): [(9.0, 2.0)]}

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> Any:
        await socket.send_json({"type": "plot", "curves": [["/a", "x"]]})
        history = await socket.receive_json()
        server.send_samples(11.0, {("/a", "x"): [(10.5, None)], ("/b", "y"): [(10.5, 3.0)]})
        return history, await socket.receive_json()

    history, samples = _talk(server, talk)
    assert history == {"type": "history", "value": {"now": 10.0, "curves": [["/a", "x", [[9.0, 1.0]]]]}}
    assert samples == {"type": "samples", "value": {"now": 11.0, "curves": [["/a", "x", [[10.5, None]]]]}}
    _until(lambda: backend.plotted[-1] == frozenset())  # the page has gone
    assert backend.plotted[0] == {("/a", "x")}


def test_a_page_that_connects_later_gets_the_current_image_and_no_earlier_ones(server: PageServer) -> None:
    async def first_image(socket: aiohttp.ClientWebSocketResponse) -> bytes | None:
        await socket.send_json({"type": "watch", "topics": ["/a"]})
        await socket.send_json({"type": "time", "action": "play"})
        while True:
            message = await socket.receive()
            if message.type is aiohttp.WSMsgType.BINARY:
                return bytes(message.data)
            if message.json()["type"] == "reply":
                return None

    server.send_image(Image("/a", 5.0, b"jpeg"))
    server.drop_stale_images(5.1)
    found = _talk(server, first_image)
    assert found is not None and found.endswith(b"/ajpeg")
    server.drop_stale_images(7.0)
    assert _talk(server, first_image) is None


def test_a_page_that_sends_requests_without_end_is_warned_once() -> None:
    """60 requests at once, and 30 a second after that."""
    page = Page(cast("Any", None), asyncio.Queue())
    assert [page.allow_request(100.0) for _ in range(70)] == [True] * 60 + [False] * 10
    assert [page.allow_request(101.0) for _ in range(40)] == [True] * 30 + [False] * 10
    told = [json.loads(page.queue.get_nowait())["value"]["text"] for _ in range(page.queue.qsize())]
    assert told == ["too many requests: at most 30 per second are answered"] * 2, "once each time that it begins to"


def test_requests_beyond_the_limit_do_not_reach_the_backend_but_a_drive_does(server: PageServer, backend: Backend) -> None:
    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        for _ in range(1000):
            await socket.send_json({"type": "time", "action": "play"})
        await socket.send_json({"type": "drive", "linear": 0.5})
        await asyncio.to_thread(_until, lambda: bool(backend.commands))

    _talk(server, talk)
    assert 60 <= len(backend.asked) < 1000
    assert backend.commands[0] == Drive(0.5, 0.0, 0.0)


def test_a_browser_that_closes_while_the_page_loads_leaves_no_traceback(
    server: PageServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    prepare = aiohttp.web.WebSocketResponse.prepare

    async def after_the_close(socket: Any, request: Any) -> Any:
        request.transport.abort()
        return await prepare(socket, request)

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> None:
        await socket.close()

    monkeypatch.setattr(aiohttp.web.WebSocketResponse, "prepare", after_the_close)
    with pytest.raises(aiohttp.ClientError):
        _talk(server, talk)
    monkeypatch.undo()
    assert _get(f"http://127.0.0.1:{server.port}/")[0] == 200
    _talk(server, talk)
    assert not [record for record in caplog.records if record.levelname == "ERROR"]


def _trial(folder: Path) -> None:
    folder.mkdir()
    (folder / "results.json").write_text('{"totals": {"passed": 1, "runs": 1}}')
    (folder / "index.html").write_text("<h1>Trial</h1>")


def test_recordings_are_listed_and_reports_run_no_script(backend: Backend, tmp_path: Path) -> None:
    _trial(tmp_path / "trial")
    server = PageServer(backend, recordings=Recordings(tmp_path))

    async def get(path: str) -> tuple[int, str, str]:
        async with aiohttp.ClientSession() as session, session.get(server.url + path) as response:
            return response.status, await response.text(), response.headers.get("Content-Security-Policy", "")

    try:
        status, text, _ = asyncio.run(get("recordings"))
        [entry] = json.loads(text)["entries"]
        assert (status, entry["kind"], entry["name"]) == (200, "trial", "trial")
        status, text, policy = asyncio.run(get(f"recordings/{entry['key']}/report"))
        assert (status, text) == (200, "<h1>Trial</h1>")
        assert "sandbox;" in policy and "default-src 'none'" in policy and "script" not in policy
        assert asyncio.run(get("recordings/..%2f..%2fetc/report"))[0] == 422
        assert asyncio.run(get(f"recordings/{entry['key']}/plots"))[:2] == (
            422,
            "no bag with this key is listed: list the recordings again",
        )
        assert asyncio.run(get(f"recordings/{entry['key']}/index.html"))[0] == 404
    finally:
        server.close()
        server.join()


def test_a_server_without_a_folder_lists_nothing(server: PageServer) -> None:
    assert _get(f"{server.url}recordings")[0] == 404 and _get(f"{server.url}recordings/x/report")[0] == 404


def test_recordings_need_the_token_and_an_own_host(backend: Backend, tmp_path: Path) -> None:
    server = PageServer(backend, "0.0.0.0", token="secret-token", recordings=Recordings(tmp_path))
    try:
        address = f"http://127.0.0.1:{server.port}/recordings"
        assert _get(address)[0] == 403 and _get(f"{address}/x/report")[0] == 403
        assert _get(f"{address}?token=secret-token")[0] == 200
        assert _get(f"{address}?token=secret-token", Origin="http://elsewhere.example")[0] == 403
    finally:
        server.close()
        server.join()


def test_the_first_camera_is_received_for_a_page_that_is_loaded(
    server: PageServer, backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gibson_sim.web.server._EXPECTED_S", 0.5)
    server.broadcast("topics", [{"topic": "/camera", "label": "camera"}, {"topic": "/view", "label": "view"}], keep=True)
    assert _get(server.url)[0] == 200
    _until(lambda: backend.watched == [frozenset({"/camera"})])
    server.send_image(Image("/camera", 1.0, b"jpeg"))

    async def talk(socket: aiohttp.ClientWebSocketResponse) -> bytes:
        await socket.send_json({"type": "watch", "topics": ["/camera"]})
        while (message := await socket.receive(timeout=60)).type is not aiohttp.WSMsgType.BINARY:
            pass
        return cast(bytes, message.data)

    assert _talk(server, talk).endswith(b"jpeg"), "the image that came before the page had connected"
    _until(lambda: backend.watched[-1] == frozenset())
