"""Requests take effect in the order of their arrival, even if some of them read files."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Queue
from typing import Any

import pytest

from support.simulation import require

require("rclpy")

from gibson_sim.ros.services.deferred import DeferredResponse, RequestQueue  # noqa: E402

PATIENCE_S = 60.0


class Loop:
    """Replaces the thread of an executor."""

    def __init__(self) -> None:
        self._soon: Queue[tuple[Callable[..., None], tuple[Any, ...]]] = Queue()
        self.requests = RequestQueue(lambda function, *arguments: self._soon.put((function, arguments)))
        self.done: list[str] = []
        self.answers: list[str] = []

    def turn(self) -> None:
        function, arguments = self._soon.get(timeout=PATIENCE_S)
        function(*arguments)

    def ask(self, name: str, read: Callable[[], Any] | None = None) -> bool:
        """Submits a request; returns whether the response is there at once."""

        def act(found: Any) -> str:
            self.done.append(f"{name} {found}" if found else name)
            return name

        outcome = self.requests.submit(act, read)
        if isinstance(outcome, DeferredResponse):
            outcome.bind(self.answers.append)
        else:
            self.answers.append(outcome)
        return not isinstance(outcome, DeferredResponse)


@pytest.fixture
def loop() -> Loop:
    return Loop()


def test_a_request_without_reading_is_done_at_once(loop: Loop) -> None:
    assert loop.ask("a")
    assert loop.done == loop.answers == ["a"]


def test_later_requests_wait_for_the_reading_and_the_loop_does_not(loop: Loop) -> None:
    gate = threading.Event()
    assert not loop.ask("spawn", lambda: gate.wait(PATIENCE_S) and "file")
    assert not loop.ask("delete")
    assert not loop.ask("second", lambda: "other")
    assert not loop.ask("reset")
    assert loop.done == []
    gate.set()
    loop.turn()
    assert loop.done == ["spawn file", "delete"]
    loop.turn()
    assert loop.done == ["spawn file", "delete", "second other", "reset"]
    assert loop.answers == ["spawn", "delete", "second", "reset"]
    assert loop.ask("later")


def test_reading_that_fails_leaves_the_response_to_act(loop: Loop) -> None:
    def fail() -> None:
        raise RuntimeError("a mistake of ours")

    loop.ask("spawn", fail)
    loop.turn()
    assert loop.done == ["spawn"]


def test_a_deferred_response_is_passed_on(loop: Loop) -> None:
    own = DeferredResponse()
    outcome = loop.requests.submit(lambda _: own, lambda: None)
    outcome.bind(loop.answers.append)
    loop.turn()
    assert loop.answers == []
    own.send("done")
    assert loop.answers == ["done"]
