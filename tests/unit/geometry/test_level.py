"""The direction across level surfaces: platforms at several heights are level each for itself, and are no slope together."""

from __future__ import annotations

import numpy as np
import pytest

from gibson_sim.geometry.level import level_direction
from gibson_sim.geometry.patches import flat_patches
from support.interiors import turned
from support.scans import hall

UP = np.array([0.0, 0.0, 1.0])


def _tilt_deg(vertices: np.ndarray, triangles: np.ndarray, up: np.ndarray = UP) -> float:
    patches = flat_patches(vertices, triangles, np.random.default_rng(0))
    assert patches is not None
    return float(np.degrees(np.arccos(min(1.0, float(level_direction(patches, up)[0] @ UP)))))


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.015])
@pytest.mark.parametrize(
    ("size", "rise", "depth", "start"), [((12.0, 9.0, 3.5), 0.09, 2.0, 2.0), ((8.0, 6.0, 3.0), 0.05, 1.5, 1.0)]
)
def test_raised_seating_does_not_tilt_a_level_hall(
    size: tuple[float, float, float], rise: float, depth: float, start: float, noise: float
) -> None:
    # One plane through all platforms slopes by 2.6 and 1.9 degrees.
    assert _tilt_deg(*hall(size, rise=rise, depth=depth, start=start, noise=noise)) < 0.05


def test_a_direction_that_is_somewhat_off_is_put_right_by_walls_and_platforms() -> None:
    vertices, triangles = hall((12.0, 9.0, 3.5), rise=0.09, depth=2.0, start=2.0, noise=0.005)
    guess = np.array([-np.sin(np.radians(2.6)), 0.0, np.cos(np.radians(2.6))])  # across the plane through all platforms
    assert _tilt_deg(vertices, triangles, guess) < 0.05


def test_a_hall_with_raised_seating_that_is_tilted_is_measured() -> None:
    vertices, triangles = hall((12.0, 9.0, 3.5), rise=0.09, depth=2.0, start=2.0, noise=0.005)
    assert _tilt_deg(turned(vertices, 1, 1.5), triangles) == pytest.approx(1.5, abs=0.05)
    assert _tilt_deg(turned(vertices, 0, -0.6), triangles) == pytest.approx(0.6, abs=0.05)


def test_without_anything_level_the_direction_stays() -> None:
    wall = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 2.0], [0.0, 0.0, 2.0]])
    patches = flat_patches(wall, np.array([[0, 1, 2], [0, 2, 3]]), np.random.default_rng(0))
    assert patches is not None
    found, share = level_direction(patches, UP)
    assert share == 0.0 and found.tolist() == UP.tolist()
