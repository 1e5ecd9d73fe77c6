"""A program and all that it starts end together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gibson_sim.testing.contained_process import NOT_FOUND, contained_command
from support.simulation import PATIENCE_S, wait_until

DAEMON = """
import os, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        open(sys.argv[1], "w").write(str(os.getpid()))
        time.sleep(1000)
    os._exit(0)
os.wait()
{then}
"""
"""Leaves a daemon that ignores SIGTERM, in a session of its own."""
Start = Callable[..., "subprocess.Popen[bytes]"]


def _is_there(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Runs a source in a contained Python; returns its process."""
    processes = []

    def begin(source: str, *arguments: str) -> subprocess.Popen[bytes]:
        processes.append(subprocess.Popen(contained_command([sys.executable, "-c", source, *arguments]), cwd=tmp_path))
        return processes[-1]

    yield begin
    for process in processes:
        process.kill()
        process.wait()


def _daemon(file: Path) -> int:
    wait_until(lambda: file.is_file() and bool(file.read_text()), "daemon")
    return int(file.read_text())


@pytest.mark.parametrize(
    ("source", "code"), [("pass", 0), ("raise SystemExit(3)", 3), ("import os; os.kill(os.getpid(), 9)", 137)]
)
def test_the_exit_code_is_that_of_the_program(start: Start, source: str, code: int) -> None:
    assert start(source).wait(PATIENCE_S) == code


def test_a_program_that_does_not_exist_is_named() -> None:
    done = subprocess.run(contained_command(["/no/such/program"]), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (NOT_FOUND, "error: /no/such/program cannot be started: No such file or directory\n")


def test_a_daemon_ends_with_its_program(start: Start, tmp_path: Path) -> None:
    process = start(DAEMON.format(then="raise SystemExit(0)"), str(tmp_path / "pid"))
    daemon = _daemon(tmp_path / "pid")
    assert process.wait(PATIENCE_S) == 0
    assert not _is_there(daemon)


def test_a_daemon_ends_when_the_program_is_asked_to_end(start: Start, tmp_path: Path) -> None:
    process = start(DAEMON.format(then="time.sleep(1000)"), str(tmp_path / "pid"))
    daemon = _daemon(tmp_path / "pid")
    process.send_signal(signal.SIGTERM)
    process.wait(PATIENCE_S)
    assert not _is_there(daemon)


def test_all_end_when_the_process_that_started_them_is_killed(tmp_path: Path) -> None:
    source = (
        "import subprocess, sys\nfrom gibson_sim.testing.contained_process import contained_command\n"
        "subprocess.Popen(contained_command([sys.executable, '-c', sys.argv[1], sys.argv[2]])).wait()"
    )
    parent = subprocess.Popen([sys.executable, "-c", source, DAEMON.format(then="time.sleep(1000)"), str(tmp_path / "pid")])
    daemon = _daemon(tmp_path / "pid")
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    wait_until(lambda: not _is_there(daemon), "end of the daemon")
