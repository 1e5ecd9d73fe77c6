"""Gives each drawing thread of Mesa's software renderer a core of its own.

It has as many threads as there are cores, and wakes all of them for each picture. Linux may put two on one core, beside one that has
nothing to do, and leave them there for milliseconds, which is as long as a picture takes.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

_TASKS = Path("/proc/self/task")
_NAME = re.compile(r"llvmpipe-(\d+)")


def spread_threads() -> dict[int, int]:
    """Returns the core of each thread, by its id; empty where they are left to the scheduler.

    That is so where there are fewer of them than cores that this process may use (``LP_NUM_THREADS``): the cores of others are not known.
    """
    cores, threads = sorted(os.sched_getaffinity(0)), drawing_threads()
    if len(cores) < 2 or len(set(threads.values())) < len(cores):
        return {}
    placed = {thread: cores[number % len(cores)] for thread, number in threads.items()}
    for thread, core in placed.items():
        try:
            os.sched_setaffinity(thread, {core})
        except OSError:  # it has just ended, or may not be moved
            continue
    return placed


def drawing_threads() -> dict[int, int]:
    """Returns the drawing threads of this process, by their ids, and which of them each is."""
    found = {}
    for task in _TASKS.iterdir() if _TASKS.is_dir() else ():
        try:
            name = _NAME.fullmatch((task / "comm").read_text().strip())
        except OSError:
            continue
        if name:
            found[int(task.name)] = int(name[1])
    return found
