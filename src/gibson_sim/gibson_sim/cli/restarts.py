"""Whether a node that crashed is started again."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable


class Restarts:
    """Counts the restarts of a node by time: a fault that returns at once ends the run, one now and then does not."""

    def __init__(self, limit: int, window_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        """At most ``limit`` restarts within ``window_s`` seconds of ``now_s``, a clock that never goes back."""
        self._limit, self._window_s, self._now_s = limit, window_s, now_s
        self._recent: deque[float] = deque()
        self.total = 0
        """Restarts since the beginning."""

    def allow(self) -> bool:
        """Returns whether the node may start once more, and counts that it does."""
        now = self._now_s()
        while self._recent and now - self._recent[0] >= self._window_s:
            self._recent.popleft()
        if len(self._recent) >= self._limit:
            return False
        self._recent.append(now)
        self.total += 1
        return True
