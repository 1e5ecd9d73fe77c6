"""Requests that change the simulation take effect one after the other, also where what one needs is read first, beside time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Thread
from typing import Any

from gibson_sim.ros.deferred import DeferredResponse


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
