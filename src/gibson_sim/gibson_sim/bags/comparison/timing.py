"""Rates, gaps, jitter and latencies of topics. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim.bags.comparison.recorded_drive import Arrivals
from gibson_sim.bags.stamps import nominal_period_ns
from gibson_sim.types import NS_PER_S

SAME_CLOCK_S = 5.0
"""Difference of log times and stamps from which on they are of different clocks, seconds."""


@dataclass(frozen=True, slots=True)
class TopicTiming:
    """Timing of one topic."""

    count: int
    rate_hz: float
    """Message rate by the nominal period, Hz; 0 = fewer than two messages."""
    jitter_ms: float
    """Standard deviation of the intervals between messages, without gaps; computed from the stamps if the type has one."""
    missing: int
    """Number of missing messages by the nominal period."""
    latency_ms: float
    """Median of log time minus stamp; NaN = no stamps, or stamps of another clock."""
    latency_99_ms: float
    """99th percentile of log time minus stamp; NaN as for the median."""
    same_clock: bool
    """Whether log times and stamps are of one clock, so that their difference is a latency."""

    @property
    def missing_part(self) -> float:
        """Missing messages as a part of all expected ones."""
        return self.missing / max(self.count + self.missing, 1)


def topic_timing(arrivals: Arrivals) -> TopicTiming:
    """Returns the timing of a topic; rates are those of the stamps if there are any."""
    stamps = np.sort(arrivals.log_ns if arrivals.stamp_ns is None else arrivals.stamp_ns)
    period = nominal_period_ns(stamps)
    steps = np.diff(stamps).astype(np.float64)
    if period <= 0.0:
        return TopicTiming(len(stamps), 0.0, 0.0, 0, float("nan"), float("nan"), False)
    missing = int(np.maximum(np.rint(steps / period) - 1.0, 0.0).sum())
    regular = steps[steps < 1.6 * period]
    latency = latency_99 = float("nan")
    same_clock = False
    if arrivals.stamp_ns is not None:
        late = (arrivals.log_ns - arrivals.stamp_ns) / NS_PER_S
        same_clock = bool(abs(np.median(late)) < SAME_CLOCK_S)
        if same_clock:
            latency, latency_99 = (1e3 * float(np.percentile(late, part)) for part in (50, 99))
    # Stamps are rounded to nanoseconds: less than a microsecond is not jitter.
    jitter = round(1e-6 * float(regular.std()), 3) if len(regular) else 0.0
    return TopicTiming(len(stamps), NS_PER_S / period, jitter, missing, latency, latency_99, same_clock)
