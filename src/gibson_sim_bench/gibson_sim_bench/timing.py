"""Common parts of all measurements: percentiles of rates, and facts about the machine."""

from __future__ import annotations

import math
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from gibson_sim import __version__
from gibson_sim.processes.processor import processors
from gibson_sim.types import OUTPUTS, Output

FIVE: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal")
"""The outputs of the paper's robot."""
assert set(FIVE) <= set(OUTPUTS)


@dataclass(frozen=True, slots=True)
class Rates:
    """Rates of repeated work, 1/s."""

    median: float
    p5: float
    """5th percentile: one in twenty was slower."""
    p95: float


@dataclass(frozen=True, slots=True)
class Facts:
    """The machine, its load, and the versions of the software."""

    date: str
    version: str
    """Version of Gibson Sim, with the commit."""
    machine: str
    cores: int
    load: float
    """Load average over the last minute before the measurement."""
    python: str
    gpu: str = ""
    """Name of the GPU, or of the software renderer; empty = nothing was rendered."""
    driver: str = ""
    """Versions of OpenGL and of the driver."""

    @property
    def text(self) -> str:
        """The facts in one line."""
        renderer = f"{self.gpu}, OpenGL {self.driver}; " if self.gpu else ""
        return (
            f"{self.machine}; {self.cores} cores usable, load {self.load:g}; {renderer}Python {self.python}; "
            f"Gibson Sim {self.version}; {self.date[:10]}"
        )


def facts(gpu: str = "", driver: str = "") -> Facts:
    """Returns the facts at the time of the call."""
    return Facts(now(), version(), machine(), cores(), load(), platform.python_version(), gpu, driver)


def rates_of(seconds: Sequence[float]) -> Rates:
    """Returns the rates of durations in seconds; zeros without any."""
    return Rates(0.0, 0.0, 0.0) if len(seconds) == 0 else spread([1.0 / s for s in seconds])


def spread(rates: Sequence[float]) -> Rates:
    """Returns median, 5th and 95th percentile."""
    low, middle, high = (float(np.percentile(rates, p)) for p in (5, 50, 95))
    return Rates(middle, low, high)


def ratio(a: float, b: float) -> float:
    """Returns a / b; NaN if b is 0."""
    return a / b if b else math.nan


def now() -> str:
    """Returns the present date and time in UTC, ISO 8601."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def machine() -> str:
    """Returns architecture, processor and system."""
    return f"{platform.machine()}, {processors() or 'unknown CPU'}, {platform.system()}"


def cores() -> int:
    """Returns the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def load() -> float:
    """Returns the load average over the last minute."""
    return round(os.getloadavg()[0], 2)


def version() -> str:
    """Returns the version; in a checkout with the commit, and ``+`` if tracked files are modified."""
    here = Path(__file__).resolve().parent
    if not _git(here, "ls-files", "__init__.py"):
        return __version__
    commit = _git(here, "rev-parse", "--short=12", "HEAD")
    return f"{__version__} ({commit}{'+' if _git(here, 'status', '--porcelain', '--untracked-files=no') else ''})"


def _git(folder: Path, *arguments: str) -> str:
    """Returns the output of git; empty if it fails."""
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def process_cpu_s(pid: int | None) -> float:
    """Returns the processor time of a process, user and system, seconds."""
    with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
        # User and system time are the 12th and 13th fields after the name, which may itself contain spaces and brackets.
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
