"""Connections of the page's server: those that never finish a request take no places, no file handles and no log."""

from __future__ import annotations

import asyncio
import errno
import logging
import resource
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import aiohttp
import pytest

from gibson_sim.web.connections import ConnectionGate, ConnectionLimits, RareWarnings, listen
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Drive, Request
from gibson_sim.web.server import PageServer

_NEVER_S = 3600.0
"""A time-out that no test reaches."""
_GET = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"


class _Backend:
    def watch(self, topics: frozenset[str]) -> None: ...

    def plot(self, curves: frozenset[Any]) -> None: ...

    def drive(self, command: Drive) -> None: ...

    def handle_request(self, request: Request, answer: Answer) -> None:
        answer(True, "done")


@contextmanager
def _serving(limits: ConnectionLimits) -> Iterator[PageServer]:
    server = PageServer(_Backend(), limits=limits)
    try:
        yield server
    finally:
        server.close()
        server.join()


def _connect(server: PageServer, stack: ExitStack, sent: bytes = b"GET / HT", source: str = "127.0.0.1") -> socket.socket:
    client = stack.enter_context(socket.create_connection(("127.0.0.1", server.port), 30.0, source_address=(source, 0)))
    client.sendall(sent)
    return client


def _received(client: socket.socket) -> bytes:
    """Returns all that arrives until the server closes the connection."""
    out = b""
    try:
        while part := client.recv(65536):
            out += part
    except ConnectionResetError:
        pass
    return out


def _get(server: PageServer, request: bytes = _GET, source: str = "127.0.0.1") -> bytes:
    with ExitStack() as stack:
        return _received(_connect(server, stack, request, source))


def _handshake(**changed: bytes) -> bytes:
    fields = {
        "Host": b"127.0.0.1", "Connection": b"Upgrade", "Upgrade": b"websocket",
        "Sec-WebSocket-Version": b"13", "Sec-WebSocket-Key": b"AAAAAAAAAAAAAAAAAAAAAA==",
    } | {name.replace("_", "-"): value for name, value in changed.items()}  # fmt: skip
    return b"GET /socket HTTP/1.1\r\n" + b"".join(b"%s: %s\r\n" % (k.encode(), v) for k, v in fields.items()) + b"\r\n"


def _with_page(server: PageServer, during: Callable[[], object]) -> Any:
    """Opens a page, calls a function in another thread, and returns the page's reply to a request that follows."""

    async def run() -> Any:
        url = f"http://127.0.0.1:{server.port}/socket"
        async with aiohttp.ClientSession() as session, session.ws_connect(url) as page:
            await asyncio.to_thread(during)
            await page.send_json({"type": "time", "action": "pause"})
            while (message := await page.receive_json())["type"] != "reply":
                pass
            return message["value"]

    return asyncio.run(run())


