"""Faults of meshes, counted by hand; and the clearance of places."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim_tools.importing.checks.faults import find_faults, weld
from gibson_sim_tools.importing.scene_files import clearances

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_vertices_within_a_hundred_thousandth_of_the_whole_are_one() -> None:
    assert len(weld(np.zeros((0, 3)))) == 0
    numbers = weld(np.array([[0.0, 0, 0], [10, 0, 0], [10, 0, 0.00004], [10, 0, 0.00016]]))
    assert numbers[1] == numbers[2] and len(set(numbers.tolist())) == 3


def test_nothing_has_no_faults() -> None:
    faults = find_faults(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    assert (faults.open_edges, faults.holes, faults.largest_piece, len(faults.inverted)) == (0, (), 0.0, 0)


def test_a_sheet_is_open_along_its_rim() -> None:
    faults = find_faults(SQUARE, HALVES)
    assert (faults.open_edges, faults.inconsistent_edges, faults.non_manifold_edges, faults.largest_piece) == (4, 0, 0, 1.0)
    assert faults.open_length == pytest.approx(4.0) and faults.holes == pytest.approx((4.0,))


def test_the_rim_has_its_length_beside_a_triangle_without_area() -> None:
    """The vertex with the greatest number belongs to the degenerate triangle alone."""
    vertices = np.concatenate([SQUARE, [[5.0, 5.0, 5.0]]])
    faults = find_faults(vertices, np.concatenate([HALVES, [[4, 4, 4]]]))
    assert faults.degenerate.tolist() == [False, False, True]
    assert faults.open_length == pytest.approx(4.0) and faults.holes == pytest.approx((4.0,))


def test_two_sheets_have_two_rims_the_longest_first() -> None:
    vertices = np.concatenate([SQUARE, 3.0 * SQUARE + [10.0, 0.0, 0.0]])
    faults = find_faults(vertices, np.concatenate([HALVES, HALVES + 4]))
    assert faults.holes == pytest.approx((12.0, 4.0)) and faults.largest_piece == 0.5


@pytest.mark.parametrize("flip", [0, 1, 2, 3])
def test_one_face_of_a_small_closed_thing_that_is_turned_is_found(flip: int) -> None:
    faces = TETRAHEDRON.copy()
    faces[flip] = faces[flip][::-1]
    # A far sheet makes the whole larger than the thing, which is no room then.
    vertices = np.concatenate([CORNERS, 10.0 * SQUARE + [5.0, 5.0, 0.0]])
    faults = find_faults(vertices, np.concatenate([faces, HALVES + 4]))
    assert np.flatnonzero(faults.inverted).tolist() == [flip] and faults.inconsistent_edges == 3


def test_a_thing_inside_out_is_turned_and_a_moebius_strip_is_left() -> None:
    vertices = np.concatenate([CORNERS, 10.0 * SQUARE + [5.0, 5.0, 0.0]])
    faults = find_faults(vertices, np.concatenate([TETRAHEDRON[:, ::-1], HALVES + 4]))
    assert np.flatnonzero(faults.inverted).tolist() == [0, 1, 2, 3]

    angle, half = np.linspace(0.0, 2 * np.pi, 12, endpoint=False), 0.3
    rim = [(1 + s * half * np.cos(angle / 2)) * np.array([np.cos(angle), np.sin(angle)]) for s in (-1, 1)]
    points = np.stack([np.column_stack([xy.T, s * half * np.sin(angle / 2)]) for s, xy in zip((-1, 1), rim, strict=True)], axis=1)
    k = np.arange(12)
    low, high = 2 * k, 2 * k + 1
    # Once around, the two sides have changed places.
    next_low, next_high = np.where(k == 11, 1, low + 2), np.where(k == 11, 0, high + 2)
    strip = np.concatenate([np.stack([low, next_low, next_high], 1), np.stack([low, next_high, high], 1)])
    found = find_faults(points.reshape(-1, 3), strip)
    assert found.inconsistent_edges == 1 and not found.inverted.any() and len(found.holes) == 1


def test_three_faces_at_an_edge_are_crowded() -> None:
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    faults = find_faults(np.concatenate([CORNERS, [[0.0, -1.0, 0.0]]]), faces)
    assert faults.non_manifold_edges == 1 and faults.open_edges == 6
    assert faults.largest_piece == pytest.approx(1 / 3), "a crowded edge joins nothing"


def _wall(x: float, low: float, high: float) -> list[np.ndarray]:
    a, b, c, d = (np.array(p) for p in ((x, -1.0, low), (x, 1.0, low), (x, 1.0, high), (x, -1.0, high)))
    return [np.stack([a, b, c]), np.stack([a, c, d])]


def test_clearance_is_level_and_counts_what_is_between_two_heights() -> None:
    corners = np.array([*_wall(0.5, 0.0, 2.0), *_wall(0.3, 0.6, 2.0), *_wall(0.2, -1.0, 0.05)])
    places = np.array([[0.0, 0.0], [0.0, 1.3], [0.5, 0.0], [-3.0, 0.0]])
    found = clearances(corners, places, 0.1, 0.5)
    assert found == pytest.approx([0.5, np.hypot(0.5, 0.3), 0.0, 1.0])
    assert clearances(corners, places[:1], 0.1, 0.7) == pytest.approx([0.3])


def test_a_place_on_a_table_top_has_no_clearance() -> None:
    top = np.array([[[-1.0, -1, 0.4], [1, -1, 0.4], [0, 1, 0.4]]])
    assert clearances(top, [[0.0, 0.0], [0.0, 1.2]], 0.1, 0.5) == pytest.approx([0.0, 0.2])
