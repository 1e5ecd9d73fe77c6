"""Views that show something else than the surface: a person who walked by, a highlight, another surface through a wrong pose.

Waechter et al. ("Let There Be Color!", ECCV 2014, section 3.2) find the mode of the colours of a triangle's views and drop views far from it.
The mode is found here from the median, which half of the views cannot move. What hides the surface covers many triangles of a photograph:
views are then judged with their neighbours in the same photograph, which also decides where a triangle has too few views of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gibson_sim_tools.texturing.quality import Views
from gibson_sim_tools.texturing.surface import Adjacency

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
_SPREADING = 12
"""Rounds in which neighbours in a photograph are heard: how many triangles far a judgement reaches."""


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


def judged_together(views: Views, kept: Bools, beside: Adjacency) -> Bools:
    """Returns which views (N,) show the surface, after each was judged with those of neighbouring triangles in the same photograph.

    Args:
        views: all views, sorted by triangle, then by photograph.
        kept: (N,), what ``inliers`` says of each.
        beside: neighbouring triangles.
    """
    if not len(views):
        return kept
    pairs = _beside_in_photographs(views, beside)
    counts = np.bincount(views.face)[views.face]
    own = np.where(counts < _LEAST_VIEWS, 0.5, np.where(kept, 0.0, 1.0))
    weight = (counts >= _LEAST_VIEWS).astype(np.float64)
    ones = np.ones(len(pairs))
    graph = sparse.csr_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(views),) * 2)
    graph = graph + graph.T
    total = np.maximum(weight + np.asarray(graph.sum(axis=1)).ravel(), 1.0)
    strange = own.copy()
    for _ in range(_SPREADING):
        strange = np.where(total > weight, (weight * own + graph @ strange) / total, own)
    out = strange <= 0.5
    # A triangle keeps its only view, and views of which none is left.
    left = np.bincount(views.face, out)
    return np.asarray(out | (left[views.face] == 0))


def _beside_in_photographs(views: Views, beside: Adjacency) -> I64:
    """Returns pairs (M, 2) of views of neighbouring triangles in one photograph."""
    span = int(views.photograph.max()) + 1
    keys = views.face.astype(np.int64) * span + views.photograph
    starts = np.searchsorted(views.face, np.arange(int(max(views.face.max(), beside.faces.max(initial=0))) + 2))
    a, b = beside.faces.T
    number = starts[a + 1] - starts[a]
    row = np.repeat(starts[a] - np.concatenate([[0], np.cumsum(number)[:-1]]), number) + np.arange(int(number.sum()))
    wanted = np.repeat(b, number) * span + views.photograph[row]
    found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    same = keys[found] == wanted
    return np.stack([row[same], found[same]], axis=1)


def _medians(values: F32, group: I64, starts: I64, counts: I64) -> F64:
    """Returns the median (G, C) of each column of values (N, C) in each group; the lower one of two."""
    out = np.empty((len(starts), values.shape[1]))
    at = starts + (counts - 1) // 2
    for k in range(values.shape[1]):
        out[:, k] = values[np.lexsort((values[:, k], group)), k][at]
    return out
