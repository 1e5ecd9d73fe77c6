"""Functions on sampled signals: zero-order hold, runs of True, rests, speeds. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.comparison.recorded_drive import F64, Commands, ImuSamples, PlanarTrack

STILL_LINEAR, STILL_ANGULAR = 0.01, 0.02
"""Speeds below which the robot counts as standing still, m/s and rad/s."""
_WINDOW = 0.5
"""Window for the spread of an IMU, seconds."""
_CALM = 2.5
"""Maximum spread of an IMU at rest, as a multiple of the minimum spread."""


def held(t: F64, values: F64, when: F64, timeout: float) -> F64:
    """Returns the zero-order hold at ``when`` (M,) of ``values`` (N,) set at ``t`` (N,); 0 before the first and after ``timeout``."""
    rows = np.searchsorted(t, when, side="right") - 1
    valid = rows >= 0
    rows = np.maximum(rows, 0)
    valid &= when - t[rows] <= timeout
    return np.where(valid, values[rows], 0.0)


def stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Returns the index range (first, one past the last) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def rests(
    imu: ImuSamples | None,
    track: PlanarTrack | None,
    commands: Commands | None = None,
    *,
    least: float = 2.0,
    margin: float = 0.5,
) -> list[tuple[float, float]]:
    """Returns the intervals (begin, end), seconds, in which the robot stands still.

    The robot stands still if wheel odometry and commands are zero and the spread of the IMU over half a second is near the minimum of
    the recording.

    Args:
        imu: Samples of the IMU, if any.
        track: Odometry, if any.
        commands: Velocity commands, if any.
        least: Shortest rest without its margins, seconds.
        margin: Time cut off at both ends, seconds.
    """
    clocks = [part.t for part in (imu, track) if part is not None and len(part.t) > 1]
    if not clocks:
        return []
    when = np.arange(min(t[0] for t in clocks), max(t[-1] for t in clocks), 0.05)
    still = np.ones(len(when), dtype=bool)
    if track is not None and len(track.t) > 1:
        linear, angular = speeds(track)
        moving = (np.abs(linear) > STILL_LINEAR) | (np.abs(angular) > STILL_ANGULAR)
        still &= np.interp(when, track.t, moving.astype(np.float64), left=1.0, right=1.0) == 0.0
    if commands is not None and len(commands.t):
        commanded = np.hypot(held(commands.t, commands.linear, when, 0.5), held(commands.t, commands.angular, when, 0.5))
        still &= commanded == 0.0
    if imu is not None and len(imu.t) > 1:
        still &= _calm(imu, when)
    intervals = [(when[a] + margin, when[b - 1] - margin) for a, b in stretches(still)]
    return [(float(a), float(b)) for a, b in intervals if b - a >= least]


def _calm(imu: ImuSamples, when: F64) -> NDArray[np.bool_]:
    """Returns where the spread of all axes is near its minimum, (M,)."""
    calm = np.ones(len(when), dtype=bool)
    first = np.searchsorted(imu.t, when - _WINDOW / 2)
    past = np.maximum(np.searchsorted(imu.t, when + _WINDOW / 2), first + 1)
    count = past - first
    for column in np.concatenate([imu.gyro, imu.accel], axis=1).T:
        centred = column - np.median(column)
        sums = np.concatenate([[0.0], np.cumsum(centred)])
        squares = np.concatenate([[0.0], np.cumsum(centred**2)])
        mean = (sums[past] - sums[first]) / count
        variance = np.maximum((squares[past] - squares[first]) / count - mean**2, 0.0)
        least = float(np.percentile(variance[count > 2], 5)) if (count > 2).any() else 0.0
        calm &= (variance <= _CALM**2 * least + 1e-8) & (count > 2)
    return calm


def speeds(track: PlanarTrack) -> tuple[F64, F64]:
    """Returns forward speed (m/s) and yaw rate (rad/s), each (N,), of the source, else by differentiating the poses."""
    if np.isfinite(track.linear).all() and np.isfinite(track.angular).all():
        return track.linear, track.angular
    if len(track.t) < 3:
        return np.zeros_like(track.t), np.zeros_like(track.t)
    vx, vy = np.gradient(track.x, track.t), np.gradient(track.y, track.t)
    return vx * np.cos(track.yaw) + vy * np.sin(track.yaw), np.gradient(track.yaw, track.t)


def inside(t: F64, spans: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Returns which of the times ``t``, (N,), are in one of the spans."""
    mask = np.zeros(len(t), dtype=bool)
    for begin, end in spans:
        mask |= (t >= begin) & (t <= end)
    return mask
