"""Estimates of the remaining wall time of a stage, for lines of progress."""

from __future__ import annotations

import time
from collections.abc import Callable

from gibson_sim.quoting import duration_text


class Remaining:
    """Estimates the remaining wall time of a stage from its mean rate so far.

    Args:
        done: number of steps that were finished before the stage began or resumed.
        clock: returns wall time, seconds.
    """

    def __init__(self, done: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self._first, self._clock = done, clock
        self._began_s = clock()

    def text(self, done: int, total: int) -> str:
        """Returns the remaining time after ``done`` of ``total`` steps, such as ``, 5 min left``; empty before the first and after the last step."""
        if not self._first < done < total:
            return ""
        left_s = (self._clock() - self._began_s) / (done - self._first) * (total - done)
        return f", {duration_text(max(left_s, 1.0))} left"
