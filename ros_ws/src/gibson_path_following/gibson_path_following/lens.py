"""How long the lens of a follower's camera is against the one that recorded the path: what zoom views fit best with, learned on the way.

A longer lens shows all things nearer, as if the robot were further along the path; by some nodes, where the next wall is far.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
_STEP = 0.04
"""Distance between the logarithms of two zooms that are compared."""
_PRIOR = 3.0
"""What a zoom must explain better, in score, for each squared logarithm of it: lenses are mostly alike. After one view; less with more."""
_ENOUGH = 60.0
"""Views along the way after which nothing more is learned."""


class ZoomEstimate:
    """Mean scores of views by zoom."""

    LOGARITHMS: F64 = _STEP * np.arange(-3.0, 4.0)
    """Of the zooms that are compared."""

    def __init__(self) -> None:
        self._sums: F64 = np.zeros(len(self.LOGARITHMS))
        self._weight = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether more views would change little."""
        return self._weight >= _ENOUGH

    @property
    def zoom(self) -> float:
        """Focal length of the lens, as a multiple of that of the recording."""
        if self._weight <= 0.0:
            return 1.0
        means = self._sums / self._weight - _PRIOR * self.LOGARITHMS**2 / math.sqrt(max(1.0, self._weight))
        at = min(max(int(means.argmax()), 1), len(means) - 2)
        left, middle, right = (float(means[at + k]) for k in (-1, 0, 1))
        bend = left - 2.0 * middle + right
        offset = min(max(0.5 * (left - right) / bend, -1.0), 1.0) if bend < -1e-9 else 0.0
        return math.exp(float(self.LOGARITHMS[at]) + offset * _STEP)

    def add(self, scores: F64, weight: float) -> None:
        """Takes the best score of a view, near where it was taken, with each zoom.

        Args:
            scores: (zooms,).
            weight: 0 to 1; views of one place are worth little.
        """
        self._sums = self._sums + weight * scores
        self._weight += weight
