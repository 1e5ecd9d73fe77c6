"""Processor time of a call in units of this machine, so that tests of slow algorithms need no limit in seconds."""

from __future__ import annotations

import time
from collections.abc import Callable

_ROUNDS = 3_000_000


def effort(call: Callable[[], object]) -> float:
    """Returns the processor time of a call, as a multiple of that of three million additions in Python, measured before and after it.

    Such additions take 0.2 to 0.4 s: a bound of 10 means a few seconds, where quadratic work on the same input takes minutes.
    """
    before, took, after = _cpu_s(_additions), _cpu_s(call), _cpu_s(_additions)
    return took / max(before, after)


def _additions() -> int:
    total = 0
    for k in range(_ROUNDS):
        total += k
    return total


def _cpu_s(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
