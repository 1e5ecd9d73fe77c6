"""Odometry against ground truth: scales, relative errors over distances and turns, random errors. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from gibson_sim.bags.comparison.recorded_drive import F64, PlanarTrack

LENGTHS = (1.0, 2.0, 5.0, 10.0)
"""Lengths of path over which relative errors are measured, metres."""
_STUCK, _STUCK_TURN = 0.05, 0.1
"""Minimum disagreement of wheels and truth within a second for a robot that counts as stuck, m and rad."""
_LEAST_PATH, _LEAST_TURN = 1.0, math.radians(90.0)
"""Motion below which scales are undetermined, m and rad."""
_LEAST_SEGMENTS = 4
"""Segments of a second that must agree for a finite deviation."""
_LEAST_SPREAD = 2e-4
"""Lower bound of the spread of residuals, metres or radians within a second."""


@dataclass(frozen=True, slots=True)
class Scales:
    """Ratios of the motion by odometry to the true motion, over segments of a second, outliers excluded."""

    forward: float
    """Ratio of forward motion; NaN if the robot moved less than 1 m."""
    turn: float
    """Ratio of rotation; NaN if it turned less than 90 degrees."""
    veer: float
    """Additional turn by odometry for each true metre forward, rad/m."""
    forward_deviation: float = 0.0
    """Standard deviations of the three; infinite if too few segments determine them."""
    turn_deviation: float = 0.0
    veer_deviation: float = 0.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Errors of odometry against ground truth."""

    path_m: float
    turned_rad: float
    scales: Scales
    end_error_m: float
    """Final position error, relative to the start."""
    end_error_rad: float
    error_per_m: dict[float, float]
    """Length of path -> mean relative position error over such segments, m/m."""
    turn_per_m: float
    """Mean heading error over segments of the shortest length, rad/m."""
    turn_per_rad: float
    """Mean heading error over quarter turns, rad/rad; NaN if the robot turned less."""
    stuck: tuple[tuple[float, float], ...] = ()
    """Intervals (begin, end), seconds, of large disagreement between wheels and truth: the robot was stuck or pushed, or the truth is wrong."""

    @property
    def stuck_s(self) -> float:
        """Total duration of ``stuck``, seconds."""
        return sum(end - begin for begin, end in self.stuck)


