"""View selection: views of high quality, few seams."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.texturing.labelling import best_labels, connected_patches, label_candidates, optimise_labels, quality_loss
from gibson_sim_tools.texturing.quality import Views
from gibson_sim_tools.texturing.surface import Adjacency


def strip(count: int) -> Adjacency:
    """Triangles in a row."""
    faces = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    return Adjacency(faces, faces)


def views(quality: np.ndarray) -> Views:
    """Views of all triangles in all photographs by their quality (F, P); 0 = not visible."""
    face, photograph = np.nonzero(quality)
    count = len(face)
    return Views(
        face.astype(np.int32), photograph.astype(np.int32), quality[face, photograph].astype(np.float32),
        np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
    )  # fmt: skip


def test_candidates_are_the_best_photographs_best_first():
    candidates = label_candidates(views(np.array([[1.0, 4.0, 2.0], [0.0, 0.0, 0.0]])), 2, max_candidates=2)
    assert candidates.label.tolist() == [[1, 2], [-1, -1]]
    assert candidates.cost[0].tolist() == [0.0, 0.5] and np.isinf(candidates.cost[1]).all()


def test_a_single_better_view_is_relabelled_if_that_costs_less_than_its_seams():
    quality = np.array([[1.0, 0.9]] * 5 + [[0.9, 1.0]] + [[1.0, 0.9]] * 5)
    candidates = label_candidates(views(quality), 11)
    assert best_labels(candidates).tolist() == [0] * 5 + [1] + [0] * 5
    # Two seams cost 0.2, the worse photograph 0.1.
    labels = optimise_labels(candidates, strip(11), 0.1)
    assert labels.tolist() == [0] * 11
    assert abs(quality_loss(labels, candidates) - 0.1 / 11) < 1e-6
    assert optimise_labels(candidates, strip(11), 0.04).tolist() == [0] * 5 + [1] + [0] * 5


def test_a_seam_lies_where_it_costs_least():
    # Photograph 0 fades from left to right, photograph 1 from right to left: one seam, in the middle.
    left = np.linspace(1.0, 0.1, 10)
    labels = optimise_labels(label_candidates(views(np.stack([left, left[::-1]], axis=1)), 10), strip(10), 0.5)
    assert labels.tolist() == [0] * 5 + [1] * 5


def test_noisy_qualities_on_a_grid_give_few_patches_at_little_loss():
    side = 20
    rng = np.random.default_rng(0)
    quality = 1.0 + 0.1 * rng.random((side * side, 4))
    number = np.arange(side * side).reshape(side, side)
    pairs = np.concatenate(
        [np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1), np.stack([number[:-1].ravel(), number[1:].ravel()], 1)]
    )
    adjacency = Adjacency(pairs, pairs)
    candidates = label_candidates(views(quality), side * side)
    labels = optimise_labels(candidates, adjacency, 0.05)
    assert connected_patches(labels, adjacency).max() + 1 <= 5
    assert connected_patches(best_labels(candidates), adjacency).max() + 1 > 100
    assert quality_loss(labels, candidates) < 0.05


def test_unseen_triangles_have_no_label_and_no_patch():
    quality = np.array([[1.0], [0.0], [1.0]])
    candidates = label_candidates(views(quality), 3)
    labels = optimise_labels(candidates, strip(3), 0.5)
    assert labels.tolist() == [0, -1, 0]
    assert connected_patches(labels, strip(3)).tolist() == [0, -1, 1]
