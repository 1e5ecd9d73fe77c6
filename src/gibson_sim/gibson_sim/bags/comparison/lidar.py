"""Noise and drop-outs of a planar lidar at rest, and residuals against a map or against another recording at the same poses. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison.recorded_drive import F64, OccupancyMap, PlanarTrack, Scans
from gibson_sim.bags.comparison.signals import inside

RESOLUTIONS = (0.05, 0.02, 0.01, 0.005, 0.0025, 0.002, 0.001, 0.0005, 0.00025)
"""Usual range resolutions of lidars, metres, the coarsest first."""
_MOST_SCANS = 60
"""Maximum number of scans that are compared."""
_SAME_WALL = 0.3
"""Residual beyond which the beam hit another surface, metres."""


@dataclass(frozen=True, slots=True)
class LidarNoise:
    """Noise of a lidar while the robot stands."""

    scans: int
    beams: int
    range_noise: float
    """Standard deviation of ranges without quantisation, metres; NaN = the robot never stands long enough."""
    resolution: float
    """Number of which all ranges are multiples, metres; 0 = none found."""
    dropout: float
    """Fraction of the beams that do not return although both neighbours return from one surface; NaN = too few such beams."""
    dropout_deviation: float = 0.0
    """Standard deviation of ``dropout``: beams through a gap of the scene are missing in every scan."""


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Measured minus expected ranges."""

    values: F64
    """Residuals, (N,), metres."""
    bias: float
    """Median of the residuals, metres."""
    spread: float
    """Standard deviation estimated from the median absolute deviation, metres."""
    outliers: float
    """Fraction more than 0.3 m from the expected range."""
    scans: int

    @staticmethod
    def of(values: F64, scans: int) -> Residuals | None:
        """Returns the statistics; None = fewer than 20 values."""
        near = values[np.abs(values) < _SAME_WALL]
        if len(near) < 20:
            return None
        bias = float(np.median(near))
        spread = 1.4826 * float(np.median(np.abs(near - bias)))
        return Residuals(near, bias, spread, 1.0 - len(near) / len(values), scans)


def lidar_noise(scans: Scans, rests: list[tuple[float, float]]) -> LidarNoise:
    """Returns the noise of beams within each rest, and the drop-outs of the whole recording."""
    squares, freedom, count = 0.0, 0, 0
    for span in rests:
        rows = np.flatnonzero(inside(scans.t, [span]))
        if len(rows) < 5:
            continue
        ranges = scans.ranges[rows]
        count += len(rows)
        good = np.isfinite(ranges)
        steady = good.mean(axis=0) > 0.5
        values = np.where(good, ranges, np.nan)[:, steady]
        number = good[:, steady].sum(axis=0)
        if not values.size:
            continue
        mean = np.nansum(values, axis=0) / number
        deviation = np.nansum((values - mean) ** 2, axis=0)
        # Beams at an edge jump between two surfaces, which is not range noise.
        variance = deviation / np.maximum(number - 1, 1)
        is_usable = (
            (number > 2) & (variance < 25.0 * np.median(variance[number > 2]) + 1e-12) if (number > 2).any() else number > 2
        )
        squares += float(deviation[is_usable].sum())
        freedom += int((number[is_usable] - 1).sum())
    step = resolution_of(scans.ranges)
    noise = math.nan
    if freedom > 20:
        noise = math.sqrt(max(squares / freedom - step**2 / 12.0, 0.0))
    return LidarNoise(count, scans.ranges.shape[1], noise, step, *dropout_of(scans.ranges))


def resolution_of(ranges: F64) -> float:
    """Returns the coarsest of ``RESOLUTIONS`` of which all finite ranges are multiples, metres; 0 = none."""
    values = ranges[np.isfinite(ranges)][:20_000]
    # Single precision represents 10 m to a micrometre.
    return next(
        (step for step in RESOLUTIONS if len(values) > 50 and np.abs(values - np.rint(values / step) * step).max() < 2e-6), 0.0
    )


def dropout_of(ranges: F64) -> tuple[float, float]:
    """Returns the fraction of missing beams among those whose two neighbours' ranges agree within 10 %, and its standard deviation.

    NaN and infinite if there are fewer than 100 such beams.
    """
    left, middle, right = ranges[:, :-2], ranges[:, 1:-1], ranges[:, 2:]
    good = np.isfinite(left) & np.isfinite(right)
    alike = np.zeros_like(good)
    alike[good] = np.abs(left[good] - right[good]) < 0.1 * np.minimum(left[good], right[good])
    total = int(alike.sum())
    if total < 100:
        return math.nan, math.inf
    missed = alike & ~np.isfinite(middle)
    part = float(missed.sum()) / total
    scatter = [missed.sum(axis=axis) - part * alike.sum(axis=axis) for axis in (0, 1)]
    return part, max(float(np.sqrt(np.sum(values**2))) for values in scatter) / total


def scan_poses(scans: Scans, track: PlanarTrack) -> F64:
    """Returns x, y, yaw of the base at every scan, (N, 3), in the frame of the track; NaN outside the track."""
    return np.stack(track.at(scans.t), axis=1)


