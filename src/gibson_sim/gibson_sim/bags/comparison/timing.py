"""Rates, gaps, jitter and latencies of topics. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim.bags.comparison.recording import Arrivals
from gibson_sim.bags.stamps import nominal_period_ns
from gibson_sim.types import NS_PER_S

SAME_CLOCK_S = 5.0
"""Log times and stamps that lie farther apart are taken to be of different clocks."""


@dataclass(frozen=True, slots=True)
class TopicTiming:
    """How regularly one topic came."""

    count: int
    rate_hz: float
    """From the usual step between messages; 0 = fewer than two."""
    jitter_ms: float
    """Standard deviation of the steps between messages, gaps left out, by the stamps where there are any."""
    missing: int
    """Messages that the rate asks for and that are not there."""
    latency_ms: float
    """Median of log time minus stamp; NaN = no stamps, or stamps of another clock."""
    latency_99_ms: float
    """99 of 100 are not later; NaN likewise."""
    same_clock: bool
    """Whether log times and stamps are of one clock, so that their difference means something."""

    @property
    def missing_part(self) -> float:
        """Missing messages as a part of all that there should be."""
        return self.missing / max(self.count + self.missing, 1)


def topic_timing(arrivals: Arrivals) -> TopicTiming:
    """Returns the timing of a topic; rates are those of the stamps, where there are any."""
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
    # Stamps are rounded to nanoseconds: less than a microsecond is nothing.
    jitter = round(1e-6 * float(regular.std()), 3) if len(regular) else 0.0
    return TopicTiming(len(stamps), NS_PER_S / period, jitter, missing, latency, latency_99, same_clock)
