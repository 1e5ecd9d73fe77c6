"""Progress of a trial: a bar on a terminal, one line per run otherwise."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

from gibson_sim.cli.console import CONSOLE, Console
from gibson_sim.cli.workers import report_interrupt
from gibson_sim.quoting import duration_text
from gibson_sim.trials.comparison import runs_text
from gibson_sim.trials.records import RunResult
from gibson_sim.trials.report.words import run_line
from gibson_sim.trials.running import Progress

_BAR = 20
"""Length of the bar, characters."""
_MOST_SHOWN = 3
"""Maximum number of active runs that are named."""
_QUIET_S = 2.0
"""Duration of planning below which it is not reported, seconds of wall time."""
_PERIOD_S = 10.0
"""Interval between two lines about planning without a terminal, seconds of wall time."""


class TrialProgress(Progress):
    """Reports a trial on the console.

    While it is planned: the number of planned runs, if planning takes long. While runs are executed: the numbers of completed and passed runs,
    the remaining time, and the active runs.

    Args:
        console: receives the output.
        clock: returns wall time, seconds.
    """

    def __init__(self, *, console: Console = CONSOLE, clock: Callable[[], float] = time.monotonic) -> None:
        self._console, self._clock = console, clock
        self._began = clock()
        self._last_report = self._began + _QUIET_S - _PERIOD_S
        self._total = self._before = self._done = self._passed = 0
        self._now: dict[int, str] = {}

    def planned(self, done: int, total: int) -> None:
        """Reports that ``done`` of ``total`` runs are planned: as a bar on a terminal, in occasional lines otherwise."""
        now = self._clock()
        if now - self._began < _QUIET_S or done == total:
            return
        remaining = f", {duration_text((now - self._began) / done * (total - done))} left" if done else ""
        line = f"planning: {done} of {total} runs{remaining}"
        if self._console.is_terminal:
            self._console.status(line)
        elif now - self._last_report >= _PERIOD_S:
            self._last_report = now
            self._console.write(line)

    def begins(self, name: str, total: int, done: int, folder: Path) -> None:
        """Prints what is executed, and shows the bar."""
        already_done = f", {done} of them already done" if done else ""
        self._console.write(f"{name}: {runs_text(total)}{already_done}; results go into {folder}")
        self._total, self._before, self._began = total, done, self._clock()
        self._show()

    def report(self, number: int, text: str) -> None:
        """Shows the state of a run."""
        self._now[number] = text
        self._show()

    def add(self, result: RunResult) -> None:
        """Counts a completed run; prints its line, unless it passed and a terminal shows the bar."""
        self._done += 1
        self._passed += result.passed
        self._now.pop(result.run.number, None)
        if not sys.stdout.isatty():
            print(run_line(result), flush=True)
        elif not (result.passed and self._console.is_terminal):
            self._console.write(run_line(result))
        self._show()

    def interrupted(self, running: int) -> None:
        """Prints what happens after Ctrl-C."""
        report_interrupt("runs", running)

    def close(self) -> None:
        """Removes the bar."""
        self._console.status("")

    def line(self) -> str:
        """Returns the bar with the numbers of runs."""
        done = self._before + self._done
        filled = _BAR * done // max(self._total, 1)
        parts = [f"[{'#' * filled}{'-' * (_BAR - filled)}] {done}/{self._total}"]
        parts += [f"{self._passed} passed, {self._done - self._passed} failed"] if self._done else []
        parts += [f"{left} left"] if (left := self._left()) else []
        names = list(self._now.items())
        shown = ", ".join(f"run {number}: {text}" if text else f"run {number}" for number, text in names[:_MOST_SHOWN])
        more = f", and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
        return "; ".join((*parts, shown + more) if shown else parts)

    def _left(self) -> str:
        """Returns the remaining time, extrapolated from the completed runs; empty = unknown, or no runs remain."""
        rest = self._total - self._before - self._done
        if not (self._done and rest):
            return ""
        return duration_text((self._clock() - self._began) / self._done * rest)

    def _show(self) -> None:
        self._console.status(self.line())
