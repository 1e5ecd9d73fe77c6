"""Force limits in all directions from limits along the axes, without an engine."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.physics.attachments import cube_of, feed_forward, force_bounds

LIMIT = 500.0
DIRECTIONS = [
    (1.0, 0.0, 0.0),
    (0.0, -1.0, 0.0),
    (1.0, 1.0, 0.0),
    (1.0, -1.0, 1.0),
    (1.0, 0.3, 0.0),
    (-1.0, 0.8, 0.7),
    (0.2, -0.5, 1.0),
]


def after(wanted: NDArray[np.float64], steps: int) -> list[float]:
    """Returns the force in each of some steps, N, under a pull of ``wanted``, (3,), N: the engine clips each axis about the feed-forward force."""
    force, half, out = np.zeros(3), LIMIT / math.sqrt(3.0), []
    middle = np.zeros(3)
    for _ in range(steps):
        force = middle + np.clip(wanted - middle, -half, half)
        out.append(float(np.linalg.norm(force)))
        bounds = force_bounds(LIMIT, force.tolist())
        half = cube_of(LIMIT, bounds)
        middle = np.array(feed_forward(force.tolist(), bounds, half))
    return out


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("part", [0.3, 0.6, 0.96])
def test_a_steady_pull_is_borne_within_thirty_steps(direction: tuple[float, float, float], part: float) -> None:
    wanted = np.array(direction) / math.hypot(*direction) * part * LIMIT
    assert after(wanted, 30)[-1] == pytest.approx(part * LIMIT, rel=1e-9)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_pull_beyond_the_limit_is_borne_to_the_limit_in_its_direction(direction: tuple[float, float, float]) -> None:
    borne = after(np.array(direction) / math.hypot(*direction) * 1.2 * LIMIT, 60)
    assert max(borne) <= 1.05 * LIMIT
    assert borne[-1] > 0.95 * LIMIT


def test_no_corner_of_the_cube_is_ever_beyond_the_limit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        force = rng.normal(size=3)
        force *= rng.uniform(0.0, 1.04) * LIMIT / float(np.linalg.norm(force))
        bounds = force_bounds(LIMIT, force.tolist())
        half = cube_of(LIMIT, bounds)
        middle = np.array(feed_forward(force.tolist(), bounds, half))
        corners = [middle + half * np.array(signs) for signs in itertools.product((-1.0, 1.0), repeat=3)]
        assert max(float(np.linalg.norm(corner)) for corner in corners) < 1.0401 * LIMIT
        assert half > 0.2 * LIMIT, "it can always brake"


def test_a_light_pull_needs_nothing_in_advance() -> None:
    force = (0.4 * LIMIT, -0.3 * LIMIT, 0.1 * LIMIT)
    bounds = force_bounds(LIMIT, force)
    half = cube_of(LIMIT, bounds)
    assert half == pytest.approx(1.04 * LIMIT / math.sqrt(3.0))
    assert feed_forward(force, bounds, half) == (0.0, 0.0, 0.0)


def test_the_cube_about_a_pull_along_an_axis_by_hand() -> None:
    # Bound along x: 0.8 + 0.05; its corner is at 1.04: 0.85^2 + 2 half^2 = 1.04^2.
    bounds = force_bounds(1.0, (-0.8, 0.0, 0.0))
    half = cube_of(1.0, bounds)
    assert half == pytest.approx(math.sqrt((1.04**2 - 0.85**2) / 2.0))
    assert feed_forward((-0.8, 0.0, 0.0), bounds, half) == pytest.approx((half - 0.85, 0.0, 0.0))
