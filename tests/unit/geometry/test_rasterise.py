"""The cells that polygons cover."""

from __future__ import annotations

import math

import numpy as np

from gibson_sim.geometry.rasterise import rasterise


def test_cells_that_share_more_than_a_rim_are_covered() -> None:
    square = np.array([[[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]]])
    covered = np.zeros((4, 5), dtype=bool)
    covered[1, 1:3] = True
    assert np.array_equal(rasterise(square, (4, 5)), covered)


def test_points_far_outside_and_nan_cause_no_warning() -> None:
    for far in (1e300, -1e300, math.inf, math.nan):
        triangle = np.array([[[1.0, 1.0], [2.0, 1.0], [far, 2.0]]])
        assert rasterise(triangle, (4, 5)).shape == (4, 5)
    assert rasterise(np.array([[[-50.0, 1.2], [50.0, 1.2], [50.0, 1.8]]]), (4, 5))[1].all()
