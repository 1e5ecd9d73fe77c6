"""Axis-aligned rectangles and boxes."""

from __future__ import annotations

import math

import pytest

from gibson_sim_tools.making.planning.rectangles import Box, Rect, bounding_rect, is_covered, rotated_bounds, subtract

R = Rect(1.0, 2.0, 4.0, 3.0)


def test_a_rectangle_measures_itself() -> None:
    assert (R.width, R.depth, R.area, R.middle) == (3.0, 1.0, 3.0, (2.5, 2.5))
    assert R.grown(0.5) == Rect(0.5, 1.5, 4.5, 3.5)


@pytest.mark.parametrize(
    ("other", "overlap", "area"),
    [
        (Rect(3.0, 0.0, 9.0, 9.0), True, 1.0),
        (Rect(4.0, 2.0, 5.0, 3.0), False, 0.0),  # touches
        (Rect(0.0, 3.0, 9.0, 4.0), False, 0.0),  # touches above
        (Rect(2.0, 2.25, 3.0, 2.75), True, 0.5),  # inside
        (Rect(5.0, 5.0, 6.0, 6.0), False, 0.0),
    ],
)
def test_touching_is_no_overlap(other: Rect, overlap: bool, area: float) -> None:
    assert R.overlaps(other) is overlap and other.overlaps(R) is overlap
    assert R.overlap_area(other) == other.overlap_area(R) == pytest.approx(area)


def test_the_edge_belongs_to_a_rectangle() -> None:
    assert R.holds((1.0, 3.0)) and R.holds((2.0, 2.5))
    assert not R.holds((0.99, 2.5)) and not R.holds((2.0, 3.01))


def test_boxes_above_each_other_do_not_overlap() -> None:
    low, high = Box(R, 0.0, 1.0), Box(R, 1.0, 2.0)
    assert not low.overlaps(high)
    assert low.overlaps(Box(R, 0.5, 2.0))
    assert not low.overlaps(Box(Rect(4.0, 2.0, 5.0, 3.0), 0.0, 1.0))


@pytest.mark.parametrize(
    ("yaw", "expected"),
    [
        (0.0, (-1.0, -0.5, 1.0, 0.5)),
        (math.pi / 2, (-0.5, -1.0, 0.5, 1.0)),
        (math.pi / 4, (-3 / math.sqrt(8), -3 / math.sqrt(8), 3 / math.sqrt(8), 3 / math.sqrt(8))),
    ],
)
def test_a_rotated_rectangle_has_a_bounding_rectangle(yaw: float, expected: tuple[float, ...]) -> None:
    assert rotated_bounds((0.0, 0.0), yaw, 2.0, 1.0) == pytest.approx(expected)


def test_points_have_a_bounding_rectangle() -> None:
    assert bounding_rect([(1.0, 5.0), (-2.0, 3.0), (0.0, 4.0)]) == Rect(-2.0, 3.0, 1.0, 5.0)


def test_a_rectangle_over_two_cells_is_inside_them() -> None:
    cells = [Rect(0.0, 0.0, 2.0, 2.0), Rect(2.0, 0.0, 4.0, 1.0)]
    assert is_covered(Rect(1.0, 0.0, 3.0, 1.0), cells)
    assert not is_covered(Rect(1.0, 0.0, 3.0, 1.5), cells)


def test_a_hole_in_the_middle_leaves_four_rectangles_of_the_right_area() -> None:
    left = subtract([Rect(0.0, 0.0, 3.0, 3.0)], [Rect(1.0, 1.0, 2.0, 2.0)])
    assert len(left) == 4 and sum(r.area for r in left) == pytest.approx(8.0)
    assert not any(a.overlaps(b) for a in left for b in left if a is not b)
    assert not any(r.overlaps(Rect(1.0, 1.0, 2.0, 2.0)) for r in left)


def test_rectangles_that_form_one_are_joined() -> None:
    assert subtract([Rect(0.0, 0.0, 1.0, 2.0), Rect(1.0, 0.0, 3.0, 2.0)], []) == (Rect(0.0, 0.0, 3.0, 2.0),)
    assert subtract([Rect(0.0, 0.0, 1.0, 1.0)], [Rect(-1.0, -1.0, 2.0, 2.0)]) == ()
