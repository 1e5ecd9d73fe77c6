"""Checks requested TCP ports before processes are started, so that an error names the option."""

from __future__ import annotations

import errno
import http.client
import socket

from gibson_sim.errors import ConfigError

_PROBE_S = 1.0
"""Timeout for a response of the page at an occupied port, s of wall time."""
_TITLE = b"<title>Gibson Sim</title>"


def check_port(option: str, host: str, port: int) -> None:
    """Checks a requested port; 0 = any free port. The server itself checks the address.

    Args:
        option: option of the port, such as ``--web-port``.
        host: address to listen on.
        port: TCP port.

    Raises:
        ConfigError: the port cannot be used.
    """
    if not 0 <= port <= 65535:
        raise ConfigError(f"{option} is {port}, must be a port from 0 to 65535; 0 = any that is free")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                hint = f"open {_url(host, port)}, where a page is served already, or " if _is_our_page(host, port) else ""
                raise ConfigError(f"{option} {port} is taken on {host}; {hint}choose another port") from error
            if error.errno == errno.EACCES:
                raise ConfigError(f"{option} {port} cannot be used: {error.strerror}; choose a port above 1023") from error


def _is_our_page(host: str, port: int) -> bool:
    connection = http.client.HTTPConnection(_reachable_address(host), port, timeout=_PROBE_S)
    try:
        connection.request("GET", "/")
        return _TITLE in connection.getresponse().read(4096)
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def _reachable_address(host: str) -> str:
    """Returns the address at which this machine reaches a server that listens on ``host``."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)


def _url(host: str, port: int) -> str:
    address = _reachable_address(host)
    return f"http://{f'[{address}]' if ':' in address else address}:{port}/"
