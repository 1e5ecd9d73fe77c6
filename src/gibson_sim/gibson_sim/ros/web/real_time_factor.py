"""The real-time factor that a page shows: over seconds, since that of one look jumps. Pure."""

from __future__ import annotations

from collections import deque

SPAN_S = 2.5
"""Wall time over which it is averaged, s."""


class RealTimeFactor:
    """Simulation time over wall time."""

    def __init__(self) -> None:
        self._times: deque[tuple[float, float]] = deque()
        """(wall time, simulation time), s, oldest first."""

    def add(self, wall_s: float, time_s: float) -> float | None:
        """Returns the factor over the last seconds; None = this is the first time. A jump back, as by a reset, begins anew."""
        times = self._times
        if times and time_s < times[-1][1]:
            times.clear()
        times.append((wall_s, time_s))
        # The oldest one is at the beginning of the span, or just before it.
        while len(times) > 2 and times[1][0] <= wall_s - SPAN_S:
            times.popleft()
        passed_s = wall_s - times[0][0]
        return (time_s - times[0][1]) / passed_s if passed_s > 0 else None

    def clear(self) -> None:
        """Forgets all times."""
        self._times.clear()
