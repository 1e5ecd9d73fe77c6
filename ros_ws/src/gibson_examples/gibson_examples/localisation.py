"""Monte Carlo localisation on a known map, with a likelihood field. Independent of ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_examples.errors import SettingError
from gibson_examples.geometry import F64, Bools, Pose2D, wrap_angle, wrap_angles
from gibson_examples.grid import Grid, distance_to


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Noise models of odometry and scans."""

    particles: int = 500
    beams: int = 60
    """Beams used per scan."""
    rotation_from_rotation: float = 0.08
    """Standard deviation of a rotation, rad per rad of rotation."""
    rotation_from_translation: float = 0.08
    """Standard deviation of a rotation, rad per metre of translation."""
    translation_from_translation: float = 0.08
    """Standard deviation of a translation, m per metre of translation."""
    translation_from_rotation: float = 0.02
    """Standard deviation of a translation, m per rad of rotation."""
    sigma_hit: float = 0.08
    """Standard deviation of a hit about the surface, metres: noise of the lidar, and the cells of the map."""
    random_share: float = 0.08
    """Likelihood of a beam that hits nothing of the map, relative to an exact hit: people, open doors."""
    beam_weight: float = 0.25
    """Weight of a beam relative to an independent one: errors of neighbouring beams are correlated."""
    min_distance: float = 0.03
    """Translation since the last scan used from which a scan is used, metres, ..."""
    min_angle: float = 0.03
    """... or rotation, radians."""

    def __post_init__(self) -> None:
        if self.particles < 2 or self.beams < 1:
            raise SettingError(f"localisation: {self.particles} particles and {self.beams} beams, must be 2 and 1 or more")
        for name in ("sigma_hit", "random_share", "beam_weight"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingError(f"localisation: {name} is {getattr(self, name):g}, must be a finite number above 0")


class ParticleFilter:
    """Particles (x, y, yaw) in the map frame; every random number comes from ``rng``."""

    def __init__(self, grid: Grid, settings: FilterSettings, rng: np.random.Generator) -> None:
        """Computes the likelihood of a hit in every cell of the map."""
        self._grid, self._settings, self.rng = grid, settings, rng
        s = settings
        distance = distance_to(grid.occupied, grid.resolution)
        likelihood = np.exp(-0.5 * (distance / s.sigma_hit) ** 2) + s.random_share
        # A border of one cell represents everything outside the map.
        self._log_likelihood = np.pad(np.log(likelihood), 1, constant_values=math.log(s.random_share))
        self._particles = np.zeros((s.particles, 3))
        self._weights = np.full(s.particles, 1.0 / s.particles)

    @property
    def particles(self) -> F64:
        """(N, 3): x, y (metres), yaw (radians), map frame. A copy."""
        return self._particles.copy()

    def initialise(self, pose: Pose2D, sigma_xy: float, sigma_yaw: float) -> None:
        """Draws particles around a pose in the map frame; standard deviations in metres and radians."""
        spread = self.rng.standard_normal(self._particles.shape) * (sigma_xy, sigma_xy, sigma_yaw)
        self._particles = np.array([pose.x, pose.y, pose.yaw]) + spread
        self._weights.fill(1.0 / len(self._weights))

    def predict(self, before: Pose2D, after: Pose2D) -> None:
        """Moves the particles by the odometry, with noise: from pose ``before`` to ``after`` in the odom frame."""
        s, n = self._settings, len(self._particles)
        step = before.inverse() @ after
        distance = math.hypot(step.x, step.y)
        first = math.atan2(step.y, step.x) if distance > 1e-3 else 0.0
        if abs(first) > math.pi / 2:  # the robot drove backwards
            first, distance = wrap_angle(first + math.pi), -distance
        second = wrap_angle(step.yaw - first)
        turned = abs(first) + abs(second)
        rotation = math.hypot(s.rotation_from_rotation * turned, s.rotation_from_translation * distance)
        translation = math.hypot(s.translation_from_translation * distance, s.translation_from_rotation * turned)
        turns = np.array([first, second])[:, None] + math.sqrt(0.5) * rotation * self.rng.standard_normal((2, n))
        distances = distance + translation * self.rng.standard_normal(n)
        heading = self._particles[:, 2] + turns[0]
        self._particles[:, 0] += distances * np.cos(heading)
        self._particles[:, 1] += distances * np.sin(heading)
        self._particles[:, 2] = wrap_angles(heading + turns[1])

    def correct(self, hits: F64) -> None:
        """Weights the particles by a scan's hits (B, 2), base frame, metres; resamples if the effective sample size is below half."""
        s = self._settings
        if not len(hits):
            return
        chosen = hits[np.linspace(0, len(hits) - 1, min(s.beams, len(hits))).round().astype(np.intp)]
        log_weights = np.log(self._weights) + s.beam_weight * self._log_likelihoods(chosen)
        weights = np.exp(log_weights - log_weights.max())
        self._weights = np.maximum(weights / weights.sum(), 1e-300)
        if 1.0 / float(self._weights @ self._weights) < 0.5 * len(self._weights):
            self._resample()

    def _log_likelihoods(self, hits: F64) -> F64:
        """Returns (N,): the log likelihood of the hits, for each particle."""
        x, y, yaw = self._particles.T[:, :, None]
        c, s = np.cos(yaw), np.sin(yaw)
        scale = 1.0 / self._grid.resolution
        left, bottom = self._grid.origin
        columns = (x - left + c * hits[:, 0] - s * hits[:, 1]) * scale + 1.0
        rows = (y - bottom + s * hits[:, 0] + c * hits[:, 1]) * scale + 1.0
        height, width = self._log_likelihood.shape
        r, k = np.clip(rows, 0, height - 1).astype(np.intp), np.clip(columns, 0, width - 1).astype(np.intp)
        return np.asarray(self._log_likelihood[r, k].sum(axis=1))

    def _resample(self) -> None:
        """Resamples the particles by their weights with one random number (low-variance sampling)."""
        n = len(self._weights)
        at = (self.rng.random() + np.arange(n)) / n
        chosen = np.minimum(np.searchsorted(np.cumsum(self._weights), at), n - 1)
        self._particles = self._particles[chosen]
        self._weights = np.full(n, 1.0 / n)

    def estimate(self) -> tuple[Pose2D, F64]:
        """Returns the mean pose in the map frame, and its covariance (3, 3): x, y (m^2), yaw (rad^2)."""
        w, p = self._weights, self._particles
        x, y = (float(v) for v in w @ p[:, :2])
        yaw = math.atan2(float(w @ np.sin(p[:, 2])), float(w @ np.cos(p[:, 2])))
        offsets = np.column_stack([p[:, 0] - x, p[:, 1] - y, wrap_angles(p[:, 2] - yaw)])
        return Pose2D(x, y, yaw), np.asarray((w[:, None] * offsets).T @ offsets)


def scan_points(
    ranges: NDArray[np.float32], angle_min: float, angle_increment: float, range_min: float, range_max: float
) -> tuple[F64, Bools]:
    """Returns the ends of the beams of a scan, and which of them are hits.

    Args:
        ranges: (N,), metres; +inf = no return, -inf = too close (REP 117), NaN = a failed measurement.
        angle_min: angle of the first beam, radians, counter-clockwise.
        angle_increment: angle between beams, radians.
        range_min: metres; nearer is no measurement.
        range_max: metres; farther is no return.

    Returns:
        (M, 2), metres, in the plane of the scan, M <= N: beams without a return end at ``range_max``, failed
        measurements are left out; and (M,), whether there was a return.
    """
    r = np.asarray(ranges, dtype=np.float64)
    angles = angle_min + angle_increment * np.arange(len(r))
    no_return = r >= range_max
    measured = (r >= range_min) & ~no_return
    keep = measured | no_return
    length = np.where(measured, r, range_max)[keep]
    return np.column_stack([length * np.cos(angles[keep]), length * np.sin(angles[keep])]), measured[keep]


class Localiser:
    """Estimates the transform from the odom frame to the map, with the particle filter and odometry."""

    def __init__(self, grid: Grid, settings: FilterSettings | None = None, seed: int = 0) -> None:
        self._settings, self._seed = settings or FilterSettings(), seed
        self._filter = ParticleFilter(grid, self._settings, np.random.default_rng(seed))
        self._odom: Pose2D | None = None
        self._map_from_odom: Pose2D | None = None
        self.covariance = np.zeros((3, 3))
        """(3, 3) of the pose at the last scan: x, y (m^2), yaw (rad^2), map frame."""

    @property
    def map_from_odom(self) -> Pose2D | None:
        """T_map_odom; None before the first pose."""
        return self._map_from_odom

    @property
    def particles(self) -> F64:
        """(N, 3): x, y (metres), yaw (radians), map frame. A copy."""
        return self._filter.particles

    def initialise(self, pose: Pose2D, sigma_xy: float, sigma_yaw: float, odom: Pose2D) -> None:
        """Starts at T_map_base ``pose`` with odometry T_odom_base ``odom``; standard deviations in metres and radians.

        The random numbers are those of the seed again: what follows does not depend on what was before.
        """
        self._filter.rng = np.random.default_rng(self._seed)
        self._filter.initialise(pose, sigma_xy, sigma_yaw)
        self._odom = None
        self.covariance = np.diag([sigma_xy**2, sigma_xy**2, sigma_yaw**2])
        self._map_from_odom = pose @ odom.inverse()

    def forget(self) -> None:
        """Returns to the state before the first pose."""
        self._odom = self._map_from_odom = None

    def update(self, odom: Pose2D, hits: F64) -> bool:
        """Processes odometry T_odom_base at the time of a scan and its hits (B, 2), base frame; returns whether the scan was used."""
        s, last = self._settings, self._odom
        if self._map_from_odom is None:
            return False
        if last is not None:
            turned = abs(wrap_angle(odom.yaw - last.yaw))
            if odom.distance(last) < s.min_distance and turned < s.min_angle:
                return False
            self._filter.predict(last, odom)
        self._filter.correct(hits)
        pose, self.covariance = self._filter.estimate()
        self._odom, self._map_from_odom = odom, pose @ odom.inverse()
        return True
