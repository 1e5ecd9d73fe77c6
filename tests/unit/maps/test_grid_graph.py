"""Shortest paths over small grids, whose lengths are computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_sim.maps.grid_graph import GridGraph

OPEN = np.ones((3, 4), dtype=bool)


def test_nodes_are_the_passable_cells_row_by_row() -> None:
    passable = np.array([[True, False, True], [False, True, True]])
    graph = GridGraph(passable, 1.0)
    assert graph.cells.tolist() == [[0, 0], [0, 2], [1, 1], [1, 2]]
    assert graph.numbers.tolist() == [[0, -1, 1], [-1, 2, 3]]


def test_path_goes_diagonally_and_then_straight() -> None:
    paths = GridGraph(OPEN, 0.5).shortest_paths(0)
    # From [0, 0] to [2, 3]: two diagonals and one straight step.
    assert paths.lengths[0, 11] == pytest.approx(0.5 * (2 * math.sqrt(2) + 1))
    nodes = paths.nodes(0, 11)
    assert (nodes[0], nodes[-1], len(nodes)) == (0, 11, 4)


def test_longer_reach_takes_the_straight_line() -> None:
    assert GridGraph(OPEN, 0.5, max_step=3).shortest_paths(0).lengths[0, 11] == pytest.approx(0.5 * math.hypot(2, 3))


def test_distances_are_those_to_the_nearest_source() -> None:
    assert GridGraph(np.ones((1, 5), dtype=bool), 2.0).distances([0, 4]).tolist() == [0.0, 2.0, 4.0, 2.0, 0.0]


def test_step_costs_the_mean_price_of_its_ends() -> None:
    graph = GridGraph(np.ones((1, 3), dtype=bool), 1.0, price=np.array([1.0, 3.0, 1.0]))
    assert graph.distances(0).tolist() == [0.0, 2.0, 4.0]


@pytest.mark.parametrize(("clear_lines", "length"), [(False, math.sqrt(2)), (True, math.inf)])
def test_clear_lines_keep_steps_from_slipping_through_a_corner(clear_lines: bool, length: float) -> None:
    graph = GridGraph(np.eye(2, dtype=bool), 1.0, clear_lines=clear_lines)
    assert graph.shortest_paths(0).lengths[0, 1] == pytest.approx(length)