@dataclass(frozen=True, slots=True)
class Alphas:
    """Random errors as in ``WheelOdometrySpec``."""

    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float
    uncertainty: float
    """Relative standard deviation of the estimated standard deviations; 0.1 needs about 50 independent metres and radians."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionSegments:
    """Motions over time segments, by odometry and in truth, in the frame of the base at the start of each."""

    begin: F64
    """Start times, (K,), seconds."""
    forward: F64
    turn: F64
    """Motion by odometry, (K,), m and rad."""
    true_forward: F64
    true_turn: F64
    path: F64
    """Length of the true path, forward or backward, (K,), metres."""
    swept: F64
    """True rotation to either side, (K,), radians."""


def common(odometry: PlanarTrack, truth: PlanarTrack) -> tuple[F64, PlanarTrack, PlanarTrack] | None:
    """Returns the times of the truth within both tracks, and both tracks sampled at these times; None = they do not overlap."""
    t = truth.t[(truth.t >= odometry.t[0]) & (truth.t <= odometry.t[-1])]
    if len(t) < 3:
        return None
    x, y, yaw = odometry.at(t)
    nothing = np.full(len(t), np.nan)
    rows = np.searchsorted(truth.t, t)
    true = PlanarTrack(t, truth.x[rows], truth.y[rows], truth.yaw[rows], nothing, nothing)
    return t, PlanarTrack(t, x, y, yaw, nothing, nothing), true


def motion_segments(odometry: PlanarTrack, truth: PlanarTrack, seconds: float = 1.0) -> MotionSegments | None:
    """Returns the motions over consecutive time segments; None = the tracks do not overlap."""
    overlap = common(odometry, truth)
    if overlap is None:
        return None
    t, odom, true = overlap
    rows = np.searchsorted(t, np.arange(t[0], t[-1] + 1e-9, seconds))
    rows = np.unique(np.minimum(rows, len(t) - 1))
    a, b = rows[:-1], rows[1:]
    steps = np.concatenate([[0.0], np.cumsum(np.abs(_advances(true)))])
    sweeps = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(true.yaw)))])
    advances = [np.concatenate([[0.0], np.cumsum(_advances(track))]) for track in (odom, true)]
    return MotionSegments(
        t[a], advances[0][b] - advances[0][a], odom.yaw[b] - odom.yaw[a], advances[1][b] - advances[1][a], true.yaw[b] - true.yaw[a],
        steps[b] - steps[a], sweeps[b] - sweeps[a],
    )  # fmt: skip


def _advances(track: PlanarTrack) -> F64:
    """Returns the signed forward distance of every step, (N - 1,), metres."""
    yaw = (track.yaw[1:] + track.yaw[:-1]) / 2
    return np.diff(track.x) * np.cos(yaw) + np.diff(track.y) * np.sin(yaw)


def scales(pieces: MotionSegments) -> Scales:
    """Returns the ratios of odometry to the truth; segments in which the robot was stuck or pushed do not count."""
    has_path, has_turns = pieces.path.sum() >= _LEAST_PATH, pieces.swept.sum() >= _LEAST_TURN
    moving = (pieces.path > 0.01) | (pieces.swept > 0.02) | (np.abs(pieces.forward) > 0.01) | (np.abs(pieces.turn) > 0.02)
    distance, angle = pieces.true_forward[moving], pieces.true_turn[moving]
    forward, turn, veer = (math.nan, math.inf), (math.nan, math.inf), (0.0, math.inf)
    if has_path:
        (forward,) = _robust(distance[:, None], pieces.forward[moving])
    if has_turns and has_path:
        turn, veer = _robust(np.stack([angle, distance], axis=1), pieces.turn[moving])
    elif has_turns:
        (turn,) = _robust(angle[:, None], pieces.turn[moving])
    elif has_path:
        (veer,) = _robust(distance[:, None], pieces.turn[moving] - angle)
    return Scales(forward[0], turn[0], veer[0], forward[1], turn[1], veer[1])


def _robust(columns: F64, target: F64) -> list[tuple[float, float]]:
    """Returns the C coefficients of a robust fit of columns (K, C) to ``target`` (K,), and the standard deviation of each.

    Iteratively reweighted least squares, with Huber's weights, then Tukey's; see P. J. Huber, "Robust Statistics" (1981).
    The deviation is that of the jackknife over the rows; it is infinite if less than two thirds of them agree.
    """
    weights: F64 = np.ones(len(target))
    coefficients: F64 = np.zeros(columns.shape[1])
    for iteration in range(30):
        root = np.sqrt(weights)
        coefficients = np.asarray(np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)[0], dtype=np.float64)
        residuals = np.abs(target - columns @ coefficients)
        spread = 1.4826 * float(np.median(residuals)) + _LEAST_SPREAD
        if iteration < 10:
            weights = 1.0 / np.maximum(1.0, residuals / (1.345 * spread))
        else:
            weights = np.maximum(1.0 - (residuals / (4.685 * spread)) ** 2, 0.0) ** 2
    return list(zip(coefficients.tolist(), _jackknife(columns, target - columns @ coefficients, weights), strict=True))


def _jackknife(columns: F64, residuals: F64, weights: F64) -> list[float]:
    """Returns the C standard deviations of weighted least squares by the jackknife over rows."""
    normal_matrix = (columns * weights[:, None]).T @ columns
    variance = np.zeros(columns.shape[1])
    agreeing = np.count_nonzero(weights > 0.1)
    if agreeing < max(_LEAST_SEGMENTS, len(weights) * 2 / 3):
        return [math.inf] * columns.shape[1]
    for row, residual, weight in zip(columns, residuals.tolist(), weights.tolist(), strict=True):
        remaining = normal_matrix - weight * np.outer(row, row)
        if np.linalg.cond(remaining) > 1e9:
            return [math.inf] * columns.shape[1]
        variance += np.square(np.linalg.solve(remaining, weight * residual * row))
    return [float(value) for value in np.sqrt(variance)]


def drift(odometry: PlanarTrack, truth: PlanarTrack) -> Drift | None:
    """Returns the errors of odometry; None = the tracks do not overlap, or the robot did not move."""
    pieces, overlap = motion_segments(odometry, truth), common(odometry, truth)
    if pieces is None or overlap is None:
        return None
    _, odom, true = overlap
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(true.x), np.diff(true.y)))])
    swept = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(true.yaw)))])
    if path[-1] < 0.1 and swept[-1] < 0.1:
        return None
    by_length, turn_per_m = {}, math.nan
    for length in LENGTHS:
        errors, turns = _relative_errors(odom, true, path, length)
        if len(errors):
            by_length[length] = float(errors.mean()) / length
            if math.isnan(turn_per_m):
                turn_per_m = float(turns.mean()) / length
    quarter = math.pi / 2
    _, turns = _relative_errors(odom, true, swept, quarter)
    end = _relative(odom, true, np.array([0]), np.array([len(path) - 1]))
    return Drift(
        float(path[-1]), float(swept[-1]), scales(pieces), float(end[0][0]), float(end[1][0]), by_length, turn_per_m,
        float(turns.mean()) / quarter if len(turns) else math.nan, _stuck(pieces, scales(pieces)),
    )  # fmt: skip


def _stuck(pieces: MotionSegments, ratios: Scales) -> tuple[tuple[float, float], ...]:
    """Returns the intervals (begin, end) of segments whose motions differ by 5 cm or 0.1 rad from those predicted by the scales."""
    forward, turn = (1.0 if math.isnan(scale) else scale for scale in (ratios.forward, ratios.turn))
    is_stuck = np.abs(pieces.forward - forward * pieces.true_forward) > _STUCK
    is_stuck |= np.abs(pieces.turn - turn * pieces.true_turn - ratios.veer * pieces.true_forward) > _STUCK_TURN
    seconds = float(np.median(np.diff(pieces.begin))) if len(pieces.begin) > 1 else 0.0
    return tuple((begin, begin + seconds) for begin in pieces.begin[is_stuck].tolist())


def _relative_errors(odom: PlanarTrack, true: PlanarTrack, travelled: F64, length: float) -> tuple[F64, F64]:
    """Returns errors (m, rad) at the ends of all segments of ``length``, starting at every tenth of it."""
    starts = np.unique(np.searchsorted(travelled, np.arange(0.0, travelled[-1] - length, length / 10)))
    ends = np.searchsorted(travelled, travelled[starts] + length)
    is_inside = ends < len(travelled)
    return _relative(odom, true, starts[is_inside], ends[is_inside])


def _relative(odom: PlanarTrack, true: PlanarTrack, a: NDArray[np.intp], b: NDArray[np.intp]) -> tuple[F64, F64]:
    """Returns (position error m, heading error rad), each (K,), of the motions from poses ``a`` to poses ``b``."""
    ends = []
    for track in (odom, true):
        dx, dy = track.x[b] - track.x[a], track.y[b] - track.y[a]
        cos, sin = np.cos(track.yaw[a]), np.sin(track.yaw[a])
        ends.append((dx * cos + dy * sin, dy * cos - dx * sin, track.yaw[b] - track.yaw[a]))
    (x, y, yaw), (true_x, true_y, true_yaw) = ends
    return np.hypot(x - true_x, y - true_y), np.abs(yaw - true_yaw)


def slip_variance(amount: F64) -> F64:
    """Returns the variance of an error over a motion of ``amount`` units, each with an independent error of variance 1.

    The units begin anywhere, so a segment of one unit overlaps two: d^2 - d^3/3 up to one unit, d - 1/3 beyond.
    """
    return np.where(amount <= 1.0, amount**2 - amount**3 / 3.0, amount - 1.0 / 3.0)


def fit_alphas(odometry: PlanarTrack, truth: PlanarTrack, seconds: float = 4.0) -> Alphas | None:
    """Returns the random errors of odometry by maximum likelihood; None = less than 20 m or 20 rad, or no truth.

    Args:
        odometry: Wheel odometry.
        truth: Must be far more accurate than odometry: its own errors are attributed to the wheels.
        seconds: Length of the segments, whose errors are assumed to be independent.
    """
    pieces = motion_segments(odometry, truth, seconds)
    if pieces is None or pieces.path.sum() < 20.0 or pieces.swept.sum() < 20.0:
        return None
    ratios = scales(pieces)
    turn_error = pieces.turn - ratios.turn * pieces.true_turn - ratios.veer * pieces.true_forward
    forward_error = pieces.forward - ratios.forward * pieces.true_forward
    by_path, by_turn = slip_variance(pieces.path), slip_variance(pieces.swept)
    alpha1, alpha2 = _likeliest(turn_error, by_turn, by_path)
    alpha4, alpha3 = _likeliest(forward_error, by_turn, by_path)
    independent = min(float(pieces.path.sum()), float(pieces.swept.sum()), float(len(pieces.path)))
    return Alphas(alpha1, alpha2, alpha3, alpha4, 1.0 / math.sqrt(2.0 * independent))


def _likeliest(error: F64, a: F64, b: F64) -> tuple[float, float]:
    """Returns the maximum-likelihood (p, q), each 0 or more, for errors (K,) with variances p a + q b."""
    is_moving = (a + b) > 1e-3
    error, a, b = error[is_moving], a[is_moving], b[is_moving]
    floor = 1e-12

    def cost(logs: F64) -> float:
        variance = np.exp(logs[0]) * a + np.exp(logs[1]) * b + floor
        return float(np.sum(np.log(variance) + error**2 / variance))

    start = math.log(max(float(np.sum(error**2)) / max(float(np.sum(a + b)), 1e-9), 1e-11))
    result = minimize(cost, [start, start], method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6})
    p, q = (float(value) for value in np.exp(result.x))
    # A smaller value is indistinguishable from 0.
    return (p if p > 1e-3 * q else 0.0), (q if q > 1e-3 * p else 0.0)
