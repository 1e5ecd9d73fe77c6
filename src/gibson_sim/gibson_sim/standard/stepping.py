"""Steps that clients request while the simulation is paused; the node's loop makes them, a few at a time, in the order of the requests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gibson_sim.standard.codes import Result, SimulationError

MOST_REQUESTS = 64
"""Greatest number of waiting requests."""


class StepRequest:
    """A client's request for a number of steps."""

    def __init__(
        self,
        steps: int,
        on_progress: Callable[[StepRequest], None] | None = None,
        on_end: Callable[[StepRequest], None] | None = None,
    ) -> None:
        self.steps = steps
        """Steps requested."""
        self.completed = 0
        """Steps made."""
        self.failure = ""
        """Why it ended before all steps were made; empty = it did not."""
        self.ended = False
        self._on_progress, self._on_end = on_progress, on_end

    @property
    def remaining(self) -> int:
        """Steps still to be made."""
        return self.steps - self.completed

    def advance(self) -> None:
        """Counts a step that was made."""
        self.completed += 1
        if self._on_progress is not None:
            self._on_progress(self)

    def end(self, failure: str = "") -> None:
        """Ends the request; a second call does nothing."""
        if self.ended:
            return
        self.ended = True
        if failure:
            self.failure = f"{failure} after {self.completed} of {self.steps} steps"
        if self._on_end is not None:
            self._on_end(self)


class StepQueue:
    """Requests in the order of their arrival."""

    def __init__(self) -> None:
        self._waiting: deque[StepRequest] = deque()

    @property
    def remaining(self) -> int:
        """Steps still to be made for all requests together."""
        return sum(request.remaining for request in self._waiting)

    def add(self, request: StepRequest) -> None:
        """Appends a request; a request for no steps ends at once.

        Raises:
            SimulationError: too many are waiting.
        """
        if len(self._waiting) >= MOST_REQUESTS:
            raise SimulationError(
                Result.OPERATION_FAILED, f"{MOST_REQUESTS} requests for steps are waiting already; wait for them"
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
        # Its callback may have cancelled it, and all others.
        if first.remaining == 0 and not first.ended:
            self._waiting.remove(first)
            first.end()

    def cancel(self, request: StepRequest, why: str) -> None:
        """Ends one request before its time."""
        if request in self._waiting:
            self._waiting.remove(request)
            request.end(why)

    def clear(self, why: str) -> bool:
        """Ends all requests before their time; returns whether there were any."""
        ended, self._waiting = self._waiting, deque()
        for request in ended:
            request.end(why)
        return bool(ended)
