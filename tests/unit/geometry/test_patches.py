"""Numbers of the cubes in which the points of a mesh lie."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.geometry.patches import occupied_cells


@pytest.mark.parametrize("far", [0, 10**12])
def test_cells_that_occur_are_counted_near_and_far_apart_alike(far: int) -> None:
    found, index, counts = occupied_cells(np.array([3, far, 3, 7, 3]))
    expected = ([3, 7, far], [0, 2, 0, 1, 0], [3, 1, 1]) if far else ([0, 3, 7], [1, 0, 1, 2, 1], [1, 3, 1])
    assert (found.tolist(), index.tolist(), counts.tolist()) == expected


def test_without_points_no_cell_occurs() -> None:
    assert [part.tolist() for part in occupied_cells(np.zeros(0, dtype=np.int64))] == [[], [], []]
