"""The real-time factor that a page shows, averaged over seconds for a steady display. Pure."""

from __future__ import annotations

from collections import deque

SPAN_S = 2.5
"""Averaging window, s of wall time."""


class RealTimeFactor:
    """Averages simulation time over wall time."""

    def __init__(self) -> None:
        self._times: deque[tuple[float, float]] = deque()
        """Pairs of wall time and simulation time, s, oldest first."""

    def add(self, wall_s: float, time_s: float) -> float | None:
        """Returns the factor over the last ``SPAN_S``; None = this is the first sample. A jump back, as by a reset, restarts the average."""
        times = self._times
        if times and time_s < times[-1][1]:
            times.clear()
        times.append((wall_s, time_s))
        # The oldest sample is at the start of the window, or just before it.
        while len(times) > 2 and times[1][0] <= wall_s - SPAN_S:
            times.popleft()
        elapsed_s = wall_s - times[0][0]
        return (time_s - times[0][1]) / elapsed_s if elapsed_s > 0 else None

    def clear(self) -> None:
        """Discards all samples."""
        self._times.clear()
