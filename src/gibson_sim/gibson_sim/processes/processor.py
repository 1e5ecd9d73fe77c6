"""The processors of this machine, as reports and recordings name them."""

from __future__ import annotations

import platform
from pathlib import Path


def processor() -> str:
    """Returns the model of the processor, such as ``AMD EPYC 9B14``; without /proc/cpuinfo that of Python, which may be empty."""
    names = _models()
    return names[0] if names else platform.processor()


def processors() -> str:
    """Returns number and model of the processors, such as ``2 x AMD EPYC 9B14``; without /proc/cpuinfo the same as ``processor``."""
    names = _models()
    return f"{len(names)} x {names[0]}" if names else platform.processor()


def _models() -> list[str]:
    """Returns the model of each logical processor; empty if the system does not say."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    return [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
