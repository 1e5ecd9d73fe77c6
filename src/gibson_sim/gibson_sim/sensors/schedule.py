"""When a sensor is due: a pure function of whole ticks, so that every run and every process agrees."""

from __future__ import annotations

import math
from fractions import Fraction


def is_due(tick: int, rate_hz: float, tick_hz: int) -> bool:
    """Returns whether a sensor of ``rate_hz`` measures at ``tick``, where ticks pass at ``tick_hz`` in simulation time.

    It is due whenever ``tick * rate_hz / tick_hz`` reaches a new whole number: evenly where the rate divides ``tick_hz``, else
    at the nearest later tick, so that the mean rate holds. Rates above ``tick_hz`` are due at every tick. Tick 0 is never due.
    """
    ratio = Fraction(rate_hz).limit_denominator(1000) / tick_hz
    return tick > 0 and math.floor(tick * ratio) > math.floor((tick - 1) * ratio)
