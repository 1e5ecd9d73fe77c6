"""Estimates of the remaining wall time of a stage, for lines of progress."""

from __future__ import annotations

import time
from collections.abc import Callable


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
        if left_s < 60.0:
            return f", {max(left_s, 1.0):.0f} s left"
        if left_s < 5400.0:
            return f", {left_s / 60.0:.0f} min left"
        return f", {left_s / 3600.0:.1f} h left"
