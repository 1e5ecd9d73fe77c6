"""Holes are filled from what is around them, and nothing else changes."""

import cv2
import numpy as np
import pytest

from gibson_sim.filling.push_pull import push_pull, push_pull_depth


def test_a_single_unknown_pixel_takes_the_interpolation_of_the_means_around_it() -> None:
    values = np.random.default_rng(0).random((8, 8)).astype(np.float32)
    hole = np.zeros((8, 8), dtype=bool)
    hole[3, 3] = True
    # It lies amid four pixels of the image of half the size: means around (2, 2), (2, 4), (4, 2), (4, 4), weighted by the binomial kernel.
    kernel = np.outer([1, 4, 6, 4, 1], [1, 4, 6, 4, 1]) / 256
    means = []
    for row, column in ((2, 2), (2, 4), (4, 2), (4, 4)):
        window = np.s_[row - 2 : row + 3, column - 2 : column + 3]
        means.append((kernel * values[window])[~hole[window]].sum() / kernel[~hole[window]].sum())
    filled = push_pull(values, hole)
    assert np.isclose(filled[3, 3], np.mean(means))
    assert np.array_equal(filled[~hole], values[~hole])


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (2, 3), (5, 64), (63, 2)])
def test_images_of_any_shape_are_filled_within_the_range_of_the_known_values(shape: tuple[int, int]) -> None:
    values = np.random.default_rng(1).uniform(2.0, 3.0, shape).astype(np.float32)
    hole = np.ones(shape, dtype=bool)
    hole[0, 0] = hole[-1, -1] = False
    filled = push_pull(values, hole)
    low, high = sorted((values[0, 0], values[-1, -1]))
    assert (filled[hole] >= low - 1e-5).all() and (filled[hole] <= high + 1e-5).all()


def test_filled_pixels_move_with_the_image() -> None:
    """A pyramid of 2x2 means flickers: its values depend on how its grid lies over the image."""
    rng = np.random.default_rng(2)
    values = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (128, 129)), (0, 0), 3).astype(np.float32)
    values = (values - values.min()) / (values.max() - values.min())
    hole = np.zeros(values.shape, dtype=bool)
    hole[40:90, 30:100] = True
    one, other = (push_pull(values[:, k : k + 128], hole[:, k : k + 128]) for k in (0, 1))
    change = np.abs(one[:, 1:] - other[:, :-1])[hole[:, 1:-1]]
    assert change.mean() < 0.0025


def test_one_known_pixel_fills_the_whole_image() -> None:
    values = np.zeros((5, 7, 3), dtype=np.uint8)
    values[3, 2] = 10, 20, 30
    hole = np.ones((5, 7), dtype=bool)
    hole[3, 2] = False
    assert (push_pull(values, hole) == [10, 20, 30]).all()


def test_an_image_without_any_known_pixel_stays_as_it_is() -> None:
    values = np.full((3, 4, 3), 7, dtype=np.uint8)
    assert np.array_equal(push_pull(values, np.ones((3, 4), dtype=bool)), values)


def test_pixels_that_are_neither_hole_nor_known_have_no_influence() -> None:
    values = np.array([[200, 50, 0, 50]], dtype=np.uint8)
    hole, known = np.array([[False, False, True, False]]), np.array([[False, True, False, True]])
    assert push_pull(values, hole, known).tolist() == [[200, 50, 50, 50]]


def test_depth_of_a_plane_is_filled_as_a_plane() -> None:
    # A wall that goes away to the right: its inverse depth is linear in the column.
    inverse = np.tile(np.linspace(1.0, 0.5, 64, dtype=np.float32), (64, 1))
    hole = np.zeros((64, 64), dtype=bool)
    hole[24:40, 24:40] = True
    drawn = np.where(hole, np.inf, 1.0 / inverse).astype(np.float32)
    filled = push_pull_depth(drawn, hole)
    assert np.array_equal(filled[~hole], drawn[~hole])
    assert np.abs(filled * inverse - 1.0).max() < 0.08


def test_pixels_without_depth_outside_holes_keep_no_depth() -> None:
    depth = np.array([[2.0, np.inf, np.inf, 2.0]], dtype=np.float32)
    assert push_pull_depth(depth, np.array([[False, True, False, False]])).tolist() == [[2.0, 2.0, np.inf, 2.0]]


def test_filled_pictures_are_nearer_to_the_truth_than_those_with_holes() -> None:
    rows, columns = np.mgrid[:96, :128]
    truth = np.stack([rows, columns, 128 + 60 * np.sin(columns / 20)], axis=-1).astype(np.uint8)
    noise = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((96, 128)), (0, 0), 5)
    hole = noise > np.quantile(noise, 0.8)
    unfilled = np.where(hole[..., None], 0, truth).astype(np.uint8)
    assert cv2.PSNR(push_pull(unfilled, hole), truth) > cv2.PSNR(unfilled, truth) + 15.0
