"""What all measurements share: percentiles of rates, and what a reader must know of the machine."""

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
from gibson_sim.types import OUTPUTS, Output

FIVE: tuple[Output, ...] = ("rgb", "depth", "semantic", "instance", "normal")
"""What a robot of the paper sees, in one call."""
assert set(FIVE) <= set(OUTPUTS)


@dataclass(frozen=True, slots=True)
class Rates:
    """How often something was done a second."""

    median: float
    p5: float
    """One in twenty was slower."""
    p95: float


@dataclass(frozen=True, slots=True)
class Facts:
    """What a reader must know of the machine, and of the state it was in."""

    date: str
    version: str
    """With the commit."""
    machine: str
    cores: int
    load: float
    """Average over the minute before."""
    python: str
    gpu: str = ""
    """Name of the GPU, or of the software that draws; empty = nothing was drawn."""
    driver: str = ""
    """OpenGL version with that of the driver."""

    @property
    def text(self) -> str:
        """All of it in one line."""
        drawn = f"{self.gpu}, OpenGL {self.driver}; " if self.gpu else ""
        return (
            f"{self.machine}; {self.cores} cores usable, load {self.load:g}; {drawn}Python {self.python}; "
            f"Gibson Sim {self.version}; {self.date[:10]}"
        )


def facts(gpu: str = "", driver: str = "") -> Facts:
    """Returns what is true now."""
    return Facts(now(), version(), machine(), cores(), load(), platform.python_version(), gpu, driver)


def rates_of(seconds: Sequence[float]) -> Rates:
    """Returns how often a second each took place, from how long each took; all zero where there is none."""
    return Rates(0.0, 0.0, 0.0) if len(seconds) == 0 else spread([1.0 / s for s in seconds])


def spread(rates: Sequence[float]) -> Rates:
    """Returns median, p5 and p95."""
    low, middle, high = (float(np.percentile(rates, p)) for p in (5, 50, 95))
    return Rates(middle, low, high)


def ratio(a: float, b: float) -> float:
    """Returns a / b; NaN where b is 0."""
    return a / b if b else math.nan


def now() -> str:
    """Returns date and time in UTC, ISO 8601."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def machine() -> str:
    """Returns architecture, processor and system."""
    return f"{platform.machine()}, {cpu()}, {platform.system()}"


def cpu() -> str:
    """Returns how many processors there are, and their name."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return f"{len(names)} x {names[0]}" if names else platform.processor() or "unknown CPU"


def cores() -> int:
    """Returns the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def load() -> float:
    """Returns how many processes wanted a processor, on average over the last minute: what else was going on."""
    return round(os.getloadavg()[0], 2)


def version() -> str:
    """Returns the version, with the commit where this is a checkout of it, and ``+`` where files differ from that commit."""
    here = Path(__file__).resolve().parents[1]
    if not _git(here, "ls-files", "__init__.py"):
        return __version__
    commit = _git(here, "rev-parse", "--short=12", "HEAD")
    return f"{__version__} ({commit}{'+' if _git(here, 'status', '--porcelain', '--untracked-files=no') else ''})"


def _git(folder: Path, *arguments: str) -> str:
    """Returns what git says; empty where it does not know."""
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
