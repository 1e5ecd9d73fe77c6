"""Noise and bias of an IMU, measured while the robot stands still. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from gibson_sim.bags.comparison.recorded_drive import F64, ImuSamples
from gibson_sim.types import Vec3

FLICKER = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Ratio of the Allan deviation of flicker noise to its bias instability: 0.664."""


@dataclass(frozen=True, slots=True, eq=False)
class ImuNoise:
    """Noise and bias of one recording."""

    rest_s: float
    """Total duration of all rests, seconds."""
    rate_hz: float
    gyro: NoiseModel
    """Noise of the gyroscope, rad/s; all axes together."""
    accel: NoiseModel
    """Noise of the accelerometer, m/s^2; all axes together."""
    gyro_curve: AllanCurve
    accel_curve: AllanCurve
    gyro_bias: Vec3
    """Mean of each axis, rad/s."""
    accel_bias: Vec3
    """Mean of each axis without gravity along z, m/s^2; includes the effect of a tilt of the robot."""

    @property
    def gyro_bias_rms(self) -> float:
        """Root mean square over the axes, rad/s."""
        return float(np.sqrt(np.mean(np.square(self.gyro_bias))))

    @property
    def accel_bias_rms(self) -> float:
        """Root mean square over the axes, m/s^2."""
        return float(np.sqrt(np.mean(np.square(self.accel_bias))))


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of the gyroscope or of the accelerometer; U is the unit of the signal."""

    density: float
    """White noise density, U/sqrt(Hz)."""
    instability: float
    """Bias instability, U: the minimum deviation over 0.664; an upper limit if the recording ends before the curve rises."""
    walk: float
    """Random walk of the bias, U/sqrt(s); 0 = not visible in a recording of this length."""
    reaches: bool
    """Whether the curve rises again within the recording, so that the instability is not just an upper limit."""
    walk_deviation: float = 0.0
    """Standard deviation of the walk, which few averages of the longest times determine."""


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan deviation over averaging times."""

    tau: F64
    """Averaging times, (K,), seconds."""
    deviation: F64
    """Allan deviation, (K,), in the unit of the signal."""
    weights: F64
    """Number of non-overlapping averages in each, (K,)."""


def imu_noise(imu: ImuSamples, rests: list[tuple[float, float]], gravity: float = 9.81) -> ImuNoise | None:
    """Returns the noise of an IMU; None = no rest is long enough.

    Args:
        imu: Samples of the IMU.
        rests: Intervals (begin, end) in which the robot stands still, seconds.
        gravity: m/s^2, along +z of the IMU when the robot is level.
    """
    parts = [(imu.t >= begin) & (imu.t <= end) for begin, end in rests]
    parts = [mask for mask in parts if mask.sum() >= 20]
    if not parts:
        return None
    steps = np.concatenate([np.diff(imu.t[mask]) for mask in parts])
    rate_hz = 1.0 / float(np.mean(steps))
    curves = [allan_curve([values[mask, i] for mask in parts for i in range(3)], rate_hz) for values in (imu.gyro, imu.accel)]
    gyro_curve, accel_curve = curves
    if gyro_curve is None or accel_curve is None:
        return None
    resting = np.logical_or.reduce(parts)
    return ImuNoise(
        rest_s=float(sum(imu.t[mask][-1] - imu.t[mask][0] for mask in parts)),
        rate_hz=rate_hz,
        gyro=noise_model(gyro_curve),
        accel=noise_model(accel_curve),
        gyro_curve=gyro_curve,
        accel_curve=accel_curve,
        gyro_bias=_mean(imu.gyro[resting]),
        accel_bias=_mean(imu.accel[resting] - (0.0, 0.0, gravity)),
    )


def _mean(values: F64) -> Vec3:
    x, y, z = values.mean(axis=0).tolist()
    return (x, y, z)


def noise_model(curve: AllanCurve) -> NoiseModel:
    """Returns the noise that explains a curve: white noise falls as tau^-1/2, a random walk of the bias rises as tau^1/2."""
    variance = curve.deviation**2
    if not variance.any():
        return NoiseModel(0.0, 0.0, 0.0, False)
    # Relative errors of the variance fall with the root of the averages.
    scale = np.sqrt(curve.weights) / np.maximum(variance, variance.max() * 1e-12)
    columns = np.stack([1.0 / curve.tau, np.full_like(curve.tau, FLICKER**2), curve.tau / 3.0], axis=1)
    parts, _ = nnls(columns * scale[:, None], variance * scale)
    walk_share = parts[2] * curve.tau[-1] / 3.0 / variance[-1]
    lowest = int(np.argmin(curve.deviation))
    rises = float(curve.deviation[-1]) > 1.3 * float(curve.deviation[lowest])
    walk = math.sqrt(float(parts[2])) if rises and walk_share > 0.3 else 0.0
    unsure = walk / math.sqrt(2.0 * float(curve.weights[-1]))
    return NoiseModel(math.sqrt(float(parts[0])), float(curve.deviation[lowest]) / FLICKER, walk, rises, unsure)


def allan_curve(segments: Sequence[F64], rate_hz: float) -> AllanCurve | None:
    """Returns the joint curve of several segments and axes of one sensor; None = all are too short.

    Args:
        segments: Signals (N_i,), evenly spaced, e.g. one for each rest and axis.
        rate_hz: Sample rate, Hz.
    """
    longest = max((len(segment) for segment in segments), default=0)
    if longest < 20:
        return None
    # The longest averaging time is a fifth of the longest segment.
    factors = sorted({round(m) for m in np.geomspace(1, longest / 5, 40)})
    variances, weights = np.zeros(len(factors)), np.zeros(len(factors))
    for segment in segments:
        deviation = overlapping_allan(segment, rate_hz, factors)
        count = np.where(np.isfinite(deviation), len(segment) / np.array(factors) - 1.0, 0.0)
        variances += np.where(count > 0, np.nan_to_num(deviation) ** 2 * np.maximum(count, 0.0), 0.0)
        weights += np.maximum(count, 0.0)
    is_reliable = weights >= 4.0
    tau = np.array(factors)[is_reliable] / rate_hz
    return AllanCurve(tau, np.sqrt(variances[is_reliable] / weights[is_reliable]), weights[is_reliable])


def overlapping_allan(values: F64, rate_hz: float, factors: Sequence[int]) -> F64:
    """Returns the overlapping Allan deviation, (K,); NaN if the signal is too short.

    Args:
        values: Samples of a rate, (N,), evenly spaced.
        rate_hz: Sample rate, Hz.
        factors: K averaging factors m, each 1 or more; the averaging time is m / rate_hz, seconds.
    """
    phase = np.concatenate([[0.0], np.cumsum(values - np.mean(values))]) / rate_hz
    out = np.full(len(factors), np.nan)
    for i, m in enumerate(factors):
        if len(phase) > 2 * m:
            second = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
            out[i] = math.sqrt(float(np.mean(second**2)) / 2.0) / (m / rate_hz)
    return out
