"""View selection: labels each triangle with a photograph, by a Markov random field (Lempitsky and Ivanov, CVPR 2007).

Data term: relative loss of quality against the best view of the triangle. Smoothness term: Potts, ``smoothness`` for each edge between two
labels. Damped min-sum loopy belief propagation minimises the energy over the best candidates of each triangle. Then whole patches take the
label of a neighbouring patch wherever that lowers the energy.
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
_MAX_CANDIDATES = 12
"""Largest number of candidate labels of a triangle: those of highest quality."""
_ITERATIONS = 40
"""Iterations of belief propagation."""
_DAMPING = 0.5
"""Weight of the old message in a new one; without damping, messages can oscillate."""
_MAX_MERGE_ROUNDS = 30
"""Largest number of rounds of patch merging."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Candidate labels of each triangle, best first."""

    label: I32
    """(F, K), photograph of each candidate, -1 = none."""
    cost: F32
    """(F, K), data term: 0 = best view of the triangle, 1 = no quality; +inf where there is no label."""
    quality: F32
    """(F, K), see ``Views.quality``; 0 where there is no label."""


def label_candidates(views: Views, face_count: int, max_candidates: int = _MAX_CANDIDATES) -> Candidates:
    """Returns the candidates of ``face_count`` triangles: their ``max_candidates`` views of highest quality, best first."""
    order = np.lexsort((views.photograph, -views.quality, views.face))
    face = views.face[order]
    starts = np.searchsorted(face, np.arange(face_count))
    rank = np.arange(len(face)) - starts[face] if len(face) else np.zeros(0, dtype=np.int64)
    kept = rank < max_candidates
    width = max(int(rank[kept].max(initial=0)) + 1, 1)
    label = np.full((face_count, width), UNSEEN, dtype=np.int32)
    quality = np.zeros((face_count, width), dtype=np.float32)
    label[face[kept], rank[kept]] = views.photograph[order][kept]
    quality[face[kept], rank[kept]] = views.quality[order][kept]
    best = np.maximum(quality[:, :1], 1e-12)
    cost = np.where(label >= 0, 1.0 - quality / best, np.inf).astype(np.float32)
    return Candidates(label, cost, quality)


def best_labels(candidates: Candidates) -> I32:
    """Returns the photograph of highest quality of each triangle, (F,), -1 = unseen: labels without a smoothness term."""
    return candidates.label[:, 0].copy()


def optimise_labels(candidates: Candidates, adjacency: Adjacency, smoothness: float) -> I32:
    """Returns the label of each triangle, (F,), -1 = unseen, that approximately minimises the energy of the Markov random field.

    Args:
        candidates: candidate labels and their data terms.
        adjacency: edges of the field.
        smoothness: cost of an edge between two labels; a data term is at most 1.
    """
    label = candidates.label
    has_label = label[:, 0] >= 0
    edges = adjacency.faces[has_label[adjacency.faces].all(axis=1)]
    selected = _belief_propagation(candidates, edges, smoothness)
    labels = np.where(has_label, np.take_along_axis(label, selected[:, None], axis=1)[:, 0], UNSEEN).astype(np.int32)
    return _merge_patches(labels, candidates, edges, smoothness)


def quality_loss(labels: I32, candidates: Candidates) -> float:
    """Returns the quality that labels (F,) lose against the best views, as a fraction of the best views' quality."""
    total = float(candidates.quality[:, 0].sum())
    selected = np.where(candidates.label == labels[:, None], candidates.quality, 0.0).sum()
    return 1.0 - float(selected) / max(total, 1e-12)


def connected_patches(labels: NDArray[np.integer], adjacency: Adjacency) -> I64:
    """Returns the patch of each triangle, (F,), -1 = unseen: connected components of triangles with equal labels (F,)."""
    is_same = labels[adjacency.faces[:, 0]] == labels[adjacency.faces[:, 1]]
    a, b = adjacency.faces[is_same].T
    graph = sparse.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(len(labels), len(labels)))
    _, component = csgraph.connected_components(graph, directed=False)
    has_label = labels >= 0
    patch = np.full(len(labels), -1, dtype=np.int64)
    patch[has_label] = np.unique(component[has_label], return_inverse=True)[1]
    return patch


