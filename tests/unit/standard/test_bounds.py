"""Volumes, and which boxes overlap them. The box of these tests goes from (0, 0, 0) to (2, 1, 1)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

from gibson_sim.standard.bounds import Bounds, BoundsType, OverlapTest, box_bounds
from gibson_sim.standard.codes import Result, SimulationError
from gibson_sim.types import Vec3

LOW, HIGH = (0.0, 0.0, 0.0), (2.0, 1.0, 1.0)


def overlaps(kind: BoundsType, *points: Vec3) -> bool:
    return OverlapTest(Bounds(kind, points)).overlaps_box(LOW, HIGH)


def test_empty_bounds_are_everywhere() -> None:
    assert OverlapTest(Bounds(BoundsType.EMPTY)).always_true
    assert overlaps(BoundsType.EMPTY)


@pytest.mark.parametrize(
    ("center", "radius", "overlap"),
    [
        ((1.0, 0.5, 0.5), 0.0, True),
        ((3.0, 0.5, 0.5), 1.0, True),
        ((3.0, 0.5, 0.5), 0.99, False),
        # From the corner (2, 1, 1) by (3, 4, 0): 5 m.
        ((5.0, 5.0, 1.0), 5.0, True),
        ((5.0, 5.0, 1.0), 4.99, False),
    ],
)
def test_sphere_overlaps_bounds_within_its_radius(center: Vec3, radius: float, overlap: bool) -> None:
    assert overlaps(BoundsType.SPHERE, center, (radius, 99.0, 99.0)) is overlap


def test_box_overlaps_in_either_order_of_its_corners() -> None:
    far, near = (4.0, 4.0, 4.0), (1.9, 0.9, 0.9)
    assert overlaps(BoundsType.BOX, far, near)
    assert overlaps(BoundsType.BOX, near, far)
    assert not overlaps(BoundsType.BOX, far, (2.1, 0.0, 0.0))


def test_hull_is_tighter_than_the_box_about_it() -> None:
    # A triangle in the plane z = 0.5 whose long side x + y = 3.5 passes the corner (2, 1) at a distance.
    triangle = ((3.5, 0.0, 0.5), (0.0, 3.5, 0.5), (3.5, 3.5, 0.5))
    assert not overlaps(BoundsType.CONVEX_HULL, *triangle)
    assert overlaps(BoundsType.BOX, (3.5, 3.5, 0.5), (0.0, 0.0, 0.5))
    nearer = ((2.9, 0.0, 0.5), (0.0, 2.9, 0.5), (3.5, 3.5, 0.5))
    assert overlaps(BoundsType.CONVEX_HULL, *nearer)


def test_hull_about_the_whole_box_overlaps_it_though_no_corner_is_inside() -> None:
    around = tuple((x, y, z) for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (-9.0, 9.0))
    assert overlaps(BoundsType.CONVEX_HULL, *around)


@pytest.mark.parametrize(
    ("points", "overlap"),
    [
        # A line past the edge at x = 2, z = 1: x + z = 3.2 misses it, 2.8 does not; the boxes about both overlap it.
        (((1.0, 0.5, 2.2), (2.2, 0.5, 1.0), (1.6, 0.5, 1.6)), False),
        (((0.8, 0.5, 2.0), (2.0, 0.5, 0.8), (1.4, 0.5, 1.4)), True),
        # One point, three times.
        (((1.0, 0.5, 0.5),) * 3, True),
        (((1.0, 0.5, 1.5),) * 3, False),
        # A tetrahedron with a corner in the box, and one that only its face would cut off.
        (((1.0, 0.5, 0.5), (9.0, 9.0, 9.0), (9.0, 8.0, 9.0), (8.0, 9.0, 9.0)), True),
        (((5.0, 0.0, 0.0), (0.0, 5.0, 0.0), (0.0, 0.0, 5.0), (5.0, 5.0, 5.0)), False),
    ],
)
def test_flat_and_thin_hulls_are_judged_exactly(points: tuple[Vec3, ...], overlap: bool) -> None:
    assert overlaps(BoundsType.CONVEX_HULL, *points) is overlap


def test_hulls_agree_with_a_linear_programme() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        points = rng.uniform(-2.0, 4.0, (int(rng.integers(3, 9)), 3))
        points[:, 2] *= rng.choice([0.0, 0.3, 1.0])
        bounds = Bounds(BoundsType.CONVEX_HULL, tuple((float(x), float(y), float(z)) for x, y, z in points))
        # Is there a weighted mean of the points, all weights 0 or more, in the box?
        meets = linprog(
            np.zeros(len(points)),
            A_ub=np.concatenate([points.T, -points.T]),
            b_ub=np.concatenate([HIGH, np.negative(LOW)]),
            A_eq=np.ones((1, len(points))),
            b_eq=[1.0],
        )
        assert OverlapTest(bounds).overlaps_box(LOW, HIGH) is (meets.status == 0)


def test_box_bounds_have_the_upper_corner_first() -> None:
    assert box_bounds(LOW, HIGH).points == (HIGH, LOW)


@pytest.mark.parametrize(
    ("bounds", "code"),
    [
        (Bounds(4), Result.FEATURE_UNSUPPORTED),
        (Bounds(BoundsType.BOX, ((0.0, 0.0, 0.0),)), Result.OPERATION_FAILED),
        (Bounds(BoundsType.SPHERE), Result.OPERATION_FAILED),
        (Bounds(BoundsType.SPHERE, ((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0))), Result.OPERATION_FAILED),
        (Bounds(BoundsType.CONVEX_HULL, (LOW, HIGH)), Result.OPERATION_FAILED),
        (Bounds(BoundsType.CONVEX_HULL, (LOW,) * 257), Result.OPERATION_FAILED),
        (Bounds(BoundsType.BOX, ((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0))), Result.OPERATION_FAILED),
        (Bounds(BoundsType.SPHERE, ((0.0, 0.0, 0.0), (math.inf, 0.0, 0.0))), Result.OPERATION_FAILED),
    ],
)
def test_impossible_bounds_are_refused(bounds: Bounds, code: Result) -> None:
    with pytest.raises(SimulationError) as error:
        OverlapTest(bounds)
    assert error.value.code is code
