"""Finds and ends all descendants of a program by an inherited environment variable, since sessions and parents can change.

As a program, it waits for the end of its standard input, which the caller of ``run_units`` holds open, then ends the processes and removes the
caller's temporary folder, even if the caller was killed. Imports only the standard library.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

VARIABLE = "GIBSON_SIM_JOBS"
"""Environment variable of all processes that workers start: marks of the worker, outermost first, separated by colons."""
TERM_S = 3.0
"""Wall time between SIGTERM and SIGKILL, seconds."""
_KILLED_S = 10.0
"""Wall time that a process has to end after SIGKILL, seconds: a process in uninterruptible sleep does not end."""
_PERIOD_S = 0.02
_PROCESSES = Path("/proc")


def with_mark(environment: Mapping[str, str], mark: str) -> dict[str, str]:
    """Returns a copy of an environment with an additional mark."""
    marks = environment.get(VARIABLE, "")
    return {**environment, VARIABLE: f"{marks}:{mark}" if marks else mark}


def marked(mark: str, variable: str = VARIABLE) -> list[int]:
    """Returns the ids of all processes with a mark, except this one. Another user's processes are not seen.

    Args:
        mark: one of the marks in the variable at the start of the process.
        variable: name of the environment variable.
    """
    return sorted(pid for pid in _all() if pid != os.getpid() and mark in _marks(pid, variable))


def end_marked(mark: str, variable: str = VARIABLE, term_s: float = TERM_S) -> int:
    """Ends all processes with a mark, see ``end_all``; returns their number."""
    return end_all(lambda: marked(mark, variable), term_s)


def descendants(pid: int, without: Iterable[int] = ()) -> list[int]:
    """Returns the ids of all descendants of a process, without those in ``without`` and their descendants."""
    children: dict[int, list[int]] = {}
    for process_id in _all():
        children.setdefault(_parent(process_id), []).append(process_id)
    result, pending, excluded = [], [pid], set(without)
    while pending:
        included = [child for child in children.get(pending.pop(), ()) if child not in excluded]
        result += included
        pending += included
    return sorted(result)


def end_all(find: Callable[[], list[int]], term_s: float = TERM_S) -> int:
    """Ends processes with SIGTERM, remaining ones with SIGKILL, and waits for their end; returns their number.

    Args:
        find: returns the ids of the running processes; processes that start meanwhile are also ended.
        term_s: wall time between the signals, seconds.
    """
    signalled: set[int] = set()
    deadline_s = time.monotonic() + term_s
    while running := find():
        now_s = time.monotonic()
        if now_s >= deadline_s + _KILLED_S:
            break
        for pid in running:
            if now_s >= deadline_s or pid not in signalled:
                _send(pid, signal.SIGKILL if now_s >= deadline_s else signal.SIGTERM)
        signalled.update(running)
        time.sleep(_PERIOD_S)
    return len(signalled)


def siblings(processes: Path = _PROCESSES) -> list[int]:
    """Returns the ids of the other children of this process's parent. ``processes``: the kernel's list, ``/proc``."""
    return [pid for pid in _all(processes) if pid != os.getpid() and _parent(pid, processes) == os.getppid()]


def any_runs(process_ids: Iterable[int], processes: Path = _PROCESSES) -> bool:
    """Returns whether a thread of any of these processes currently runs, is runnable or waits for a disk."""
    for process_id in process_ids:
        for stat in (processes / str(process_id) / "task").glob("*/stat"):
            try:
                if stat.read_text().rpartition(")")[2].split()[0] in "RD":
                    return True
            except OSError:  # it has ended
                continue
    return False


class Janitor:
    """A process that ends all processes with a mark and removes a folder when this process closes it or ends for any reason."""

    def __init__(self, mark: str, folder: Path) -> None:
        """``mark``: see ``with_mark``; ``folder``: removed at the end."""
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, mark, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def close(self) -> None:
        """Waits until all processes with the mark have ended; a second call does nothing."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        if not self._process.stdout.closed:
            self._process.stdout.read()  # ends when the last process that holds it ends
            self._process.stdout.close()
        self._process.wait()


def _all(processes: Path = _PROCESSES) -> list[int]:
    return [int(entry.name) for entry in os.scandir(processes) if entry.name.isdigit()]


def _marks(pid: int, variable: str) -> list[str]:
    try:
        environment = (_PROCESSES / str(pid) / "environ").read_bytes()
    except OSError:  # it has ended, or is another user's
        return []
    prefix = f"{variable}=".encode()
    value = next((entry for entry in environment.split(b"\0") if entry.startswith(prefix)), b"")
    return os.fsdecode(value[len(prefix) :]).split(":")


def _parent(pid: int, processes: Path = _PROCESSES) -> int:
    """Returns the id of a process's parent; -1 = it has ended."""
    try:
        state, parent = (processes / str(pid) / "stat").read_text(errors="replace").rpartition(")")[2].split()[:2]
    except OSError:
        return -1
    return -1 if state in "ZX" else int(parent)


def _send(pid: int, number: signal.Signals) -> None:
    try:
        os.kill(pid, number)
    except OSError:  # it has ended
        return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.fork():  # detach from the caller: Ray ends the children of a worker with it
        os._exit(0)
    sys.stdin.buffer.read()
    end_marked(sys.argv[1])
    shutil.rmtree(sys.argv[2], ignore_errors=True)
