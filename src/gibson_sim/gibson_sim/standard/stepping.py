"""Steps that clients request while the simulation is paused; the node's loop executes them, a few at a time, in the order of the requests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gibson_sim.standard.codes import Result, SimulationError

MAX_REQUESTS = 64
"""Maximum number of queued requests."""


class StepRequest:
    """A client's request for a number of steps."""

    def __init__(
        self,
        steps: int,
        on_progress: Callable[[StepRequest], None] | None = None,
        on_end: Callable[[StepRequest], None] | None = None,
    ) -> None:
        self.steps = steps
        """Number of requested steps."""
        self.completed = 0
        """Number of executed steps."""
        self.failure = ""
        """Reason why it ended before all steps were executed; empty = it did not."""
        self.ended = False
        self._on_progress, self._on_end = on_progress, on_end

    @property
    def remaining(self) -> int:
        """Number of steps still to be executed."""
        return self.steps - self.completed

    def advance(self) -> None:
        """Counts an executed step."""
        self.completed += 1
        if self._on_progress is not None:
            self._on_progress(self)

    def end(self, failure: str = "") -> None:
        """Ends the request, with a reason if it failed; a second call does nothing."""
        if self.ended:
            return
        self.ended = True
        if failure:
            self.failure = f"{failure} after {self.completed} of {self.steps} steps"
        if self._on_end is not None:
            self._on_end(self)


class StepQueue:
    """Queue of step requests, first in, first out."""

    def __init__(self) -> None:
        self._waiting: deque[StepRequest] = deque()

    @property
    def remaining(self) -> int:
        """Number of steps still to be executed, of all requests together."""
        return sum(request.remaining for request in self._waiting)

    def add(self, request: StepRequest) -> None:
        """Appends a request; a request for no steps ends at once.

        Raises:
            SimulationError: the queue is full.
        """
        if len(self._waiting) >= MAX_REQUESTS:
            raise SimulationError(
                Result.OPERATION_FAILED, f"{MAX_REQUESTS} requests for steps are waiting already; wait for them"
            )
        if request.steps == 0:
            request.end()
        else:
            self._waiting.append(request)

    def count_step(self) -> None:
        """Counts a step for the first request."""
        if not self._waiting:
            return
        first = self._waiting[0]
        first.advance()
        # Its progress callback may have cancelled it, and all others.
        if first.remaining == 0 and not first.ended:
            self._waiting.remove(first)
            first.end()

    def cancel(self, request: StepRequest, reason: str) -> None:
        """Ends one request early; does nothing if it is not queued."""
        if request in self._waiting:
            self._waiting.remove(request)
            request.end(reason)

    def clear(self, reason: str) -> bool:
        """Ends all requests early; returns whether there were any."""
        ended, self._waiting = self._waiting, deque()
        for request in ended:
            request.end(reason)
        return bool(ended)
