"""Views that show something else than the surface: a person who walked by, a highlight, another surface through a wrong pose.

Waechter et al. ("Let There Be Color!", ECCV 2014, section 3.2) find the mode of the colours of a triangle's views and drop views far from it.
The mode is found here from the median, which half of the views cannot move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.texturing.quality import Views

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_LEAST_SPREAD = 0.03
"""Standard deviation of colours that noise and exposure leave in any case, sRGB, 0 to 1."""
_FAR = 3.0
"""Distance from the mode above which a view is an outlier, standard deviations."""
_LEAST_VIEWS = 3
"""Triangles with fewer views keep all of them."""
_ROUNDS = 4


def inliers(views: Views, colors: F32) -> Bools:
    """Returns which views (N,) show the surface.

    Args:
        views: all views, sorted by triangle.
        colors: (N, 3), their mean colours after correction of the exposure, sRGB, 0 to 1.
    """
    if not len(views):
        return np.zeros(0, dtype=bool)
    starts = np.flatnonzero(np.diff(views.face, prepend=-1))
    counts = np.diff(starts, append=len(views))
    group = np.repeat(np.arange(len(starts)), counts)
    middle = _medians(colors, group, starts, counts)
    off = np.linalg.norm(colors - middle[group], axis=1)
    spread = np.maximum(1.4826 * _medians(off[:, None], group, starts, counts)[:, 0], _LEAST_SPREAD)
    kept = off <= _FAR * spread[group]
    for _ in range(_ROUNDS):
        number = np.maximum(np.bincount(group, kept, len(starts)), 1.0)
        middle = np.stack([np.bincount(group, kept * colors[:, k], len(starts)) / number for k in range(3)], axis=1)
        off = np.linalg.norm(colors - middle[group], axis=1)
        spread = np.maximum(np.sqrt(np.bincount(group, kept * off.astype(np.float64) ** 2, len(starts)) / number), _LEAST_SPREAD)
        kept = off <= _FAR * spread[group]
    return np.asarray(kept | (counts[group] < _LEAST_VIEWS))


def _medians(values: F32, group: I64, starts: I64, counts: I64) -> F64:
    """Returns the median (G, C) of each column of values (N, C) in each group; the lower one of two."""
    out = np.empty((len(starts), values.shape[1]))
    at = starts + (counts - 1) // 2
    for k in range(values.shape[1]):
        out[:, k] = values[np.lexsort((values[:, k], group)), k][at]
    return out
