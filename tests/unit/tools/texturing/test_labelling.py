"""Choosing photographs: good ones, few seams."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.texturing.labelling import best_labels, candidates_of, choose_labels, patches_of, quality_loss
from gibson_sim_tools.texturing.quality import Views
from gibson_sim_tools.texturing.surface import Adjacency


def strip(count: int) -> Adjacency:
    """Triangles in a row."""
    faces = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    return Adjacency(faces, faces)


def views(quality: np.ndarray) -> Views:
    """Views of all triangles in all photographs by their quality (F, P); 0 = not seen."""
    face, photograph = np.nonzero(quality)
    count = len(face)
    return Views(
        face.astype(np.int32), photograph.astype(np.int32), quality[face, photograph].astype(np.float32),
        np.zeros((count, 3), np.float32), np.zeros(count, np.float32),
    )  # fmt: skip


def test_candidates_are_the_best_photographs_best_first():
    found = candidates_of(views(np.array([[1.0, 4.0, 2.0], [0.0, 0.0, 0.0]])), 2, most=2)
    assert found.label.tolist() == [[1, 2], [-1, -1]]
    assert found.cost[0].tolist() == [0.0, 0.5] and np.isinf(found.cost[1]).all()


def test_a_lone_better_photograph_yields_to_its_neighbours_if_that_loses_little():
    quality = np.array([[1.0, 0.9]] * 5 + [[0.9, 1.0]] + [[1.0, 0.9]] * 5)
    found = candidates_of(views(quality), 11)
    assert best_labels(found).tolist() == [0] * 5 + [1] + [0] * 5
    # Two seams cost 0.2, the worse photograph 0.1.
    chosen = choose_labels(found, strip(11), 0.1)
    assert chosen.tolist() == [0] * 11
    assert abs(quality_loss(chosen, found) - 0.1 / 11) < 1e-6
    assert choose_labels(found, strip(11), 0.04).tolist() == [0] * 5 + [1] + [0] * 5


def test_a_seam_lies_where_it_costs_least():
    # Photograph 0 fades from left to right, photograph 1 from right to left: one seam, in the middle.
    left = np.linspace(1.0, 0.1, 10)
    chosen = choose_labels(candidates_of(views(np.stack([left, left[::-1]], axis=1)), 10), strip(10), 0.5)
    assert chosen.tolist() == [0] * 5 + [1] * 5


def test_a_grid_of_noise_gets_few_patches_at_little_loss():
    side = 20
    rng = np.random.default_rng(0)
    quality = 1.0 + 0.1 * rng.random((side * side, 4))
    number = np.arange(side * side).reshape(side, side)
    pairs = np.concatenate(
        [np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1), np.stack([number[:-1].ravel(), number[1:].ravel()], 1)]
    )
    beside = Adjacency(pairs, pairs)
    found = candidates_of(views(quality), side * side)
    chosen = choose_labels(found, beside, 0.05)
    assert patches_of(chosen, beside).max() + 1 <= 5
    assert patches_of(best_labels(found), beside).max() + 1 > 100
    assert quality_loss(chosen, found) < 0.05


def test_unseen_triangles_have_no_label_and_no_patch():
    quality = np.array([[1.0], [0.0], [1.0]])
    found = candidates_of(views(quality), 3)
    chosen = choose_labels(found, strip(3), 0.5)
    assert chosen.tolist() == [0, -1, 0]
    assert patches_of(chosen, strip(3)).tolist() == [0, -1, 1]
