"""Deferred responses: services that respond later without blocking the executor, and requests that take effect in order.

rclpy's standard executor supports coroutines as service callbacks, but polls them; the EventsExecutor does not support them. Here the handler
returns a ``DeferredResponse``, and the service keeps the request header until the response is sent.
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
    """A service whose handler returns the response or a ``DeferredResponse``. A response to a client that is gone is dropped."""

    def __init__(
        self, node: Node, kind: Any, name: str, handle: Callable[[Any, Any], Any], *, callback_group: CallbackGroup | None = None
    ) -> None:
        self._node = node
        self._service = node.create_service(kind, name, handle, callback_group=callback_group)
        self._send_now = self._service.send_response
        # Both executors look up this attribute of the service, and call it with the return value of the handler.
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
        """Sends the response, immediately if ``bind`` was called, otherwise when it is."""
        self._response = response
        if self._sender is not None:
            self._sender(response)

    def bind(self, sender: Callable[[Any], None]) -> None:
        """Sets the function that sends the response; calls it immediately if ``send`` was called already."""
        self._sender = sender
        if self._response is not None:
            sender(self._response)


class RequestQueue:
    """Executes requests in the order of their arrival, even if some of them read files first.

    Files are read in a thread; all other work runs in the thread of the executor.
    """

    def __init__(self, run_soon: Callable[..., Any]) -> None:
        """Creates an empty queue; ``run_soon(function, *arguments)`` schedules a call in the executor's thread, or drops it after its end."""
        self._run_soon = run_soon
        self._waiting: deque[tuple[Callable[[], Any] | None, Callable[[Any], Any], DeferredResponse]] = deque()
        self._reading = False

    def submit(self, act: Callable[[Any], Any], read: Callable[[], Any] | None = None) -> Any:
        """Executes ``act``, immediately if no request is queued and there is nothing to read, otherwise in order.

        Args:
            act: executes the request and returns the response, or a ``DeferredResponse``; its argument is the result of ``read``, or None.
            read: reads files; runs in a thread and must not access shared state; None = there is nothing to read.

        Returns:
            The result of ``act``, or a ``DeferredResponse`` for it.
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
            contents = read()
        except Exception:  # ``act`` reads again, and reports the error
            contents = None
        self._run_soon(self._on_read, contents)

    def _on_read(self, contents: Any) -> None:
        self._reading = False
        self._act(contents)
        self._continue()

    def _act(self, contents: Any) -> None:
        _, act, deferred = self._waiting.popleft()
        outcome = act(contents)
        if isinstance(outcome, DeferredResponse):
            outcome.bind(deferred.send)
        else:
            deferred.send(outcome)
