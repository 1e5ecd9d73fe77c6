"""Time series for the plots of a page: bounded in rate and length, without losing peaks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

BUCKET_S = 0.1
"""Length of a bucket, s; of the values in a bucket, the minimum and the maximum are kept."""
SPAN_S = 60.0
"""Time span of a plot, s."""

CurveName = tuple[str, str]
"""Topic and field, ``("/odom", "twist.twist.linear.x")``."""
Sample = tuple[float, float | None]
"""Time in seconds and value; None = not finite, the line is interrupted."""


@dataclass(slots=True)
class Curve:
    """The values of one field, reduced to the minimum and maximum of each bucket."""

    _open: list[tuple[float, float]] = field(default_factory=list)
    _bucket: int = 0
    _new: list[Sample] = field(default_factory=list)
    _kept: deque[Sample] = field(default_factory=lambda: deque(maxlen=round(2 * SPAN_S / BUCKET_S)))

    def add(self, time_s: float, value: float) -> None:
        """Adds a value at a time, s; times must not decrease."""
        bucket = math.floor(time_s / BUCKET_S)
        if bucket != self._bucket:
            self._close()
            self._bucket = bucket
        self._open.append((time_s, value))
        if len(self._open) > 3:
            self._open = _extremes(self._open)

    def pop_new(self, time_s: float) -> list[Sample]:
        """Returns the samples since the last call, up to the bucket of ``time_s``, which is still open."""
        if math.floor(time_s / BUCKET_S) != self._bucket:
            self._close()
        new, self._new = self._new, []
        return new

    @property
    def history(self) -> list[Sample]:
        """The samples of the last ``SPAN_S``."""
        return [sample for sample in self._kept if sample[0] > self._kept[-1][0] - SPAN_S]

    def _close(self) -> None:
        closed = [(round(t, 3), value if math.isfinite(value) else None) for t, value in _extremes(self._open)]
        self._open = []
        self._new += closed
        self._kept += closed


def _extremes(samples: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Returns the minimum and maximum of the samples in order of time, and the first non-finite sample, which interrupts the line."""
    finite = [sample for sample in samples if math.isfinite(sample[1])]
    interruption = next((sample for sample in samples if not math.isfinite(sample[1])), None)
    if not finite:
        return [] if interruption is None else [interruption]
    extremes = {min(finite, key=lambda s: s[1]), max(finite, key=lambda s: s[1])}
    return sorted(extremes | ({interruption} if interruption is not None else set()))


class Curves:
    """The curves plotted by any page."""

    def __init__(self) -> None:
        self._curves: dict[CurveName, Curve] = {}

    @property
    def names(self) -> frozenset[CurveName]:
        """Names of all curves."""
        return frozenset(self._curves)

    def update(self, names: Iterable[CurveName]) -> None:
        """Replaces the set of curves; retained curves keep their history."""
        self._curves = {name: self._curves.get(name) or Curve() for name in names}

    def add(self, name: CurveName, time_s: float, value: float) -> None:
        """Adds a value to a curve, if it exists."""
        if name in self._curves:
            self._curves[name].add(time_s, value)

    def pop_new(self, time_s: float) -> dict[CurveName, list[Sample]]:
        """Returns the samples since the last call; curves without new samples are omitted."""
        return {name: new for name, curve in self._curves.items() if (new := curve.pop_new(time_s))}

    def history(self, names: Iterable[CurveName]) -> dict[CurveName, list[Sample]]:
        """Returns the samples of the last ``SPAN_S`` of the given curves."""
        return {name: self._curves[name].history for name in names if name in self._curves}
