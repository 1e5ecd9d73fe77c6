"""Pacing of simulation time: pure arithmetic on whole nanoseconds of a monotonic clock."""

from __future__ import annotations

from gibson_sim.types import NS_PER_S


class Pacer:
    """Computes the number of ticks that are due, so that simulation time passes at ``rate`` times wall time.

    A simulation that cannot keep up does not catch up later: lag beyond ``max_lag_ns`` is dropped and counted in ``lost_ns``.
    """

    def __init__(self, tick_hz: int, rate: float, *, max_lag_ns: int = NS_PER_S // 4, burst: int = 1) -> None:
        """Creates a stopped pacer; with ``rate`` 0, as fast as possible, ``burst`` ticks are always due."""
        self._tick_hz, self._rate, self._max_lag_ns, self._burst = tick_hz, rate, max_lag_ns, burst
        self._start_ns: int | None = None
        self._ticks = 0
        self.lost_ns = 0
        """Wall time dropped so far, ns."""

    def restart(self) -> None:
        """Restarts the clock at the next call of ``due``, after time stood still or jumped."""
        self._start_ns, self._ticks = None, 0

    def set_rate(self, rate: float) -> None:
        """Sets the rate; 0 = as fast as possible."""
        self._rate = rate
        self.restart()

    def return_unused(self, ticks: int) -> None:
        """Returns ticks that were due and not executed, so that they are due again."""
        self._ticks -= ticks

    def due(self, now_ns: int) -> int:
        """Returns the number of ticks to execute now; the first call starts the clock. The caller executes all, or returns the rest."""
        if self._rate == 0.0:
            return self._burst
        if self._start_ns is None:
            self._start_ns = now_ns
        behind_ns = now_ns - self._start_ns - self._ticks * NS_PER_S / (self._tick_hz * self._rate)
        if behind_ns > self._max_lag_ns:
            lost = int(behind_ns - self._max_lag_ns)
            self._start_ns += lost
            self.lost_ns += lost
            behind_ns = self._max_lag_ns
        ticks = max(0, int(behind_ns * self._tick_hz * self._rate / NS_PER_S))
        self._ticks += ticks
        return ticks
