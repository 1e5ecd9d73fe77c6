"""Processes that a program left behind, found by a variable in their environment: they may have left its session and its parents."""

from __future__ import annotations

import os
import signal
import time
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
