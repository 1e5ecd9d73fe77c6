"""Chooses the photograph of each triangle: good views, few seams.

A Markov random field over the triangles: the cost of a photograph is what its quality falls short of the best one's, and each edge between two
triangles of different photographs costs ``smoothness`` (Potts). It is minimised by loopy belief propagation (min-sum, damped), where a label
set has only the best photographs of each triangle; then small patches take the label of a neighbour where that costs less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from gibson_sim_tools.texturing.quality import Views
from gibson_sim_tools.texturing.surface import Adjacency

Bools = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
I32 = NDArray[np.int32]

UNSEEN = -1
"""Label of a triangle that no photograph shows."""
_CANDIDATES = 12
"""Photographs that a triangle can choose from, the best ones."""
_ROUNDS = 40
_DAMPING = 0.5
"""Share of the old message in a new one: without it, messages can swing for ever."""
_MERGES = 30
"""Most rounds in which patches join neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The photographs that each triangle can choose from."""

    label: I32
    """(F, K), -1 = none."""
    cost: F32
    """(F, K), 0 = the best photograph of the triangle; +inf where there is no label."""
    quality: F32
    """(F, K), 0 where there is no label."""


def candidates_of(views: Views, face_count: int, most: int = _CANDIDATES) -> Candidates:
    """Returns the ``most`` best photographs of each triangle, best first."""
    order = np.lexsort((views.photograph, -views.quality, views.face))
    face = views.face[order]
    starts = np.searchsorted(face, np.arange(face_count))
    rank = np.arange(len(face)) - starts[face] if len(face) else np.zeros(0, dtype=np.int64)
    kept = rank < most
    width = max(int(rank[kept].max(initial=0)) + 1, 1)
    label = np.full((face_count, width), UNSEEN, dtype=np.int32)
    quality = np.zeros((face_count, width), dtype=np.float32)
    label[face[kept], rank[kept]] = views.photograph[order][kept]
    quality[face[kept], rank[kept]] = views.quality[order][kept]
    best = np.maximum(quality[:, :1], 1e-12)
    cost = np.where(label >= 0, 1.0 - quality / best, np.inf).astype(np.float32)
    return Candidates(label, cost, quality)


def best_labels(candidates: Candidates) -> I32:
    """Returns the best photograph of each triangle, (F,)."""
    return candidates.label[:, 0].copy()


def choose_labels(candidates: Candidates, adjacency: Adjacency, smoothness: float) -> I32:
    """Returns the photograph of each triangle, (F,), -1 = unseen.

    Args:
        candidates: what can be chosen.
        adjacency: neighbouring triangles.
        smoothness: cost of an edge between two photographs, where a triangle without its best photograph costs at most 1.
    """
    label = candidates.label
    seen = label[:, 0] >= 0
    pairs = adjacency.faces[seen[adjacency.faces].all(axis=1)]
    choice = _belief_propagation(candidates, pairs, smoothness)
    labels = np.where(seen, np.take_along_axis(label, choice[:, None], axis=1)[:, 0], UNSEEN).astype(np.int32)
    return _merged(labels, candidates, pairs, smoothness)


def quality_loss(labels: I32, candidates: Candidates) -> float:
    """Returns the share of the quality of the best photographs that labels (F,) give up."""
    total = float(candidates.quality[:, 0].sum())
    chosen = np.where(candidates.label == labels[:, None], candidates.quality, 0.0).sum()
    return 1.0 - float(chosen) / max(total, 1e-12)


def patches_of(labels: NDArray[np.integer], adjacency: Adjacency) -> I64:
    """Returns the number of the patch of each triangle, (F,): triangles of one label that are connected by edges; -1 = unseen."""
    same = labels[adjacency.faces[:, 0]] == labels[adjacency.faces[:, 1]]
    a, b = adjacency.faces[same].T
    graph = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(len(labels), len(labels)))
    _, part = csgraph.connected_components(graph, directed=False)
    seen = labels >= 0
    out = np.full(len(labels), -1, dtype=np.int64)
    out[seen] = np.unique(part[seen], return_inverse=True)[1]
    return out


def _belief_propagation(candidates: Candidates, pairs: I64, smoothness: float) -> I64:
    """Returns the index of the candidate of each triangle, (F,)."""
    count, width = candidates.label.shape
    cost = np.where(np.isfinite(candidates.cost), candidates.cost, np.float32(1e6)).astype(np.float32)
    if width == 1 or not len(pairs):
        return np.zeros(count, dtype=np.int64)
    source = np.concatenate([pairs[:, 0], pairs[:, 1]])
    target = np.concatenate([pairs[:, 1], pairs[:, 0]])
    half = len(pairs)
    # Where each candidate of the target stands among those of the source; ``width`` = it is none of them.
    where = np.full((len(source), width), width, dtype=np.int8)
    for k in range(width):
        match = candidates.label[source, k][:, None] == candidates.label[target]
        where[match & (candidates.label[target] >= 0)] = k
    into = sparse.csr_matrix(
        (np.ones(len(target), dtype=np.float32), (target, np.arange(len(target)))), shape=(count, len(target))
    )
    message = np.zeros((len(source), width), dtype=np.float32)
    reverse = np.concatenate([np.arange(half, 2 * half), np.arange(half)])
    smooth = np.float32(smoothness)
    for _ in range(_ROUNDS):
        belief = cost + into @ message
        without = belief[source] - message[reverse]
        least = without.min(axis=1, keepdims=True)
        padded = np.concatenate([without, np.full((len(source), 1), np.inf, dtype=np.float32)], axis=1)
        new = np.minimum(np.take_along_axis(padded, where.astype(np.int64), axis=1), least + smooth) - least
        message = (_DAMPING * message + (1.0 - _DAMPING) * new).astype(np.float32)
    return np.asarray((cost + into @ message).argmin(axis=1), dtype=np.int64)


def _merged(labels: I32, candidates: Candidates, pairs: I64, smoothness: float) -> I32:
    """Returns labels (F,) after whole patches took the label of a neighbouring patch wherever that lowers the cost."""
    labels = labels.copy()
    for _ in range(_MERGES):
        patch = patches_of(labels, Adjacency(pairs, pairs))
        a, b = pairs.T
        cut = labels[a] != labels[b]
        if not cut.any():
            break
        own = np.concatenate([patch[a[cut]], patch[b[cut]]])
        other = np.concatenate([labels[b[cut]], labels[a[cut]]]).astype(np.int64)
        span = int(labels.max()) + 1
        keys, edges = np.unique(own * span + other, return_counts=True)
        patches, options = keys // span, keys % span
        gain = smoothness * edges - _price(patch, patches, options, labels, candidates)
        # Neighbours that move together may miss each other: a patch moves if it gains most among its neighbours.
        order = np.argsort(-gain, kind="stable")
        order = order[gain[order] > 1e-6]
        if not len(order):
            break
        beside: dict[int, set[int]] = {}
        for p, q in zip(own.tolist(), np.concatenate([patch[b[cut]], patch[a[cut]]]).tolist(), strict=True):
            beside.setdefault(p, set()).add(q)
        frozen = np.zeros(int(patch.max()) + 1, dtype=bool)
        target = np.full(len(frozen), UNSEEN, dtype=np.int64)
        for row in order.tolist():
            p = int(patches[row])
            if not frozen[p]:
                target[p] = options[row]
                frozen[[p, *beside[p]]] = True
        moves = (patch >= 0) & (target[patch] >= 0)
        labels[moves] = target[patch[moves]]
    return labels


def _price(patch: I64, patches: I64, options: I64, labels: I32, candidates: Candidates) -> F64:
    """Returns what each patch (N,) pays for another label (N,) in all its triangles; +inf if one of them cannot have it."""
    known = candidates.label >= 0
    face, k = np.nonzero(known)
    count, span = int(patch.max()) + 1, int(candidates.label.max()) + 1
    keys = patch[face] * span + candidates.label[face, k]
    order = np.argsort(keys, kind="stable")
    keys, costs = keys[order], candidates.cost[face, k][order].astype(np.float64)
    sums, numbers = np.concatenate([[0.0], np.cumsum(costs)]), patches * span + options
    low, high = np.searchsorted(keys, numbers, "left"), np.searchsorted(keys, numbers, "right")
    own = np.where(candidates.label == labels[:, None], np.where(known, candidates.cost, 0.0), 0.0).sum(axis=1)
    now = np.bincount(patch[patch >= 0], own[patch >= 0], minlength=count)
    size = np.bincount(patch[patch >= 0], minlength=count)
    return np.where(high - low == size[patches], sums[high] - sums[low] - now[patches], np.inf)
