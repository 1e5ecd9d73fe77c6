"""Noise and bias of an IMU from the times at which the robot stands. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gibson_sim.bags.comparison.allan import AllanCurve, NoiseModel, allan_curve, noise_model
from gibson_sim.bags.comparison.recording import F64, ImuSamples
from gibson_sim.types import Vec3


@dataclass(frozen=True, slots=True, eq=False)
class ImuNoise:
    """What the rests of one recording say."""

    rest_s: float
    """Seconds of all rests together."""
    rate_hz: float
    gyro: NoiseModel
    """rad/s; all axes together."""
    accel: NoiseModel
    """m/s^2."""
    gyro_curve: AllanCurve
    accel_curve: AllanCurve
    gyro_bias: Vec3
    """Mean of each axis, rad/s."""
    accel_bias: Vec3
    """Mean of each axis without gravity along z, m/s^2: what a tilt of the robot does is in it."""

    @property
    def gyro_bias_rms(self) -> float:
        """Root of the mean square over the axes, rad/s."""
        return float(np.sqrt(np.mean(np.square(self.gyro_bias))))

    @property
    def accel_bias_rms(self) -> float:
        """Root of the mean square over the axes, m/s^2."""
        return float(np.sqrt(np.mean(np.square(self.accel_bias))))


def imu_noise(imu: ImuSamples, rests: list[tuple[float, float]], gravity: float = 9.81) -> ImuNoise | None:
    """Returns the noise of an IMU; None = it never rests long enough.

    Args:
        imu: Its samples.
        rests: (begin, end), seconds: when the robot stands.
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