def _belief_propagation(candidates: Candidates, edges: I64, smoothness: float) -> I64:
    """Returns the selected candidate of each triangle, (F,), an index below K.

    Args:
        candidates: (F, K) candidates.
        edges: (E, 2), pairs of neighbouring triangles that have candidates.
        smoothness: Potts cost.
    """
    count, width = candidates.label.shape
    cost = np.where(np.isfinite(candidates.cost), candidates.cost, np.float32(1e6)).astype(np.float32)
    if width == 1 or not len(edges):
        return np.zeros(count, dtype=np.int64)
    source = np.concatenate([edges[:, 0], edges[:, 1]])
    target = np.concatenate([edges[:, 1], edges[:, 0]])
    edge_count = len(edges)
    # Index of each candidate label of the target among those of the source; ``width`` = the source lacks it.
    candidate_index = np.full((len(source), width), width, dtype=np.int8)
    for k in range(width):
        match = candidates.label[source, k][:, None] == candidates.label[target]
        candidate_index[match & (candidates.label[target] >= 0)] = k
    incoming = sparse.csr_matrix(
        (np.ones(len(target), dtype=np.float32), (target, np.arange(len(target)))), shape=(count, len(target))
    )
    message = np.zeros((len(source), width), dtype=np.float32)
    reverse_edge = np.concatenate([np.arange(edge_count, 2 * edge_count), np.arange(edge_count)])
    smoothness_cost = np.float32(smoothness)
    for _ in range(_ITERATIONS):
        belief = cost + incoming @ message
        cavity = belief[source] - message[reverse_edge]
        minimum = cavity.min(axis=1, keepdims=True)
        padded_cavity = np.concatenate([cavity, np.full((len(source), 1), np.inf, dtype=np.float32)], axis=1)
        new_message = (
            np.minimum(np.take_along_axis(padded_cavity, candidate_index.astype(np.int64), axis=1), minimum + smoothness_cost)
            - minimum
        )
        message = (_DAMPING * message + (1.0 - _DAMPING) * new_message).astype(np.float32)
    return np.asarray((cost + incoming @ message).argmin(axis=1), dtype=np.int64)


def _merge_patches(labels: I32, candidates: Candidates, edges: I64, smoothness: float) -> I32:
    """Returns labels (F,) after whole patches were relabelled with a neighbouring patch's label wherever that lowers the energy."""
    labels = labels.copy()
    for _ in range(_MAX_MERGE_ROUNDS):
        patch = connected_patches(labels, Adjacency(edges, edges))
        a, b = edges.T
        is_seam = labels[a] != labels[b]
        if not is_seam.any():
            break
        patch_ids = np.concatenate([patch[a[is_seam]], patch[b[is_seam]]])
        neighbour_labels = np.concatenate([labels[b[is_seam]], labels[a[is_seam]]]).astype(np.int64)
        span = int(labels.max()) + 1
        keys, seam_counts = np.unique(patch_ids * span + neighbour_labels, return_counts=True)
        patches, new_labels = keys // span, keys % span
        gain = smoothness * seam_counts - _relabel_cost(patch, patches, new_labels, labels, candidates)
        # Neighbouring patches that were relabelled at once could swap labels: a relabelled patch locks its neighbours for this round.
        order = np.argsort(-gain, kind="stable")
        order = order[gain[order] > 1e-6]
        if not len(order):
            break
        neighbours: dict[int, set[int]] = {}
        for p, q in zip(patch_ids.tolist(), np.concatenate([patch[b[is_seam]], patch[a[is_seam]]]).tolist(), strict=True):
            neighbours.setdefault(p, set()).add(q)
        is_locked = np.zeros(int(patch.max()) + 1, dtype=bool)
        target = np.full(len(is_locked), UNSEEN, dtype=np.int64)
        for row in order.tolist():
            p = int(patches[row])
            if not is_locked[p]:
                target[p] = new_labels[row]
                is_locked[[p, *neighbours[p]]] = True
        is_relabelled = (patch >= 0) & (target[patch] >= 0)
        labels[is_relabelled] = target[patch[is_relabelled]]
    return labels


def _relabel_cost(patch: I64, patches: I64, new_labels: I64, labels: I32, candidates: Candidates) -> F64:
    """Returns the change of the data term, (N,), if patches (N,) take new labels (N,); +inf if a triangle lacks that candidate."""
    is_candidate = candidates.label >= 0
    face, k = np.nonzero(is_candidate)
    count, span = int(patch.max()) + 1, int(candidates.label.max()) + 1
    keys = patch[face] * span + candidates.label[face, k]
    order = np.argsort(keys, kind="stable")
    keys, costs = keys[order], candidates.cost[face, k][order].astype(np.float64)
    cumulative, wanted_keys = np.concatenate([[0.0], np.cumsum(costs)]), patches * span + new_labels
    low, high = np.searchsorted(keys, wanted_keys, "left"), np.searchsorted(keys, wanted_keys, "right")
    own_cost = np.where(candidates.label == labels[:, None], np.where(is_candidate, candidates.cost, 0.0), 0.0).sum(axis=1)
    current_cost = np.bincount(patch[patch >= 0], own_cost[patch >= 0], minlength=count)
    size = np.bincount(patch[patch >= 0], minlength=count)
    return np.where(high - low == size[patches], cumulative[high] - cumulative[low] - current_cost[patches], np.inf)
