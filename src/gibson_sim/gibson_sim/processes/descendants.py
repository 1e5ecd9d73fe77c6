"""Processes that a program started, wherever they went: found by a variable that each inherits, since sessions and parents change; and ended.

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
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

VARIABLE = "GIBSON_SIM_JOBS"
"""Environment variable of all that workers start: the marks of a worker, outermost first, with colons between."""
TERM_S = 3.0
"""Wall time between SIGTERM and SIGKILL, seconds."""
_KILLED_S = 10.0
"""Wall time that a process has to end after SIGKILL, seconds: one that waits for a broken disk does not."""
_PERIOD_S = 0.02
_PROCESSES = Path("/proc")


def with_mark(environment: Mapping[str, str], mark: str) -> dict[str, str]:
    """Returns an environment with one more mark."""
    before = environment.get(VARIABLE, "")
    return {**environment, VARIABLE: f"{before}:{mark}" if before else mark}


def marked(mark: str, variable: str = VARIABLE) -> list[int]:
    """Returns the ids of all processes with a mark, except this one. Another user's processes are not seen.

    Args:
        mark: one of those in the variable, with which they were started.
        variable: name of the environment variable.
    """
    return sorted(pid for pid in _all() if pid != os.getpid() and mark in _marks(pid, variable))


def end_marked(mark: str, variable: str = VARIABLE, term_s: float = TERM_S) -> int:
    """Ends all processes with a mark, see ``end_all``; returns how many there were."""
    return end_all(lambda: marked(mark, variable), term_s)


def below(pid: int, without: Iterable[int] = ()) -> list[int]:
    """Returns the ids of all processes below a process, without those in ``without`` and below them."""
    children: dict[int, list[int]] = {}
    for one in _all():
        children.setdefault(_parent(one), []).append(one)
    found, left, spared = [], [pid], set(without)
    while left:
        own = [child for child in children.get(left.pop(), ()) if child not in spared]
        found += own
        left += own
    return sorted(found)


def end_all(find: Callable[[], list[int]], term_s: float = TERM_S) -> int:
    """Ends processes by SIGTERM, those that stay by SIGKILL, and waits for their end; returns how many there were.

    Args:
        find: returns the ids of those that are there; those that come meanwhile are ended, too.
        term_s: wall time between the signals, seconds.
    """
    asked: set[int] = set()
    deadline_s = time.monotonic() + term_s
    while there := find():
        now_s = time.monotonic()
        if now_s >= deadline_s + _KILLED_S:
            break
        for pid in there:
            if now_s >= deadline_s or pid not in asked:
                _send(pid, signal.SIGKILL if now_s >= deadline_s else signal.SIGTERM)
        asked.update(there)
        time.sleep(_PERIOD_S)
    return len(asked)


def siblings(processes: Path = _PROCESSES) -> list[int]:
    """Returns the ids of the other processes that this one's parent started. ``processes``: where the kernel lists them."""
    return [pid for pid in _all(processes) if pid != os.getpid() and _parent(pid, processes) == os.getppid()]


def any_runs(process_ids: Iterable[int], processes: Path = _PROCESSES) -> bool:
    """Returns whether a thread of any of these processes runs, waits for a processor, or for a disk, at this moment."""
    for process_id in process_ids:
        for stat in (processes / str(process_id) / "task").glob("*/stat"):
            try:
                if stat.read_text().rpartition(")")[2].split()[0] in "RD":
                    return True
            except OSError:  # it has ended
                continue
    return False


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
    if os.fork():  # no child of the caller: Ray ends the children of a worker with it
        os._exit(0)
    sys.stdin.buffer.read()
    end_marked(sys.argv[1])
    shutil.rmtree(sys.argv[2], ignore_errors=True)