@pytest.mark.parametrize("sent", [b"", b"GET", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "])
def test_a_head_that_does_not_end_is_closed_after_the_time_out(sent: bytes) -> None:
    with _serving(ConnectionLimits(idle_s=0.1)) as server, ExitStack() as stack:
        assert _received(_connect(server, stack, sent)) == b""


def test_a_head_that_goes_on_byte_by_byte_is_closed_after_the_time_out() -> None:
    with _serving(ConnectionLimits(idle_s=0.1)) as server, ExitStack() as stack:
        client = _connect(server, stack)
        with suppress(ConnectionError):
            while True:  # ends because the server closes the connection
                client.sendall(b"x")


def test_a_connection_whose_response_is_not_read_is_closed_after_the_time_out() -> None:
    with _serving(ConnectionLimits(idle_s=0.1)) as server, ExitStack() as stack:
        server.serve_blob("large", bytes(64_000_000))
        client = stack.enter_context(socket.socket())
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.settimeout(30.0)
        client.connect(("127.0.0.1", server.port))
        client.sendall(b"GET /data/large HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        closed = ExitStack()  # a second connection, idle from later on, is closed after the first
        with closed:
            assert _received(_connect(server, closed)) == b""
        assert len(_received(client)) < 64_000_000


def test_a_response_that_is_read_slowly_is_not_closed() -> None:
    async def run() -> None:
        loop = asyncio.get_running_loop()
        gate = ConnectionGate(ConnectionLimits(), RareWarnings(logging.getLogger("gibson_sim.test")))
        made: asyncio.Future[asyncio.Transport] = loop.create_future()

        class Answering(asyncio.Protocol):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                assert isinstance(transport, asyncio.Transport)
                transport.write(bytes(64_000_000))
                made.set_result(transport)

        (listener,) = listen("127.0.0.1", 0)
        accepting = asyncio.ensure_future(gate.accept(listener, Answering))
        with listener, socket.socket() as client:
            client.setblocking(False)
            await loop.sock_connect(client, listener.getsockname())
            transport = await made
            await asyncio.sleep(0.02)  # until the gate knows it
            gate.close_idle(_NEVER_S)
            for _ in range(3):
                before = transport.get_write_buffer_size()
                while transport.get_write_buffer_size() >= before:
                    await loop.sock_recv(client, 1_000_000)
                await asyncio.sleep(0.02)
                gate.close_idle(0.01)
                assert not transport.is_closing()
            while not transport.is_closing():  # ends once the buffers of the sockets are full, and nothing more is taken
                await asyncio.sleep(0.02)
                gate.close_idle(0.01)
            accepting.cancel()

    asyncio.run(run())


def test_a_page_keeps_its_place_however_many_connections_come() -> None:
    with _serving(ConnectionLimits(total=6, per_address=3, idle_s=_NEVER_S)) as server, ExitStack() as stack:

        def flood() -> None:
            for source in ("127.0.0.2", "127.0.0.3", "127.0.0.1") * 10:
                _connect(server, stack, source=source)

        assert _with_page(server, flood) == {"to": "Time", "ok": True, "text": "done"}


def test_a_page_that_is_silent_is_not_closed_by_the_time_out() -> None:
    with _serving(ConnectionLimits(idle_s=0.05)) as server, ExitStack() as stack:
        # The time-out of a later connection has passed.
        assert _with_page(server, lambda: _received(_connect(server, stack)))["ok"]


def test_one_address_has_no_more_connections_than_its_limit_and_takes_none_from_others() -> None:
    with _serving(ConnectionLimits(total=100, per_address=3, idle_s=_NEVER_S)) as server, ExitStack() as stack:
        other = _connect(server, stack, source="127.0.0.2")
        clients = [_connect(server, stack) for _ in range(5)]
        assert [_received(client) for client in clients[:2]] == [b"", b""]  # the oldest
        for client in (*clients[2:], other):
            client.sendall(_GET[len("GET / HT") :])
            assert _received(client).startswith(b"HTTP/1.1 200")


def test_when_all_places_are_taken_the_address_with_most_connections_loses_one() -> None:
    with _serving(ConnectionLimits(total=4, per_address=4, idle_s=_NEVER_S)) as server, ExitStack() as stack:
        one = _connect(server, stack, source="127.0.0.2")
        many = [_connect(server, stack) for _ in range(3)]
        assert _get(server, source="127.0.0.3").startswith(b"HTTP/1.1 200")
        assert _received(many[0]) == b""
        one.sendall(_GET[len("GET / HT") :])
        assert _received(one).startswith(b"HTTP/1.1 200")


def test_connections_take_at_most_a_quarter_of_the_file_handles(monkeypatch: pytest.MonkeyPatch) -> None:
    for handles, affordable in ((1024, 256), (256, 64), (resource.RLIM_INFINITY, 256), (1_000_000, 256), (2, 1)):
        monkeypatch.setattr(resource, "getrlimit", lambda _, handles=handles: (handles, handles))
        assert ConnectionLimits().affordable == affordable


def test_without_file_handles_one_line_is_logged_and_no_loop_is_busy(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts: list[socket.socket] = []
    sleeps: list[float] = []

    async def sock_accept(listener: socket.socket) -> None:
        attempts.append(listener)
        if len(attempts) > 10:
            raise asyncio.CancelledError
        raise OSError(errno.EMFILE, "Too many open files")

    async def sleep(duration_s: float) -> None:
        sleeps.append(duration_s)

    async def accept() -> None:
        monkeypatch.setattr(asyncio.get_running_loop(), "sock_accept", sock_accept)
        monkeypatch.setattr(asyncio, "sleep", sleep)
        gate = ConnectionGate(ConnectionLimits(), RareWarnings(logging.getLogger("gibson_sim.test")))
        with socket.socket() as listener:
            await gate.accept(listener, asyncio.Protocol)

    with pytest.raises(asyncio.CancelledError):
        asyncio.run(accept())
    assert [record.getMessage() for record in caplog.records] == ["the page accepts no connection for 1 s: Too many open files"]
    assert sum(sleeps) == 10.0


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",  # TLS
        b"GET / HTTP/9\r\n\r\n",
        b"GET / HTTP/1.1\r\nno colon\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"x" * 20_000 + b"\r\n\r\n",
    ],
)
def test_a_malformed_request_gets_400(request_bytes: bytes) -> None:
    with _serving(ConnectionLimits(idle_s=0.5)) as server:
        assert _get(server, request_bytes)[8:12] == b" 400"


def test_malformed_requests_are_one_line_of_log_without_a_traceback(caplog: pytest.LogCaptureFixture) -> None:
    with _serving(ConnectionLimits(idle_s=0.5)) as server:
        for _ in range(50):
            _get(server, b"GET / HTTP/1.1\r\nno colon\r\n\r\n")
    (record,) = caplog.records
    assert record.getMessage().startswith("the page refused a malformed HTTP request from 127.0.0.1: ")
    assert "\n" not in record.getMessage() and not record.exc_info


@pytest.mark.parametrize("field", ["Sec_WebSocket_Version", "Sec_WebSocket_Key", "Upgrade", "Connection"])
def test_a_byte_beyond_ascii_in_the_handshake_gets_400_and_no_traceback(field: str, caplog: pytest.LogCaptureFixture) -> None:
    with _serving(ConnectionLimits(idle_s=0.5)) as server:
        assert _get(server, _handshake(**{field: b"1\xff"})).startswith(b"HTTP/1.1 400")
    assert not any(record.exc_info for record in caplog.records)


@pytest.mark.parametrize("field", ["Host", "Origin", "Cookie", "X_Other"])
def test_a_byte_beyond_ascii_in_any_header_is_no_error_of_the_server(field: str, caplog: pytest.LogCaptureFixture) -> None:
    with _serving(ConnectionLimits(idle_s=0.5)) as server:
        fields = {"Host": b"127.0.0.1", "Connection": b"close", field.replace("_", "-"): b"a\xff=\xfe"}
        head = b"".join(b"%s: %s\r\n" % (k.encode(), v) for k, v in fields.items())
        status = _get(server, b"GET / HTTP/1.1\r\n" + head + b"\r\n")[9:12]
    assert status in (b"200", b"400", b"403")
    assert not any(record.exc_info for record in caplog.records)


def test_the_next_line_says_how_many_were_left_out(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [0.0]
    monkeypatch.setattr("gibson_sim.web.connections.time.monotonic", lambda: now_s[0])
    warnings = RareWarnings(logging.getLogger("gibson_sim.test"), period_s=60.0)
    for now_s[0] in (0.0, 1.0, 59.0, 61.0):
        warnings.warn("kind", "text")
    assert [record.getMessage() for record in caplog.records] == ["text", "text (2 more since the last such line)"]
