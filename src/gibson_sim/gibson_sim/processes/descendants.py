"""Finds and ends all processes that workers started, by a variable that each inherits: sessions and parents change, it stays.

Run as a program, it waits for the end of its standard input, which the caller of ``run_units`` holds, and then ends them and removes the
caller's temporary folder: also when the caller was killed. Imports the standard library alone.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "GIBSON_SIM_JOBS"
"""Environment variable of all descendants: the marks of a worker, outermost first, with colons between."""
TERM_S = 3.0
"""Wall time between SIGTERM and SIGKILL, seconds."""
_PERIOD_S = 0.02


def with_mark(environment: Mapping[str, str], mark: str) -> dict[str, str]:
    """Returns an environment with one more mark."""
    before = environment.get(VARIABLE, "")
    return {**environment, VARIABLE: f"{before}:{mark}" if before else mark}


def marked(mark: str) -> list[int]:
    """Returns the ids of all processes with a mark, except this one. Another user's processes are not seen."""
    found = []
    for entry in os.scandir("/proc"):
        if entry.name.isdigit() and int(entry.name) != os.getpid() and mark in _marks(int(entry.name)):
            found.append(int(entry.name))
    return found


def end_marked(mark: str, term_s: float = TERM_S) -> None:
    """Ends all processes with a mark, by SIGTERM, and those that are there ``term_s`` seconds later by SIGKILL."""
    asked: set[int] = set()
    deadline = time.monotonic() + term_s
    while there := marked(mark):
        late = time.monotonic() >= deadline
        for pid in there:
            if late or pid not in asked:
                _send(pid, signal.SIGKILL if late else signal.SIGTERM)
        asked.update(there)
        time.sleep(_PERIOD_S)


class Janitor:
    """A process that ends all processes with a mark, and removes a folder, once this process closes it or ends, however it ends."""

    def __init__(self, mark: str, folder: Path) -> None:
        """``folder``: removed at the end."""
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, mark, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def close(self) -> None:
        """Waits until all has ended; a second call does nothing."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        if not self._process.stdout.closed:
            self._process.stdout.read()  # it ends with the last process that holds it
            self._process.stdout.close()
        self._process.wait()


def _marks(pid: int) -> list[str]:
    try:
        with open(f"/proc/{pid}/environ", "rb") as file:
            environment = file.read()
    except OSError:  # it has ended, or is another user's
        return []
    prefix = f"{VARIABLE}=".encode()
    value = next((entry for entry in environment.split(b"\0") if entry.startswith(prefix)), b"")
    return os.fsdecode(value[len(prefix) :]).split(":")


def _send(pid: int, number: signal.Signals) -> None:
    try:
        os.kill(pid, number)
    except OSError:  # it has ended
        return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.fork():  # no child of the caller: Ray ends the children of a worker with it
        os._exit(0)
    sys.stdin.buffer.read()
    end_marked(sys.argv[1])
    shutil.rmtree(sys.argv[2], ignore_errors=True)
