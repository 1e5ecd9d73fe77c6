"""Deferred responses: services that answer later without blocking the executor, and requests that take effect in order.

With rclpy's standard executor a coroutine would do, at the price of being polled; the EventsExecutor does not support services that are
coroutines. Here the handler returns a ``DeferredResponse``, and the service keeps the request header until the response is sent.
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


class DeferredService:
    """A service whose handler returns the response or a ``DeferredResponse``. A response whose client has gone is dropped."""

    def __init__(
        self, node: Node, kind: Any, name: str, handle: Callable[[Any, Any], Any], *, callback_group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._service = node.create_service(kind, name, handle, callback_group=callback_group)
        self._send_now = self._service.send_response
        # Both executors look this up on the service, and call it with what the handler returned.
        self._service.send_response = self._send

    def destroy(self) -> None:
        """Destroys the service; deferred responses are never sent."""
        self._node.destroy_service(self._service)

    def _send(self, response: Any, header: Any) -> None:
        if isinstance(response, DeferredResponse):
            response.bind(lambda final: self._send(final, header))
            return
        try:
            self._send_now(response, header)
        except (RCLError, InvalidHandle) as error:
            logger.info("a response of %s could not be sent, its client may be gone: %s", self._service.srv_name, error)


class DeferredResponse:
    """A response that is sent later. ``send`` must be called once, in the thread of the executor."""

    def __init__(self) -> None:
        self._response: Any = None
        self._sender: Callable[[Any], None] | None = None

    def send(self, response: Any) -> None:
        """Sends the response, at once if ``bind`` was called, otherwise then."""
        self._response = response
        if self._sender is not None:
            self._sender(response)

    def bind(self, sender: Callable[[Any], None]) -> None:
        """Sets the function that sends the response; it is called at once if the response is there already."""
        self._sender = sender
        if self._response is not None:
            sender(self._response)


class RequestQueue:
    """Makes requests take effect in the order of their arrival, even if some of them need files.

    Files are read in a thread; everything else runs in the thread of the executor.
    """

    def __init__(self, run_soon: Callable[..., Any]) -> None:
        """``run_soon(function, *arguments)`` calls a function in the thread of the executor; it may drop it once that has ended."""
        self._run_soon = run_soon
        self._waiting: deque[tuple[Callable[[], Any] | None, Callable[[Any], Any], DeferredResponse]] = deque()
        self._reading = False

    def submit(self, act: Callable[[Any], Any], read: Callable[[], Any] | None = None) -> Any:
        """Runs ``act``, at once if no request waits and there is nothing to read, otherwise in its turn.

        Args:
            act: fulfils the request and returns the response, or a ``DeferredResponse``; its argument is the result of ``read``, or None.
            read: reads files in a thread, and touches nothing else; None = there is nothing to read.

        Returns:
            What ``act`` returned, or a ``DeferredResponse`` for it.
        """
        if read is None and not self._waiting:
            return act(None)
        deferred = DeferredResponse()
        self._waiting.append((read, act, deferred))
        self._continue()
        return deferred

    def _continue(self) -> None:
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
        except Exception:  # ``act`` reads again, and reports it
            found = None
        self._run_soon(self._on_read, found)

    def _on_read(self, found: Any) -> None:
        self._reading = False
        self._act(found)
        self._continue()

    def _act(self, found: Any) -> None:
        _, act, deferred = self._waiting.popleft()
        outcome = act(found)
        if isinstance(outcome, DeferredResponse):
            outcome.bind(deferred.send)
        else:
            deferred.send(outcome)
