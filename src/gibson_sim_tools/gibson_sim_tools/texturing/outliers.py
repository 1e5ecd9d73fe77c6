"""Photo-consistency check: detects outlier views, which show a passer-by, a highlight, or another surface because of a pose error.

Waechter et al. ("Let There Be Color!", ECCV 2014, section 3.2) find the mode of the colours of a triangle's views by mean shift and drop views far
from it. Here the iteration starts at the median, which is robust against up to half of the views. An occluder covers many triangles of a
photograph. Outlier scores are therefore diffused between neighbouring triangles of one photograph, which also decides triangles with few views.
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

_MIN_DEVIATION = 0.03
"""Least standard deviation of colours, sRGB, 0 to 1: noise and errors of the exposure compensation."""
_MAX_DEVIATIONS = 3.0
"""Largest distance of an inlier from the mode, standard deviations."""
_MIN_VIEWS = 3
"""Least number of views from which outliers are detected; triangles with fewer keep all."""
_ITERATIONS = 4
"""Iterations of mean and standard deviation over the inliers."""
_PROPAGATION_ITERATIONS = 12
"""Iterations of the diffusion; its reach in triangles."""


def inlier_mask(views: Views, colors: F32) -> Bools:
    """Returns the mask of the inlier views, (N,), each triangle on its own.

    Args:
        views: all views, sorted by triangle.
        colors: (N, 3), their mean colours after exposure compensation, sRGB, 0 to 1.
    """
    if not len(views):
        return np.zeros(0, dtype=bool)
    starts = np.flatnonzero(np.diff(views.face, prepend=-1))
    counts = np.diff(starts, append=len(views))
    group = np.repeat(np.arange(len(starts)), counts)
    mode = _group_medians(colors, group, starts, counts)
    distance = np.linalg.norm(colors - mode[group], axis=1)
    deviation = np.maximum(1.4826 * _group_medians(distance[:, None], group, starts, counts)[:, 0], _MIN_DEVIATION)
    is_inlier = distance <= _MAX_DEVIATIONS * deviation[group]
    for _ in range(_ITERATIONS):
        inlier_counts = np.maximum(np.bincount(group, is_inlier, len(starts)), 1.0)
        mode = np.stack([np.bincount(group, is_inlier * colors[:, k], len(starts)) / inlier_counts for k in range(3)], axis=1)
        distance = np.linalg.norm(colors - mode[group], axis=1)
        deviation = np.maximum(
            np.sqrt(np.bincount(group, is_inlier * distance.astype(np.float64) ** 2, len(starts)) / inlier_counts), _MIN_DEVIATION
        )
        is_inlier = distance <= _MAX_DEVIATIONS * deviation[group]
    return np.asarray(is_inlier | (counts[group] < _MIN_VIEWS))


def propagate_to_neighbours(views: Views, is_inlier: Bools, adjacency: Adjacency) -> Bools:
    """Returns the mask of the inlier views, (N,), after outlier scores were diffused between neighbouring triangles of one photograph.

    Args:
        views: all views, sorted by triangle, then by photograph.
        is_inlier: (N,), mask of ``inlier_mask``.
        adjacency: neighbouring triangles.
    """
    if not len(views):
        return is_inlier
    pairs = _neighbouring_views(views, adjacency)
    counts = np.bincount(views.face)[views.face]
    own_score = np.where(counts < _MIN_VIEWS, 0.5, np.where(is_inlier, 0.0, 1.0))
    weight = (counts >= _MIN_VIEWS).astype(np.float64)
    ones = np.ones(len(pairs))
    graph = sparse.csr_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(views),) * 2)
    graph = graph + graph.T
    weight_sum = np.maximum(weight + np.asarray(graph.sum(axis=1)).ravel(), 1.0)
    outlier_score = own_score.copy()
    for _ in range(_PROPAGATION_ITERATIONS):
        outlier_score = np.where(weight_sum > weight, (weight * own_score + graph @ outlier_score) / weight_sum, own_score)
    is_kept = outlier_score <= 0.5
    # A triangle of which no view would be left keeps all.
    kept_counts = np.bincount(views.face, is_kept)
    return np.asarray(is_kept | (kept_counts[views.face] == 0))


def _neighbouring_views(views: Views, adjacency: Adjacency) -> I64:
    """Returns M pairs (M, 2) of rows of views: neighbouring triangles in one photograph."""
    span = int(views.photograph.max()) + 1
    keys = views.face.astype(np.int64) * span + views.photograph
    starts = np.searchsorted(views.face, np.arange(int(max(views.face.max(), adjacency.faces.max(initial=0))) + 2))
    a, b = adjacency.faces.T
    counts = starts[a + 1] - starts[a]
    view = np.repeat(starts[a] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts) + np.arange(int(counts.sum()))
    wanted_keys = np.repeat(b, counts) * span + views.photograph[view]
    match = np.minimum(np.searchsorted(keys, wanted_keys), len(keys) - 1)
    is_match = keys[match] == wanted_keys
    return np.stack([view[is_match], match[is_match]], axis=1)


def _group_medians(values: F32, group: I64, starts: I64, counts: I64) -> F64:
    """Returns the lower median (G, C) of values (N, C) in each of G groups of consecutive rows.

    Args:
        values: (N, C).
        group: (N,), ascending, group of each row.
        starts: (G,), first row of each group.
        counts: (G,), number of rows of each group.
    """
    medians = np.empty((len(starts), values.shape[1]))
    middle = starts + (counts - 1) // 2
    for k in range(values.shape[1]):
        medians[:, k] = values[np.lexsort((values[:, k], group)), k][middle]
    return medians
