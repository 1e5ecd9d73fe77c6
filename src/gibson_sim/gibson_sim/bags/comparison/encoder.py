"""Estimates the resolution of wheel encoders from the velocities of odometry. Pure.

An encoder counts whole ticks, so the speed of a wheel over one step is a multiple of a quantum, which is found as the period of
the speeds. Averaged odometry shows no quantum: then the noise of simulated odometry is matched to the recorded noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from gibson_sim.bags.comparison.identify import DriveFit, Estimate, counted_velocities, wheel_rows, with_limits
from gibson_sim.bags.comparison.recorded_drive import F64, PlanarTrack
from gibson_sim.bags.comparison.signals import inside, speeds, stretches
from gibson_sim.robots.drive_spec import AckermannSpec, DriveSpec
from gibson_sim.robots.sensor_specs import WheelOdometrySpec

_MOST_TICKS, _LEAST_TICKS = 200_000, 16
"""Range of the estimate, ticks per revolution."""
_SETTLE_S = 0.3
"""Time after a change of speed during which odometry is not steady, seconds."""
_LEAST_NOISE = 2e-4
"""Noise below which odometry counts as exact, m/s."""
_CLEAR = 0.9
"""Minimum phase coherence of the speeds, 0 to 1, for a period to be accepted."""
_PERIOD_DEVIATION, _NOISE_DEVIATION = 0.01, 0.05
"""Lower bounds of the relative standard deviation of ticks found as a period, and by their noise."""
_LONGEST_STRETCH, _LEAST_STRETCHES = 40, 4.0
"""Maximum number of samples of a stretch that count, and minimum number of equal stretches that determine a noise."""
_MOST_STEPS = 60.0
"""Maximum number of periods in the highest speed: beyond, the gains are too uncertain to determine the phase."""


def fit_ticks(
    spec: DriveSpec, fit: DriveFit, odometry: PlanarTrack, *, step_hz: int = 240, without: Sequence[tuple[float, float]] = ()
) -> Estimate | None:
    """Returns the ticks per revolution for which simulated odometry is as coarse as the recorded one; None = exact, or never at constant speed.

    A car's steering has encoders too, which are not modelled: None for it.

    Args:
        spec: The drive.
        fit: Drive fitted to the recording.
        odometry: Wheel odometry of the recording.
        step_hz: Step rate of the simulation that the ticks are for.
        without: Excluded intervals (begin, end), seconds, in which the robot was stuck.
    """
    if isinstance(spec, AckermannSpec):
        return None
    measured = odometry_noise(fit, odometry, without)
    if measured is None or measured.linear < _LEAST_NOISE:
        return None
    gains = [1.0 if gain is None else gain.value for gain in (fit.linear_gain, fit.angular_gain)]
    linear, angular = speeds(odometry)
    wheels = (np.stack([linear / gains[0], angular / gains[1]], axis=1) @ wheel_rows(spec).T).reshape(-1)
    step = common_step(wheels, 2.0 * math.pi * step_hz / _MOST_TICKS, 2.0 * math.pi * step_hz / _LEAST_TICKS)
    if step is not None:
        ticks = round(2.0 * math.pi * step_hz / step)
        return Estimate(ticks, _PERIOD_DEVIATION * ticks)
    by_noise = _fit_by_noise(spec, fit, measured.linear, gains, step_hz)
    return None if by_noise is None else Estimate(by_noise, max(measured.deviation, _NOISE_DEVIATION) * by_noise)


def common_step(values: F64, least: float, most: float) -> float | None:
    """Returns the largest number of which all ``values`` (N,) are multiples up to small errors; None = there is none.

    Args:
        values: In any unit; those near 0 are ignored.
        least: Lower bound of the search.
        most: Upper bound of the search.
    """
    largest = float(np.abs(values).max(initial=0.0))
    moving = values[np.abs(values) > 0.05 * largest]
    least, most = max(least, largest / _MOST_STEPS), min(most, largest)
    if len(moving) < 50 or least >= most:
        return None
    # The phases of the largest value at neighbouring grid points differ by a tenth of a turn.
    turns = np.arange(largest / most, largest / least, 0.1)
    clear = np.array([abs(np.mean(np.exp(2j * np.pi * moving * (turn / largest)))) for turn in turns])
    peaks = np.flatnonzero(clear > _CLEAR * max(_CLEAR, float(clear.max())))
    if not len(peaks) or float(clear.max()) < _CLEAR:
        return None
    first = int(peaks[0])
    near = np.linspace(turns[first] - 0.15, turns[first] + 0.25, 81)
    best = near[int(np.argmax([abs(np.mean(np.exp(2j * np.pi * moving * (turn / largest)))) for turn in near]))]
    return largest / float(best)


@dataclass(frozen=True, slots=True)
class SpeedNoise:
    """Standard deviations of odometry's velocities while the model moves at constant speed, slow changes excluded."""

    linear: float
    """Deviation of the linear velocity, m/s."""
    angular: float
    """Deviation of the angular velocity, rad/s."""
    deviation: float
    """Relative standard deviation of ``linear``, from the scatter over stretches; infinite for few: quantisation noise depends on speed."""


