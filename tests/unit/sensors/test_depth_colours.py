"""Depth in false colours."""

from __future__ import annotations

import numpy as np

from gibson_sim.sensors.depth_colours import colourise_depth


def test_depth_scale_is_fixed_near_is_red_and_nothing_is_black() -> None:
    depth = np.array([[0.1, 7.9, 20.0, np.inf, np.nan, 0.0]], dtype=np.float32)
    colours = colourise_depth(depth, far_m=8.0)[0].astype(int)
    assert colours[0, 2] > colours[0, 0] + 60
    assert np.array_equal(colours[3:], np.zeros((3, 3)))
    # A lone far point keeps its colour: the scale does not follow the image.
    assert np.array_equal(colours[2], colourise_depth(np.full((1, 1), 8.0))[0, 0])
    assert colours[2].max() > 0
