"""How a trial goes, for who watches: a bar on a terminal, a line for each run elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from gibson_sim.cli.console import CONSOLE, Console
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.words import run_line

_BAR = 20
"""Characters of the bar."""
_MOST_SHOWN = 3
"""Running runs that are named."""


class TrialProgress:
    """Tells how many runs are done, how many passed, how long the rest takes, and what runs now.

    Args:
        total: number of planned runs.
        before: results of an earlier time, which are not made again.
        console: where the bar is.
        clock: wall time, seconds.
    """

    def __init__(
        self, total: int, before: int = 0, *, console: Console = CONSOLE, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._total, self._before, self._console, self._clock = total, before, console, clock
        self._began = clock()
        self._done = self._passed = 0
        self._now: dict[int, str] = {}

    def begins(self) -> None:
        """Shows the bar."""
        self._show()

    def tell(self, number: int, text: str) -> None:
        """Shows what happens in a run."""
        self._now[number] = text
        self._show()

    def add(self, result: RunResult) -> None:
        """Counts a run that has ended; prints its line, unless it passed and a terminal shows the bar."""
        self._done += 1
        self._passed += result.passed
        self._now.pop(result.run.number, None)
        if not sys.stdout.isatty():
            print(run_line(result), flush=True)
        elif not (result.passed and self._console.is_terminal):
            self._console.write(run_line(result))
        self._show()

    def close(self) -> None:
        """Removes the bar."""
        self._console.status("")

    def line(self) -> str:
        """Returns the bar with its numbers."""
        done = self._before + self._done
        filled = _BAR * done // max(self._total, 1)
        told = [f"[{'#' * filled}{'-' * (_BAR - filled)}] {done}/{self._total}"]
        told += [f"{self._passed} passed, {self._done - self._passed} failed"] if self._done else []
        told += [f"{left} left"] if (left := self._left()) else []
        names = list(self._now.items())
        shown = ", ".join(f"run {number}: {text}" if text else f"run {number}" for number, text in names[:_MOST_SHOWN])
        more = f", and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
        return "; ".join((*told, shown + more) if shown else told)

    def _left(self) -> str:
        """Returns the remaining time by the pace so far; empty = unknown, or nothing remains."""
        rest = self._total - self._before - self._done
        if not (self._done and rest):
            return ""
        seconds = (self._clock() - self._began) / self._done * rest
        return (
            f"{seconds:.0f} s"
            if seconds < 90.0
            else f"{seconds / 60.0:.0f} min"
            if seconds < 5400.0
            else f"{seconds / 3600.0:.1f} h"
        )

    def _show(self) -> None:
        self._console.status(self.line())
