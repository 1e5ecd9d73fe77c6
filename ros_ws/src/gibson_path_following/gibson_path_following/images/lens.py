"""Learns the zoom of a follower's camera: its focal length relative to that of the camera that recorded the path.

A longer lens enlarges the image, as if the robot were further along the path; by some nodes, where the next wall is far.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
_STEP = 0.04
"""Distance between the logarithms of two candidate zooms."""
_PRIOR = 3.0
"""Prior penalty of a zoom after one view, in score per squared logarithm: lenses are mostly alike. It falls with the root of the views."""
_SETTLED = 60.0
"""Sum of weights from which on nothing more is learned."""


class ZoomEstimate:
    """Mean scores of views at candidate zooms."""

    LOG_ZOOMS: F64 = _STEP * np.arange(-3.0, 4.0)
    """(zooms,), float64: natural logarithms of the candidate zooms."""

    def __init__(self) -> None:
        self._sums: F64 = np.zeros(len(self.LOG_ZOOMS))
        """(zooms,), weighted sums of scores."""
        self._weight = 0.0
        """Sum of weights."""

    @property
    def is_settled(self) -> bool:
        """Whether more views would change little."""
        return self._weight >= _SETTLED

    @property
    def zoom(self) -> float:
        """Focal length relative to that of the recording: at the vertex of the parabola through the best score."""
        if self._weight <= 0.0:
            return 1.0
        means = self._sums / self._weight - _PRIOR * self.LOG_ZOOMS**2 / math.sqrt(max(1.0, self._weight))
        at = min(max(int(means.argmax()), 1), len(means) - 2)
        left, middle, right = (float(means[at + k]) for k in (-1, 0, 1))
        bend = left - 2.0 * middle + right
        offset = min(max(0.5 * (left - right) / bend, -1.0), 1.0) if bend < -1e-9 else 0.0
        return math.exp(float(self.LOG_ZOOMS[at]) + offset * _STEP)

    def add(self, scores: F64, weight: float) -> None:
        """Adds a view.

        Args:
            scores: (zooms,), float64, best score of the view against the nodes near by, at each of ``LOG_ZOOMS``.
            weight: weight of the view, 0 to 1; views of one place say little more than one.
        """
        self._sums = self._sums + weight * scores
        self._weight += weight
