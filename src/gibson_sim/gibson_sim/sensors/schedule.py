"""When a sensor is due: a pure function of whole ticks, so that all runs and all processes agree."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

from gibson_sim.types import NS_PER_S

_PARTS = 1_000_000
"""Tolerance, as parts of the time between images. Stamps are truncated to nanoseconds: a tick at 1/60 s is stamped early by less than one part."""


@lru_cache
def _ratio(rate_hz: float, tick_hz: int) -> tuple[int, int]:
    ratio = Fraction(rate_hz).limit_denominator(1000) / tick_hz
    return ratio.numerator, ratio.denominator


def is_due(tick: int, rate_hz: float, tick_hz: int) -> bool:
    """Returns whether a sensor of ``rate_hz`` measures at ``tick``, where ticks pass at ``tick_hz`` in simulation time.

    It is due whenever ``tick * rate_hz / tick_hz`` reaches a new whole number: evenly where the rate divides ``tick_hz``, else
    at the nearest later tick, so that the mean rate holds. Rates above ``tick_hz`` are due at every tick. Tick 0 is never due.
    """
    up, down = _ratio(rate_hz, tick_hz)
    return tick > 0 and tick * up // down > (tick - 1) * up // down


def images_due(after_ns: int, until_ns: int, rate_hz: float) -> int:
    """Returns how often a sensor of ``rate_hz`` was due after ``after_ns`` and up to ``until_ns``."""
    up, down = _ratio(rate_hz, NS_PER_S)
    return (until_ns * up * _PARTS + down) // (down * _PARTS) - (after_ns * up * _PARTS + down) // (down * _PARTS)
