"""Ports that a user requests."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest

from gibson_sim.cli.commands import clients, run
from gibson_sim.cli.ports import check_port
from gibson_sim.errors import ConfigError


class _Page(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"<html><head><title>Gibson Sim</title></head></html>")

    def log_message(self, format: str, *args: object) -> None:
        """Prints nothing."""


@pytest.fixture
def page() -> Iterator[int]:
    """The port of a page of ours."""
    with HTTPServer(("127.0.0.1", 0), _Page) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


@pytest.fixture
def taken() -> Iterator[int]:
    """A port of a program that speaks no HTTP: it hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def hang_up() -> None:
            while True:
                try:
                    server.accept()[0].close()
                except OSError:
                    return

        thread = Thread(target=hang_up)
        thread.start()
        yield server.getsockname()[1]
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def _refusal(command: str, *words: str) -> str:
    parser = argparse.ArgumentParser()
    (run if command == "run" else clients).add_parser(parser.add_subparsers())
    args = parser.parse_args([command, *words])
    with pytest.raises(ConfigError) as error:
        (run.check_ports if command == "run" else clients.check_web_port)(args)
    return str(error.value)


def test_the_address_of_our_page_is_printed(page: int) -> None:
    with pytest.raises(ConfigError) as error:
        check_port("--port", "127.0.0.1", page)
    expected = f"--port {page} is taken on 127.0.0.1; open http://127.0.0.1:{page}/, where a page is served already, or choose another port"
    assert str(error.value) == expected


def test_another_program_at_the_port_is_not_taken_for_our_page(taken: int) -> None:
    with pytest.raises(ConfigError) as error:
        check_port("--port", "127.0.0.1", taken)
    assert str(error.value) == f"--port {taken} is taken on 127.0.0.1; choose another port"


def test_any_free_port_and_addresses_of_other_machines_are_left_to_the_server() -> None:
    check_port("--port", "127.0.0.1", 0)
    check_port("--port", "192.0.2.1", 8123)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("web", "--port"), "--port"),
        (("web", "--foxglove", "--port"), "--port"),
        (("run", "--web-port"), "--web-port"),
        (("run", "--foxglove-port"), "--foxglove-port"),
    ],
)
def test_an_error_names_the_option_that_was_typed(words: tuple[str, ...], option: str, taken: int) -> None:
    assert _refusal(*words, str(taken)) == f"{option} {taken} is taken on 127.0.0.1; choose another port"
    assert _refusal(*words, "70000") == f"{option} is 70000, must be a port from 0 to 65535; 0 = any that is free"
