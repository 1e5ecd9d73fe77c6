"""Values over time for the plots of a page: bounded in rate and in length, without losing peaks. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

BUCKET_S = 0.1
"""Of the values within this time the least and the greatest are kept, s."""
SPAN_S = 60.0
"""Time that a plot shows, s."""

CurveName = tuple[str, str]
"""Topic and field, ``("/odom", "twist.twist.linear.x")``."""
Sample = tuple[float, float | None]
"""Time in seconds, and a value; None = it is not finite, and the line is broken there."""


@dataclass(slots=True)
class Curve:
    """The values of one field, in pairs of the least and the greatest of each tenth of a second."""

    _open: list[tuple[float, float]] = field(default_factory=list)
    _bucket: int = 0
    _new: list[Sample] = field(default_factory=list)
    _kept: deque[Sample] = field(default_factory=lambda: deque(maxlen=round(2 * SPAN_S / BUCKET_S)))

    def add(self, time_s: float, value: float) -> None:
        """Adds a value; times must not decrease."""
        bucket = math.floor(time_s / BUCKET_S)
        if bucket != self._bucket:
            self._close()
            self._bucket = bucket
        self._open.append((time_s, value))
        if len(self._open) > 3:
            self._open = _extremes(self._open)

    def pop_new(self, time_s: float) -> list[Sample]:
        """Returns what came since the last call, up to the bucket of ``time_s``, which is still open."""
        if math.floor(time_s / BUCKET_S) != self._bucket:
            self._close()
        new, self._new = self._new, []
        return new

    @property
    def history(self) -> list[Sample]:
        """The last minute."""
        return [sample for sample in self._kept if sample[0] > self._kept[-1][0] - SPAN_S]

    def _close(self) -> None:
        closed = [(round(t, 3), value if math.isfinite(value) else None) for t, value in _extremes(self._open)]
        self._open = []
        self._new += closed
        self._kept += closed


def _extremes(samples: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the least and the greatest of some samples in the order of time; one that is not finite, if there is any, breaks the line."""
    finite = [sample for sample in samples if math.isfinite(sample[1])]
    broken = next((sample for sample in samples if not math.isfinite(sample[1])), None)
    if not finite:
        return [] if broken is None else [broken]
    found = {min(finite, key=lambda s: s[1]), max(finite, key=lambda s: s[1])}
    return sorted(found | ({broken} if broken is not None else set()))


class Curves:
    """The curves that any page plots."""

    def __init__(self) -> None:
        self._curves: dict[CurveName, Curve] = {}

    @property
    def names(self) -> frozenset[CurveName]:
        """All curves."""
        return frozenset(self._curves)

    def update(self, names: Iterable[CurveName]) -> None:
        """Has exactly these curves; those that stay keep their last minute."""
        self._curves = {name: self._curves.get(name) or Curve() for name in names}

    def add(self, name: CurveName, time_s: float, value: float) -> None:
        """Adds a value to a curve, if there is one of this name."""
        if name in self._curves:
            self._curves[name].add(time_s, value)

    def pop_new(self, time_s: float) -> dict[CurveName, list[Sample]]:
        """Returns what came since the last call; curves without news are missing."""
        return {name: new for name, curve in self._curves.items() if (new := curve.pop_new(time_s))}

    def history(self, names: Iterable[CurveName]) -> dict[CurveName, list[Sample]]:
        """Returns the last minute of some curves."""
        return {name: self._curves[name].history for name in names if name in self._curves}
