"""The schedule of sensors: a pure function of integer ticks, so that all runs and all processes agree."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

from gibson_sim.types import NS_PER_S

_PARTS = 1_000_000
"""Resolution of the comparison of times, parts of a period. Stamps are truncated to nanoseconds: at 1/60 s they are early by less than one
part."""


@lru_cache
def _ratio(rate_hz: float, tick_hz: int) -> tuple[int, int]:
    ratio = Fraction(rate_hz).limit_denominator(1000) / tick_hz
    return ratio.numerator, ratio.denominator


def is_due(tick: int, rate_hz: float, tick_hz: int) -> bool:
    """Returns whether a sensor with ``rate_hz`` measures at ``tick``, at ``tick_hz`` ticks per second of simulation time.

    It is due whenever ``tick * rate_hz / tick_hz`` reaches a new integer: evenly if the rate divides ``tick_hz``, else at the next tick, so
    that the mean rate is exact. Rates above ``tick_hz`` are due at every tick. Tick 0 is never due.
    """
    up, down = _ratio(rate_hz, tick_hz)
    return tick > 0 and tick * up // down > (tick - 1) * up // down


def images_due(after_ns: int, until_ns: int, rate_hz: float) -> int:
    """Returns the number of times a sensor with ``rate_hz`` was due after ``after_ns`` and up to ``until_ns``."""
    up, down = _ratio(rate_hz, NS_PER_S)
    return (until_ns * up * _PARTS + down) // (down * _PARTS) - (after_ns * up * _PARTS + down) // (down * _PARTS)
