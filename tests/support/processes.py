"""Whether processes have ended that are no children of the test."""

from __future__ import annotations

import os
import select
from collections.abc import Iterable
from pathlib import Path


def is_running(pid: int) -> bool:
    """Returns whether a process is neither gone nor a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def wait_for_end(pids: Iterable[int]) -> None:
    """Waits until processes have ended."""
    for pid in pids:
        try:
            descriptor = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        select.select([descriptor], [], [])
        os.close(descriptor)
