"""Crashes of the render node: counted per time, reported with their cause."""

from __future__ import annotations

import io
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.cli import job, processes
from gibson_sim.cli.console import Console
from gibson_sim.cli.job import Job, JobRun, Restarts
from gibson_sim.cli.parser import ExitCode
from gibson_sim.cli.processes import NodeProcess

HOUR_S = 3600.0


def test_renderer_that_crashes_once_an_hour_is_restarted_for_a_week() -> None:
    time_s = [0.0]
    restarts = Restarts(3, 600.0, lambda: time_s[0])
    for hour in range(7 * 24):
        time_s[0] = hour * HOUR_S
        assert restarts.allow()
    assert restarts.total == 168


def test_fourth_crash_within_the_window_is_the_last() -> None:
    time_s = [0.0]
    restarts = Restarts(3, 600.0, lambda: time_s[0])
    for crash_s in (0.0, 200.0, 400.0):
        time_s[0] = crash_s
        assert restarts.allow()
    time_s[0] = 599.0
    assert not restarts.allow()
    time_s[0] = 600.0
    assert restarts.allow(), "the first one is ten minutes ago"
    assert not restarts.allow()
    assert restarts.total == 4


@pytest.fixture
def ends_with(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Returns a node that runs the given program instead of its own."""

    def node(program: str) -> NodeProcess:
        monkeypatch.setattr(processes, "command_of", lambda module, *arguments: [sys.executable, "-c", program])
        monkeypatch.setattr(processes, "node_arguments", lambda config: [])
        return NodeProcess("render", None, {}, out=Console(io.StringIO()))

    return node


KILL = "import os, sys; print(*{lines!r}, sep='\\n', flush=True); os.kill(os.getpid(), {signal})"


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["INFO 3 cameras", "INFO error: is a word too"], "the render node was killed by SIGSEGV"),
        ([], "the render node was killed by SIGSEGV"),
        (["ERROR device lost", "INFO closing"], "the render node was killed by SIGSEGV: device lost"),
        (["[ERROR] [172.4] [render]: device lost"], "the render node was killed by SIGSEGV: device lost"),
        (["error: no device", "INFO closing"], "the render node was killed by SIGSEGV: no device"),
        (["  raise ValueError(x)", "ValueError: 3 rows"], "the render node was killed by SIGSEGV: ValueError: 3 rows"),
        (["MemoryError", "INFO bye"], "the render node was killed by SIGSEGV: MemoryError"),
    ],
)
def test_ending_names_the_signal_and_quotes_errors_alone(ends_with: Any, lines: Sequence[str], expected: str) -> None:
    node = ends_with(KILL.format(lines=lines, signal=int(signal.SIGSEGV)))
    assert node.ending() == expected


def test_exit_code_is_the_reason_where_no_error_was_reported(ends_with: Any) -> None:
    assert ends_with("print('INFO done'); raise SystemExit(7)").reason() == "the render node ended with code 7"
    assert ends_with("print('error: no such scene'); raise SystemExit(1)").reason() == "no such scene"


def test_run_survives_crashes_that_are_far_apart(ends_with: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The renderer crashes five times; by the clock of the restarts an hour passes between two crashes."""
    hours = iter(range(100))
    monkeypatch.setattr(job, "Restarts", lambda limit, window_s: Restarts(limit, window_s, lambda: next(hours) * HOUR_S))
    monkeypatch.setattr(job, "remove_dead_segments", lambda: [])
    monkeypatch.setattr(job.time, "sleep", lambda _: None)
    started = []

    def start(self: JobRun, name: str) -> None:
        started.append(name)
        code = f"raise SystemExit({0 if len(started) == 6 else 9})"
        self._nodes[name] = ends_with(code)

    monkeypatch.setattr(JobRun, "_start", start)
    monkeypatch.setattr(JobRun, "_report", lambda self: None)
    monkeypatch.setattr(job, "ENDS_THE_JOB", ("render",))
    assert JobRun(Job(tmp_path, {"render": None}), {}).run() == ExitCode.OK
    assert len(started) == 6