def odometry_noise(fit: DriveFit, odometry: PlanarTrack, without: Sequence[tuple[float, float]] = ()) -> SpeedNoise | None:
    """Returns the noise of odometry outside ``without``, (begin, end) seconds; None = the model is never at constant speed.

    It is computed from differences of neighbouring samples: slow changes are slip or a wrong model, not quantisation noise.
    """
    linear, angular = speeds(odometry)
    even = _even(fit) & ~inside(fit.t, without)
    squares, freedom = [], []
    for first, past in stretches(even):
        if past - first >= 8:
            # A long stretch at one speed carries no more information than a short one.
            count = min(past - first - 1, _LONGEST_STRETCH)
            freedom.append(count)
            squares.append([float(np.mean(np.diff(values[first:past]) ** 2)) / 2.0 * count for values in (linear, angular)])
    total = sum(freedom)
    if total < 30:
        return None
    variances = np.sum(squares, axis=0) / total
    scatter = np.array([stretch[0] - variances[0] * count for stretch, count in zip(squares, freedom, strict=True)]) / total
    deviation = 0.5 * float(np.sqrt(np.sum(scatter**2))) / max(float(variances[0]), 1e-30)
    speeds_seen = total**2 / float(np.sum(np.square(freedom)))
    deviation = max(deviation, 0.5 / math.sqrt(speeds_seen)) if speeds_seen >= _LEAST_STRETCHES else math.inf
    first_std, second_std = np.sqrt(variances).tolist()
    return SpeedNoise(first_std, second_std, deviation)


def _even(fit: DriveFit) -> NDArray[np.bool_]:
    """Returns a mask of the samples at which the model moves at a settled speed, (N,)."""
    change = np.abs(np.gradient(fit.linear, fit.t)) * 0.2 + np.abs(np.gradient(fit.angular, fit.t)) * 0.05 > 1e-4
    last = np.maximum.accumulate(np.where(change, fit.t, -np.inf))
    return (fit.t - last > _SETTLE_S) & ~change & (np.abs(fit.linear) + np.abs(fit.angular) > 0.02)


def _fit_by_noise(spec: DriveSpec, fit: DriveFit, measured: float, gains: list[float], step_hz: int) -> int | None:
    """Returns the ticks per revolution for which simulated odometry has the ``measured`` noise, m/s; None = no such value."""
    begin, end = float(fit.t[0]), float(fit.t[-1])
    t = begin + np.arange(round((end - begin) * step_hz)) / step_hz
    even = np.interp(t, fit.t, _even(fit).astype(np.float64)) > 0.0
    linear = np.where(even, np.interp(t, fit.t, fit.linear) / gains[0], 0.0)
    angular = np.where(even, np.interp(t, fit.t, fit.angular) / gains[1], 0.0)
    free = with_limits(spec, 1e9, 1e9)
    stamps = np.rint((fit.t - begin) * step_hz).astype(int) - 1

    def noise(log_ticks: float) -> float:
        errors = WheelOdometrySpec(encoder_ticks=round(math.exp(log_ticks)))
        counted = counted_velocities(free, errors, linear, angular, step_hz)
        rows = np.clip(stamps, 0, len(t) - 1)
        simulated = PlanarTrack(fit.t, fit.t, fit.t, fit.t, counted[0][rows] * gains[0], counted[1][rows] * gains[1])
        result = odometry_noise(fit, simulated)
        return -12.0 if result is None else math.log(max(result.linear, 1e-9)) - math.log(measured)

    low, high = math.log(_LEAST_TICKS), math.log(_MOST_TICKS)
    if noise(high) > 0.0 or noise(low) < 0.0:
        return None
    return round(math.exp(float(brentq(noise, low, high, xtol=5e-3))))
