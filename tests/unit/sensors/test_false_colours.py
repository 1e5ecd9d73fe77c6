"""Depth and labels in false colours."""

from __future__ import annotations

import numpy as np

from gibson_sim.sensors.false_colours import colourise_depth, colourise_labels


def test_depth_scale_is_fixed_near_is_red_and_nothing_is_black() -> None:
    depth = np.array([[0.1, 7.9, 20.0, np.inf, np.nan, 0.0]], dtype=np.float32)
    colours = colourise_depth(depth, far_m=8.0)[0].astype(int)
    assert colours[0, 2] > colours[0, 0] + 60
    assert np.array_equal(colours[3:], np.zeros((3, 3)))
    # A lone far point keeps its colour: the scale does not follow the image.
    assert np.array_equal(colours[2], colourise_depth(np.full((1, 1), 8.0))[0, 0])
    assert colours[2].max() > 0


def test_labels_next_to_each_other_get_colours_that_differ() -> None:
    colours = colourise_labels(np.arange(40, dtype=np.uint16)[None])[0].astype(int)
    assert (colours[0] == 0).all()
    assert (np.abs(np.diff(colours, axis=0)).max(axis=1) > 40).all()


def test_a_label_has_the_same_colour_in_every_image() -> None:
    # The hue of label 1 is 0.61803 of a turn, 222 degrees: blue.
    (alone,), (among,) = colourise_labels(np.array([[1]])), colourise_labels(np.array([[9, 1, 65535]]))
    assert np.array_equal(alone[0], among[1])
    assert alone[0].argmax() == 0, "BGR"
