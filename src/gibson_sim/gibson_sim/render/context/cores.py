"""Pins each thread of Mesa's software renderer to a separate core.

Mesa starts one thread per core and wakes all of them for each image. Linux may schedule two of them on one core while another core is
idle, and keep them there for milliseconds, which is the time of an image.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

_TASKS = Path("/proc/self/task")
_NAME = re.compile(r"llvmpipe-(\d+)")


def spread_threads() -> dict[int, int]:
    """Pins the threads to cores and returns the core of each by thread id.

    Pins nothing and returns an empty dict if this process may use more cores than there are threads (``LP_NUM_THREADS``), since other
    processes may use some of these cores.
    """
    cores, threads = sorted(os.sched_getaffinity(0)), drawing_threads()
    if len(cores) < 2 or len(set(threads.values())) < len(cores):
        return {}
    core_of = {thread: cores[number % len(cores)] for thread, number in threads.items()}
    for thread, core in core_of.items():
        try:
            os.sched_setaffinity(thread, {core})
        except OSError:  # the thread has just ended, or its affinity must not be changed
            continue
    return core_of


def drawing_threads() -> dict[int, int]:
    """Returns the numbers of the renderer's threads in this process, by thread id."""
    threads = {}
    for task in _TASKS.iterdir() if _TASKS.is_dir() else ():
        try:
            name = _NAME.fullmatch((task / "comm").read_text().strip())
        except OSError:
            continue
        if name:
            threads[int(task.name)] = int(name[1])
    return threads
