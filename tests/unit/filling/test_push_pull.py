"""Holes are filled from what is around them, and nothing else changes."""

import cv2
import numpy as np

from gibson_sim.filling.push_pull import push_pull, push_pull_depth


def test_a_single_unknown_pixel_takes_the_interpolation_of_the_means_around_it() -> None:
    values = np.array([[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12], [13, 14, 15, 16]], dtype=np.float32)
    hole = np.zeros((4, 4), dtype=bool)
    hole[1, 1] = True
    # Means of the known ones of four: (1 + 2 + 5) / 3, 5.5, 11.5, 13.5. Pixel (1, 1) lies a quarter of a pixel from the first centre.
    means = np.array([[8 / 3, 5.5], [11.5, 13.5]])
    shares = np.array([[9, 3], [3, 1]]) / 16
    filled = push_pull(values, hole)
    assert np.isclose(filled[1, 1], (means * shares).sum())
    assert np.array_equal(filled[~hole], values[~hole])


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


def test_what_has_no_depth_and_is_no_hole_keeps_having_none() -> None:
    depth = np.array([[2.0, np.inf, np.inf, 2.0]], dtype=np.float32)
    assert push_pull_depth(depth, np.array([[False, True, False, False]])).tolist() == [[2.0, 2.0, np.inf, 2.0]]


def test_filled_pictures_are_nearer_to_the_truth_than_those_with_holes() -> None:
    rows, columns = np.mgrid[:96, :128]
    truth = np.stack([rows, columns, 128 + 60 * np.sin(columns / 20)], axis=-1).astype(np.uint8)
    noise = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((96, 128)), (0, 0), 5)
    hole = noise > np.quantile(noise, 0.8)
    unfilled = np.where(hole[..., None], 0, truth).astype(np.uint8)
    assert cv2.PSNR(push_pull(unfilled, hole), truth) > cv2.PSNR(unfilled, truth) + 15.0
