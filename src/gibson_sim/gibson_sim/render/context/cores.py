"""Pins each thread of Mesa's software renderer to a core of its own.

It has as many threads as there are cores, and wakes all of them for each picture. Linux may put two of them on one core beside an idle
one and leave them there for milliseconds, which is as long as a picture takes.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

_TASKS = Path("/proc/self/task")
_NAME = re.compile(r"llvmpipe-(\d+)")


def spread_threads() -> dict[int, int]:
    """Pins the threads and returns the core of each by thread id, or nothing if placement is left to the scheduler.

    It is if there are fewer threads than cores that this process may use (``LP_NUM_THREADS``): which cores other processes use is not known.
    """
    cores, threads = sorted(os.sched_getaffinity(0)), drawing_threads()
    if len(cores) < 2 or len(set(threads.values())) < len(cores):
        return {}
    placed = {thread: cores[number % len(cores)] for thread, number in threads.items()}
    for thread, core in placed.items():
        try:
            os.sched_setaffinity(thread, {core})
        except OSError:  # it has just ended, or must not be moved
            continue
    return placed


def drawing_threads() -> dict[int, int]:
    """Returns the numbers of the renderer's threads in this process, by thread id."""
    found = {}
    for task in _TASKS.iterdir() if _TASKS.is_dir() else ():
        try:
            name = _NAME.fullmatch((task / "comm").read_text().strip())
        except OSError:
            continue
        if name:
            found[int(task.name)] = int(name[1])
    return found
