"""Services whose answers may come later, while everything else goes on.

A coroutine would do the same with rclpy's standard executor, at the price of being polled; the EventsExecutor does not know services
that are coroutines. So the answer itself says that it is not there yet, and the service keeps the header that it must be sent with.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from threading import Thread
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

logger = logging.getLogger(__name__)


class DeferredResponse:
    """An answer that is not there yet. ``answer`` must be called once, in the thread of the executor."""

    def __init__(self) -> None:
        self._response: Any = None
        self._send: Callable[[Any], None] | None = None

    def answer(self, response: Any) -> None:
        """Sends the answer."""
        self._response = response
        if self._send is not None:
            self._send(response)

    def send_with(self, send: Callable[[Any], None]) -> None:
        """Says how to send it; does it where it is there already."""
        self._send = send
        if self._response is not None:
            send(self._response)


class DeferredService:
    """A service whose handler returns the response, or a ``DeferredResponse``. A client that went away does not disturb it."""

    def __init__(
        self, node: Node, kind: Any, name: str, handle: Callable[[Any, Any], Any], *, callback_group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._service = node.create_service(kind, name, handle, callback_group=callback_group)
        self._send_now = self._service.send_response
        # Both executors look this up on the service, and call it with what the handler returned.
        self._service.send_response = self._send

    def destroy(self) -> None:
        """Takes the service back; what was not answered never will be."""
        self._node.destroy_service(self._service)

    def _send(self, response: Any, header: Any) -> None:
        if isinstance(response, DeferredResponse):
            response.send_with(lambda final: self._send(final, header))
            return
        try:
            self._send_now(response, header)
        except (RCLError, InvalidHandle) as error:
            logger.info("an answer of %s could not be sent, its client may be gone: %s", self._service.srv_name, error)


class InOrder:
    """A queue of requests; not thread-safe but for the reading, which it does in a thread of its own."""

    def __init__(self, run_soon: Callable[..., Any]) -> None:
        """``run_soon(function, *arguments)`` calls a function in the thread of the executor; it may drop it once that has ended."""
        self._run_soon = run_soon
        self._waiting: deque[tuple[Callable[[], Any] | None, Callable[[Any], Any], DeferredResponse]] = deque()
        self._reading = False

    def take(self, act: Callable[[Any], Any], read: Callable[[], Any] | None = None) -> Any:
        """Returns what ``act`` returns, at once where nothing is before it and nothing is to be read, else a ``DeferredResponse`` for it.

        Args:
            act: does what is asked for and returns the response, or a ``DeferredResponse``; is given what ``read`` returned, else None.
            read: reads files in a thread, and touches nothing else; None = there is nothing to read.
        """
        if read is None and not self._waiting:
            return act(None)
        later = DeferredResponse()
        self._waiting.append((read, act, later))
        self._go_on()
        return later

    def _go_on(self) -> None:
        while self._waiting and not self._reading:
            read = self._waiting[0][0]
            if read is not None:
                self._reading = True
                Thread(target=self._read, args=(read,), name="read-ahead", daemon=True).start()
                return
            self._act(None)

    def _read(self, read: Callable[[], Any]) -> None:
        try:
            found = read()
        except Exception:  # it comes again, and is answered, where nothing was read ahead
            found = None
        self._run_soon(self._ended, found)

    def _ended(self, found: Any) -> None:
        self._reading = False
        self._act(found)
        self._go_on()

    def _act(self, found: Any) -> None:
        _, act, later = self._waiting.popleft()
        outcome = act(found)
        if isinstance(outcome, DeferredResponse):
            outcome.send_with(later.answer)
        else:
            later.answer(outcome)
