"""TCP connections of the live page's server: how many are open, for how long without a request, and what the log says of them.

Whoever reaches the port can open connections, also without the token. They must neither use up the process's file handles, which the rest
of the node needs, nor take the places of pages that are connected, nor fill the log. Must not import ROS.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import resource
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp.http import HttpProcessingError

_OUT_OF_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_RETRY_S = 1.0
"""Time without new connections after the process ran out of file handles, seconds: they would fail at once, in a busy loop."""
_BACKLOG = 128
_SHARE_OF_HANDLES = 4
"""Connections without a page take at most this part of the process's file handles: a quarter."""


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """Limits of the connections that are not pages: those that load files, wait for a request, or have not finished one."""

    total: int = 256
    """Largest number; the actual one is at most a quarter of the process's file handles (``RLIMIT_NOFILE``)."""
    per_address: int = 64
    """Largest number from one IP address. A browser opens at most six to a server."""
    idle_s: float = 10.0
    """Time in which a connection must finish the head of its request, and in which an idle one waits for the next, seconds of wall time."""

    @property
    def affordable(self) -> int:
        """The smaller of ``total`` and a quarter of the process's file handles."""
        handles, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        return self.total if handles == resource.RLIM_INFINITY else max(1, min(self.total, handles // _SHARE_OF_HANDLES))


class RareWarnings:
    """One line of a kind every ``period_s`` seconds at most; the next one says how many were left out.

    Args:
        logger: where the lines go.
        period_s: shortest time between two lines of a kind, seconds.
    """

    def __init__(self, logger: logging.Logger, period_s: float = 60.0) -> None:
        self._logger, self._period_s = logger, period_s
        self._last: dict[str, tuple[float, int]] = {}
        """Kind -> time of its last line, and the number that was left out since."""

    def warn(self, kind: str, text: str, error: BaseException | None = None) -> None:
        """Logs a line, or counts it.

        Args:
            kind: lines of one kind share a limit. The number of kinds must be bounded.
            text: the line.
            error: exception whose traceback follows the line; None = none.
        """
        now = time.monotonic()
        last_s, left_out = self._last.get(kind, (-float("inf"), 0))
        if now - last_s < self._period_s:
            self._last[kind] = (last_s, left_out + 1)
            return
        self._last[kind] = (now, 0)
        self._logger.warning("%s", text + (f" ({left_out} more since the last such line)" if left_out else ""), exc_info=error)


class RequestErrors(logging.LoggerAdapter[logging.Logger]):
    """The logger of aiohttp's protocol: malformed requests become one line, rarely, instead of a traceback each.

    Args:
        logger: where the lines go.
        warnings: limits their number.
    """

    def __init__(self, logger: logging.Logger, warnings: RareWarnings) -> None:
        super().__init__(logger, {})
        self._warnings = warnings

    def exception(self, msg: object, *args: object, exc_info: object = True, **_: object) -> None:
        """Logs an exception while a request was read or answered; aiohttp passes the address of the client as the first argument."""
        client = f" from {args[0]}" if args else ""
        if isinstance(exc_info, HttpProcessingError):
            reason = exc_info.message.strip().partition("\n")[0].rstrip(":")  # the bad bytes follow, over several lines
            self._warnings.warn("malformed", f"the page refused a malformed HTTP request{client}: {reason[:100]!r}")
        else:
            error = exc_info if isinstance(exc_info, BaseException) else None
            self._warnings.warn(f"error {type(error).__name__}", f"the page could not answer a request{client}: {error}", error)


@dataclass(eq=False, slots=True)
class _Connection:
    socket: socket.socket
    address: str
    since_s: float
    """Time since which it has been waiting for a request or been served."""
    transport: asyncio.Transport | None = None
    serving: bool = False
    """Whether a request is being answered."""
    is_page: bool = False
    """Whether it is a connected page, which keeps its place."""
    unsent: int = 0
    """Bytes of an answer that the client had not taken at the last look."""

    @property
    def is_busy(self) -> bool:
        """Whether a request is being answered, or its answer still sent."""
        return self.serving or (self.transport is not None and self.transport.get_write_buffer_size() > 0)


class ConnectionGate:
    """Accepts connections within limits. All methods run in one event loop.

    When there are too many, the oldest that wait for a request are closed, those of the address with the most of them first, so that a
    request which arrives whole is still answered. Connected pages are not counted and never closed.

    Args:
        limits: numbers and times.
        warnings: says, rarely, that connections were closed.
    """

    def __init__(self, limits: ConnectionLimits, warnings: RareWarnings) -> None:
        self._limits, self._total, self._warnings = limits, limits.affordable, warnings
        self._open: dict[asyncio.Transport, _Connection] = {}

    async def accept(self, listener: socket.socket, protocol: Callable[[], asyncio.BaseProtocol]) -> None:
        """Accepts connections of a listening, non-blocking socket until it is cancelled.

        Args:
            listener: the socket.
            protocol: makes the protocol of a connection.
        """
        loop = asyncio.get_running_loop()
        while True:
            try:
                accepted, peer = await loop.sock_accept(listener)
            except OSError as error:
                if error.errno in _OUT_OF_RESOURCES:
                    self._warnings.warn("accept", f"the page accepts no connection for {_RETRY_S:g} s: {error.strerror}")
                    self.close_idle(0.0)
                    await asyncio.sleep(_RETRY_S)
                await asyncio.sleep(0)
                continue
            accepted.setblocking(False)
            connection = _Connection(accepted, str(peer[0]) if peer else "", loop.time())
            self._make_room(connection.address)
            try:
                transport, _ = await loop.connect_accepted_socket(protocol, accepted)
            except OSError:  # it was reset meanwhile
                accepted.close()
                continue
            connection.transport = transport
            self._open[transport] = connection

    def begin(self, transport: asyncio.BaseTransport | None) -> None:
        """Notes that a whole head of a request has arrived on a connection."""
        if (connection := self._find(transport)) is not None:
            connection.serving, connection.since_s = True, asyncio.get_running_loop().time()

    def end(self, transport: asyncio.BaseTransport | None) -> None:
        """Notes that a request was answered: the connection waits for the next one."""
        if (connection := self._find(transport)) is not None:
            connection.serving = connection.is_page = False
            connection.since_s = asyncio.get_running_loop().time()

    def keep(self, transport: asyncio.BaseTransport | None) -> None:
        """Gives a connected page its place."""
        if (connection := self._find(transport)) is not None:
            connection.is_page = True

    def close_idle(self, idle_s: float | None = None) -> None:
        """Closes the connections on which neither a whole head arrived nor a part of an answer was taken for too long.

        Args:
            idle_s: the longest wait, seconds; None = that of the limits.
        """
        now, limit = asyncio.get_running_loop().time(), self._limits.idle_s if idle_s is None else idle_s
        for connection in self._counted():
            assert connection.transport is not None
            unsent = connection.transport.get_write_buffer_size()
            if unsent < connection.unsent:
                connection.since_s = now
            connection.unsent = unsent
            if not connection.serving and now - connection.since_s >= limit:
                self._close(connection)

    def _find(self, transport: asyncio.BaseTransport | None) -> _Connection | None:
        return self._open.get(transport) if isinstance(transport, asyncio.Transport) else None

    def _counted(self) -> list[_Connection]:
        """Returns the open connections that are not pages; forgets closed ones."""
        for transport, connection in list(self._open.items()):
            # A transport that is closing holds its file handle until all is sent.
            if connection.socket.fileno() < 0:
                del self._open[transport]
        return [connection for connection in self._open.values() if not connection.is_page]

    def _make_room(self, address: str) -> None:
        """Closes connections if there is no place for one more from an address."""
        counted = self._counted()
        same = [connection for connection in counted if connection.address == address]
        if len(same) >= self._limits.per_address:
            text = f"{address} has {len(same)} connections to the page: the oldest are closed, at most {self._limits.per_address} stay"
            self._warnings.warn("address", text)
            self._close(_oldest(same))
        elif len(counted) >= self._total:
            most, _ = Counter(connection.address for connection in counted).most_common(1)[0]
            text = f"{len(counted)} connections to the page are open, the most from {most}: the oldest of those are closed"
            self._warnings.warn("total", text)
            self._close(_oldest([connection for connection in counted if connection.address == most]))

    def _close(self, connection: _Connection) -> None:
        assert connection.transport is not None
        connection.transport.abort()  # `close` would first send what is left, to a client that may not read it
        self._open.pop(connection.transport, None)


def _oldest(connections: list[_Connection]) -> _Connection:
    """Returns the connection to close first: the oldest that waits for a request, else the oldest of all."""
    return min(connections, key=lambda connection: (connection.is_busy, connection.since_s))


def listen(host: str, port: int) -> list[socket.socket]:
    """Returns listening, non-blocking sockets, one for each address of a host, all with one port.

    Args:
        host: name or IP address.
        port: TCP port; 0 = any free port.

    Raises:
        OSError: the address cannot be used.
    """
    out: list[socket.socket] = []
    try:
        for family, kind, protocol, _, address in dict.fromkeys(
            socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        ):
            try:
                listener = socket.socket(family, kind, protocol)
            except OSError:  # a machine without IPv6 can name IPv6 addresses
                continue
            out.append(listener)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            actual = port or (out[0].getsockname()[1] if len(out) > 1 else 0)
            listener.bind((address[0], actual, *address[2:]))
            listener.listen(_BACKLOG)
            listener.setblocking(False)
        if not out:
            raise OSError(errno.EADDRNOTAVAIL, f"{host} has no address that can be used")
    except OSError:
        for listener in out:
            with contextlib.suppress(OSError):
                listener.close()
        raise
    return out