def residuals_against_map(scans: Scans, track: PlanarTrack, grid: OccupancyMap) -> Residuals | None:
    """Returns measured minus mapped ranges; None = too few beams hit the map. The track must be in the map's frame."""
    poses = scan_poses(scans, track)
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_SCANS)).astype(int))] if len(rows) else rows
    out = []
    for row in rows:
        origin, yaw = _lidar_origin(scans, poses[row])
        expected = cast(grid, origin, yaw + scans.angles, min(scans.range_max, 15.0))
        both = np.isfinite(expected) & np.isfinite(scans.ranges[row])
        out.append(scans.ranges[row][both] - expected[both])
    return Residuals.of(np.concatenate(out), len(rows)) if out else None


def _lidar_origin(scans: Scans, pose: F64) -> tuple[tuple[float, float], float]:
    """Returns x, y (m) of the lidar and the yaw (rad) of the base."""
    x, y, yaw = (float(value) for value in pose)
    dx, dy, _ = scans.mount
    return (x + dx * math.cos(yaw) - dy * math.sin(yaw), y + dx * math.sin(yaw) + dy * math.cos(yaw)), yaw


def cast(grid: OccupancyMap, origin: tuple[float, float], angles: F64, longest: float) -> F64:
    """Returns the distance to the first occupied cell along each angle, (B,), metres, accurate to half a cell; +inf = none."""
    step = grid.resolution / 2
    reach = np.arange(0.0, longest, step) + step / 2
    x = origin[0] + np.cos(angles)[:, None] * reach
    y = origin[1] + np.sin(angles)[:, None] * reach
    columns = np.floor((x - grid.origin[0]) / grid.resolution).astype(int)
    rows = np.floor((y - grid.origin[1]) / grid.resolution).astype(int)
    inside_map = (rows >= 0) & (columns >= 0) & (rows < grid.occupied.shape[0]) & (columns < grid.occupied.shape[1])
    hit = np.zeros_like(inside_map)
    hit[inside_map] = grid.occupied[rows[inside_map], columns[inside_map]]
    first = np.argmax(hit, axis=1)
    # On average, a wall's surface lies in the middle of its cells.
    return np.where(hit.any(axis=1), reach[first] + grid.resolution / 4, np.inf)


def residuals_at_matches(real: Scans, real_poses: F64, sim: Scans, sim_poses: F64, pairs: NDArray[np.intp]) -> Residuals | None:
    """Returns real minus simulated ranges at matched poses; None = too few beams agree.

    Args:
        real: Scans of one recording.
        real_poses: (N, 3), base poses x, y, yaw of its scans.
        sim: Scans of the other one.
        sim_poses: (M, 3), in the same frame.
        pairs: (K, 2), rows of scans at nearly the same pose; the remaining difference of the poses is compensated.
    """
    out = []
    for row, other in (
        pairs[np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), _MOST_SCANS)).astype(int))] if len(pairs) else []
    ):
        angles, ranges = _seen_from(sim, sim_poses[other], sim.ranges[other], real, real_poses[row])
        expected = _at_angles(angles, ranges, real.angles, max(math.radians(3.0), 1.5 * abs(sim.angle_increment)))
        both = np.isfinite(expected) & np.isfinite(real.ranges[row])
        out.append(real.ranges[row][both] - expected[both])
    return Residuals.of(np.concatenate(out), len(out)) if out else None


def _seen_from(scans: Scans, pose: F64, ranges: F64, other: Scans, other_pose: F64) -> tuple[F64, F64]:
    """Returns angles (increasing, base frame) and ranges of a scan's points as seen by a lidar at another pose."""
    (x, y), yaw = _lidar_origin(scans, pose)
    (ox, oy), oyaw = _lidar_origin(other, other_pose)
    good = np.isfinite(ranges)
    directions = yaw + scans.angles[good]
    dx = x + ranges[good] * np.cos(directions) - ox
    dy = y + ranges[good] * np.sin(directions) - oy
    angles = np.mod(np.arctan2(dy, dx) - oyaw, 2 * np.pi)
    order = np.argsort(angles)
    return angles[order], np.hypot(dx, dy)[order]


def _at_angles(angles: F64, ranges: F64, at: F64, widest: float) -> F64:
    """Interpolates ranges at the angles ``at`` between neighbours on one surface, at most ``widest`` radians apart; NaN elsewhere."""
    if len(angles) < 2:
        return np.full(len(at), np.nan)
    turned = np.mod(at, 2 * np.pi)
    right = np.searchsorted(angles, turned)
    left = right - 1
    right = np.where(right == len(angles), 0, right)
    gap = np.mod(angles[right] - angles[left], 2 * np.pi)
    share = np.mod(turned - angles[left], 2 * np.pi) / np.maximum(gap, 1e-12)
    a, b = ranges[left], ranges[right]
    # Neighbouring beams on a surface that is not seen at a grazing angle.
    smooth = (gap < widest) & (np.abs(a - b) < 0.05 * np.minimum(a, b) + 0.02)
    return np.where(smooth, a + share * (b - a), np.nan)
