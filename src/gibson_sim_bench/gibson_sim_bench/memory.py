"""Memory, open files and files on disk of processes, and their growth over time."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

WARM_UP = 0.25
"""Fraction of a run that is warm-up and does not count: caches fill, and Python keeps freed memory."""


def resident_mb(pid: int | str = "self") -> float:
    """Returns the resident memory of a process, MB; NaN if it has ended."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return math.nan
    return next((int(line.split()[1]) / 1024 for line in text.splitlines() if line.startswith("VmRSS")), math.nan)


def open_files(pid: int | str = "self") -> int:
    """Returns the number of open files of a process; 0 if it has ended."""
    try:
        return len(os.listdir(f"/proc/{pid}/fd"))
    except OSError:
        return 0


def descendants(pid: int) -> dict[int, str]:
    """Returns the descendants of a process: process id -> module or file that the process runs."""
    children: dict[int, list[int]] = {}
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                fields = Path(f"/proc/{entry}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
            except OSError:
                continue
            children.setdefault(int(fields[1]), []).append(int(entry))
    found, pending = {}, [pid]
    while pending:
        for child in children.get(pending.pop(), []):
            found[child] = command_name(child)
            pending.append(child)
    return found


def command_name(pid: int) -> str:
    """Returns the module or the file that a Python process runs; empty if it has ended."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return ""
    if "-m" in words:
        return words[words.index("-m") + 1].rpartition(".")[2]
    return Path(words[1] if len(words) > 1 and words[1] else words[0]).name


def files_below(folders: Iterable[Path]) -> int:
    """Returns the number of files in folders and below."""
    return sum(len(names) for folder in folders for _, _, names in os.walk(folder))


def growth(values: Sequence[float]) -> float:
    """Returns the mean of the last third minus that of the first third, after the warm-up; NaN = too few values."""
    counted = np.asarray(values, dtype=np.float64)[int(len(values) * WARM_UP) :]
    third = len(counted) // 3
    return float(counted[-third:].mean() - counted[:third].mean()) if third else math.nan


def drift(values: Sequence[float]) -> float:
    """Returns the median of the last third divided by that of the first third, after the warm-up; NaN = too few values."""
    counted = np.asarray(values, dtype=np.float64)[int(len(values) * WARM_UP) :]
    third = len(counted) // 3
    return float(np.median(counted[-third:]) / np.median(counted[:third])) if third else math.nan
