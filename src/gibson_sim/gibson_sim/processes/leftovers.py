"""Processes of a job: those that a program started, found by a variable in their environment wherever they went, and whether any works."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path

_PATIENCE_S = 2.0
"""Wall time that a process has to end after SIGTERM, seconds."""


def find_marked(variable: str, value: str, processes: Path = Path("/proc")) -> list[int]:
    """Returns the ids of this user's processes, without this one, that were started with a variable of this value.

    Args:
        variable: name of the variable.
        value: its value.
        processes: where the kernel lists them.
    """
    wanted, found = f"{variable}={value}".encode(), []
    for folder in processes.glob("[0-9]*"):
        try:
            if folder.stat().st_uid == os.getuid() and wanted in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
        except OSError:  # it has ended, or may not be read
            continue
    return sorted(pid for pid in found if pid != os.getpid())


def end_marked(variable: str, value: str) -> int:
    """Ends these processes by SIGTERM, those that stay by SIGKILL, and waits for their end; returns how many there were."""
    first = found = find_marked(variable, value)
    for number in (signal.SIGTERM, signal.SIGKILL):
        for process_id in found:
            try:
                os.kill(process_id, number)
            except ProcessLookupError:
                continue
        deadline = time.monotonic() + _PATIENCE_S
        while found and time.monotonic() < deadline:
            time.sleep(0.02)
            found = find_marked(variable, value)
        if not found:
            break
    return len(first)


def find_siblings(processes: Path = Path("/proc")) -> list[int]:
    """Returns the ids of the other processes that this one's parent started. ``processes``: where the kernel lists them."""
    parent, found = str(os.getppid()), []
    for folder in processes.glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if fields[1] == parent and int(folder.name) != os.getpid():
            found.append(int(folder.name))
    return found


def any_runs(process_ids: Iterable[int], processes: Path = Path("/proc")) -> bool:
    """Returns whether a thread of any of these processes runs, waits for a processor, or for a disk, at this moment."""
    for process_id in process_ids:
        for stat in (processes / str(process_id) / "task").glob("*/stat"):
            try:
                if stat.read_text().rpartition(")")[2].split()[0] in "RD":
                    return True
            except OSError:  # it has ended
                continue
    return False
