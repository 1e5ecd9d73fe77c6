"""Localisation with a particle filter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, Pose2D
from gibson_examples.grid import Grid
from gibson_examples.localisation import FilterSettings, Localiser, ParticleFilter, scan_points
from unit.examples.drawing import grid_of, ranges_at

EXACT = {
    "rotation_from_rotation": 0.0,
    "rotation_from_translation": 0.0,
    "translation_from_translation": 0.0,
    "translation_from_rotation": 0.0,
}
ROOM = ["#" * 60, *["#" + "." * 58 + "#"] * 14, *["#" + "." * 40 + "#" * 19] * 10, *["#" + "." * 58 + "#"] * 14, "#" * 60]
"""6 m x 4 m with a block at its right side, so that no two places look alike."""
ORIGIN = Pose2D(0.0, 0.0, 0.0)


def room() -> Grid:
    return grid_of(*ROOM)


def hits_at(grid: Grid, pose: Pose2D, rng: np.random.Generator | None = None) -> F64:
    ranges = ranges_at(grid, pose)
    if rng is not None:
        ranges = ranges + 0.01 * rng.standard_normal(len(ranges))
    ends, hits = scan_points(ranges.astype(np.float32), 0.0, 2 * math.pi / len(ranges), 0.1, 12.0)
    return ends[hits]


def filter_of(seed: int = 0, **settings: float) -> ParticleFilter:
    return ParticleFilter(room(), FilterSettings(**settings), np.random.default_rng(seed))  # type: ignore[arg-type]


def test_beams_end_where_they_were_measured() -> None:
    ends, hits = scan_points(np.array([1.0, 2.0], dtype=np.float32), 0.0, math.pi / 2, 0.1, 12.0)
    assert ends == pytest.approx(np.array([[1.0, 0.0], [0.0, 2.0]]))
    assert hits.tolist() == [True, True]


def test_beams_without_return_end_at_the_range_and_those_without_measurement_are_left_out() -> None:
    ranges = np.array([np.inf, -np.inf, np.nan, 0.05, 12.5, 3.0], dtype=np.float32)
    ends, hits = scan_points(ranges, 0.0, 0.0, 0.1, 12.0)
    assert ends[:, 0].tolist() == [12.0, 12.0, 3.0]
    assert hits.tolist() == [False, False, True]


def test_exact_odometry_moves_every_particle_as_the_robot_moved() -> None:
    particles = filter_of(**EXACT)
    particles.initialise(Pose2D(1.0, 1.0, math.pi / 2), 0.0, 0.0)
    particles.predict(Pose2D(5.0, 0.0, 0.0), Pose2D(6.0, 0.5, 0.25))
    assert particles.particles == pytest.approx(np.tile([0.5, 2.0, math.pi / 2 + 0.25], (500, 1)))


def test_driving_backwards_moves_particles_backwards() -> None:
    particles = filter_of(**EXACT)
    particles.initialise(Pose2D(3.0, 2.0, 0.0), 0.0, 0.0)
    particles.predict(ORIGIN, Pose2D(-0.4, 0.02, 0.1))
    assert particles.particles == pytest.approx(np.tile([2.6, 2.02, 0.1], (500, 1)))


def test_a_turn_on_the_spot_leaves_the_particles_where_they_are() -> None:
    particles = filter_of(translation_from_rotation=0.0)
    particles.initialise(Pose2D(3.0, 2.0, 0.0), 0.0, 0.0)
    particles.predict(ORIGIN, Pose2D(0.0, 0.0, 1.0))
    assert particles.particles[:, :2] == pytest.approx(np.tile([3.0, 2.0], (500, 1)))
    assert particles.particles[:, 2].std() == pytest.approx(0.08, rel=0.15)


def test_spread_grows_with_the_way() -> None:
    particles = filter_of(translation_from_translation=0.1, rotation_from_translation=0.0)
    particles.initialise(Pose2D(1.0, 2.0, 0.0), 0.0, 0.0)
    particles.predict(ORIGIN, Pose2D(2.0, 0.0, 0.0))
    assert particles.particles[:, 0].std() == pytest.approx(0.2, rel=0.15)


def test_scan_pulls_a_wrong_pose_to_the_true_one() -> None:
    true = Pose2D(1.6, 2.3, 0.4)
    localiser = Localiser(room(), seed=1)
    localiser.initialise(Pose2D(1.8, 2.1, 0.5), 0.2, 0.15, ORIGIN)
    hits = hits_at(room(), true)
    for i in range(12):  # small movements to and fro, so that scans are used
        odom = Pose2D(0.0, 0.0, 0.05 * (i % 2))
        localiser.update(odom, hits_at(room(), true @ odom) if i % 2 else hits)
    assert localiser.map_from_odom is not None
    assert localiser.map_from_odom.distance(true) < 0.04
    assert localiser.map_from_odom.yaw == pytest.approx(true.yaw, abs=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_odometry_with_turns_wrong_by_nine_per_cent_is_borne(seed: int) -> None:
    rng, grid = np.random.default_rng(seed), room()
    true, odom = Pose2D(1.0, 0.8, 0.0), ORIGIN
    localiser = Localiser(grid, seed=seed)
    localiser.initialise(true, 0.1, 0.08, odom)
    errors, drifts = [], []
    for i in range(160):  # 8 m: round and round
        step = Pose2D(0.05, 0.0, 0.05 if i > 20 else 0.0)
        true = true @ step
        odom = odom @ Pose2D(1.03 * step.x, 0.0, 0.91 * step.yaw)
        if i % 2:
            localiser.update(odom, hits_at(grid, true, rng))
        assert localiser.map_from_odom is not None
        errors.append((localiser.map_from_odom @ odom).distance(true))
        drifts.append((Pose2D(1.0, 0.8, 0.0) @ odom).distance(true))
    assert np.mean(errors) < 0.06
    assert max(errors) < 0.2
    assert max(drifts) > 0.3  # of the odometry alone


def test_same_seed_gives_the_same_particles() -> None:
    runs = []
    for _ in range(2):
        particles = filter_of(seed=7)
        particles.initialise(Pose2D(1.0, 1.0, 0.0), 0.2, 0.1)
        particles.predict(ORIGIN, Pose2D(0.3, 0.0, 0.1))
        particles.correct(hits_at(room(), Pose2D(1.3, 1.0, 0.1)))
        runs.append(particles.particles)
    assert (runs[0] == runs[1]).all()


def test_covariance_is_that_of_the_spread() -> None:
    particles = filter_of(particles=20_000)
    particles.initialise(Pose2D(3.0, 2.0, math.pi), 0.2, 0.1)
    pose, covariance = particles.estimate()
    assert (pose.x, pose.y, abs(pose.yaw)) == pytest.approx((3.0, 2.0, math.pi), abs=0.01)
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.2, 0.2, 0.1], rel=0.05)


def test_standing_still_uses_no_scans() -> None:
    localiser = Localiser(room())
    localiser.initialise(Pose2D(1.0, 1.0, 0.0), 0.1, 0.1, ORIGIN)
    hits = hits_at(room(), Pose2D(1.0, 1.0, 0.0))
    assert [localiser.update(ORIGIN, hits) for _ in range(3)] == [True, False, False]


def test_pose_is_unknown_before_the_first_pose() -> None:
    localiser = Localiser(room())
    assert not localiser.update(ORIGIN, np.ones((3, 2)))
    assert localiser.map_from_odom is None


def test_scan_without_returns_changes_nothing() -> None:
    particles = filter_of()
    particles.initialise(Pose2D(1.0, 1.0, 0.0), 0.1, 0.1)
    before = particles.particles
    particles.correct(np.zeros((0, 2)))
    assert (particles.particles == before).all()


def test_filter_without_particles_is_refused() -> None:
    with pytest.raises(SettingError, match="0 particles"):
        FilterSettings(particles=0)
