"""Identifies delay, acceleration limits and gains of a drive by fitting the simulator's drive model to commands and odometry. Pure.

The model is that of ``robots.drives``: after a delay, the base's velocity approaches the command at a limited rate; odometry reports that
velocity times a gain. Delay and gain are applied to the model's output, so only other limits need another simulation of the drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gibson_sim.bags.comparison.recorded_drive import F64, Commands, PlanarTrack
from gibson_sim.bags.comparison.signals import held, inside, speeds, stretches
from gibson_sim.robots.drive_spec import AckermannSpec, DriveSpec
from gibson_sim.robots.drives import PlanarVelocity, make_drive
from gibson_sim.robots.drives.wheel_odometry import OdometryNoise
from gibson_sim.robots.sensor_specs import WheelOdometrySpec
from gibson_sim.types import NS_PER_S

LEAST_LINEAR, LEAST_ANGULAR = 0.05, 0.1
"""Minimum range of commands from which a response is identified, m/s and rad/s."""
_MODEL_HZ = 240
"""Steps of the model per second."""
_EARLIEST, _LONGEST_DELAY = -0.05, 1.0
"""Bounds of the delay, seconds. The clock of the commands moves in ticks, so odometry may seem to precede its command."""
_SEGMENT_S = 1.0
"""Length of the segments of a drive whose errors are assumed to be independent, seconds."""
_STEPS = (5e-4, 1e-3, 1e-3, 1e-3, 1e-3)
"""Step of each parameter for numerical derivatives."""
_SOFT = 0.3
"""Scale of the robust loss, as a fraction of the spread of the speed."""
_SETTLED = 1e-9
"""Change of the velocity in a step below which a drive has settled, m/s + rad/s."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveFit:
    """The identified response of a drive; None = not determined by the recording."""

    delay: Estimate
    """Delay from the recorded command to odometry, seconds."""
    linear_acceleration: Estimate | None
    """Limit of the linear acceleration, m/s^2, in units of the commands."""
    angular_acceleration: Estimate | None
    """Limit of the angular acceleration, rad/s^2."""
    linear_gain: Estimate | None
    """Ratio of the forward speed by odometry to the commanded one."""
    angular_gain: Estimate | None
    linear_rms: float
    """Root mean square of the residuals, m/s."""
    angular_rms: float
    """Root mean square of the residuals, rad/s."""
    t: F64
    """Times of odometry, (N,), seconds."""
    linear: F64
    """Linear velocity of the model, (N,), m/s."""
    angular: F64
    """Angular velocity of the model, (N,), rad/s."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its standard deviation."""

    value: float
    deviation: float


def fit_drive(
    spec: DriveSpec,
    commands: Commands,
    odometry: PlanarTrack,
    *,
    timeout: float = 0.5,
    without: Sequence[tuple[float, float]] = (),
) -> DriveFit | None:
    """Returns the drive that best fits the recording; None = the commands vary too little.

    Args:
        spec: The kind of drive and its maximum speeds; its acceleration limits, delay and slip are not used.
        commands: Recorded velocity commands.
        odometry: Wheel odometry.
        timeout: Command timeout, seconds.
        without: Excluded intervals (begin, end), seconds, in which the robot was stuck.
    """
    problem = _Problem(spec, commands, odometry, timeout, without)
    if not (problem.has_linear or problem.has_angular):
        return None
    return problem.solve()


class _Problem:
    """Residuals of the model over delay, two limits and two gains."""

    def __init__(
        self, spec: DriveSpec, commands: Commands, odometry: PlanarTrack, timeout: float, without: Sequence[tuple[float, float]]
    ) -> None:
        self._t, (self._linear, self._angular) = odometry.t, speeds(odometry)
        # The speed limits of the file do not apply to a robot that was faster in the recording.
        fastest, fastest_turn = (1.05 * float(np.abs(values).max(initial=0.0)) for values in (self._linear, self._angular))
        self._spec = replace(spec, max_linear=max(spec.max_linear, fastest), max_angular=max(spec.max_angular, fastest_turn))
        begin, end = max(commands.t[0], odometry.t[0]) - 0.5, odometry.t[-1]
        self._grid, commanded_linear, commanded_angular = commanded_velocities(commands, begin, end, _MODEL_HZ, timeout)
        self._commanded = commanded_linear, commanded_angular
        self.has_linear = len(self._grid) > 0 and float(np.ptp(commanded_linear)) >= LEAST_LINEAR
        self.has_angular = len(self._grid) > 0 and float(np.ptp(commanded_angular)) >= LEAST_ANGULAR
        self._within = (self._t >= begin + 0.5) & (self._t <= end) & ~inside(self._t, without)
        if len(self._grid):
            commanded = np.abs(np.interp(self._t, self._grid, commanded_linear)) + np.abs(
                np.interp(self._t, self._grid, commanded_angular)
            )
            self._within &= (commanded > 0) | (np.abs(self._linear) > 0.01) | (np.abs(self._angular) > 0.02)
        self._scale = (max(float(np.std(self._linear)), 1e-3), max(float(np.std(self._angular)), 1e-3))
        self._jitter_s = float(np.median(np.diff(self._t))) / math.sqrt(12.0) if len(self._t) > 1 else 0.0
        """Standard deviation of the time of an event between two samples, seconds."""
        self._simulate_cached = lru_cache(maxsize=16)(self._simulate)

    def _simulate(self, linear: float, angular: float) -> tuple[F64, F64]:
        return limited_velocities(with_limits(self._spec, linear, angular), *self._commanded, 1.0 / _MODEL_HZ)

    def _model(self, p: NDArray[np.float64], t: F64) -> tuple[F64, F64]:
        """Returns the velocities of the model at ``t``; p: delay, log limits, gains."""
        linear, angular = self._simulate_cached(math.exp(p[1]), math.exp(p[2]))
        # The velocity of a step holds at its end.
        grid = self._grid + 1.0 / _MODEL_HZ + p[0]
        return p[3] * np.interp(t, grid, linear), p[4] * np.interp(t, grid, angular)

    def _residuals(self, p: NDArray[np.float64]) -> F64:
        t = self._t[self._within]
        linear, angular = self._model(p, t)
        parts = []
        if self.has_linear:
            parts.append((linear - self._linear[self._within]) / self._scale[0])
        if self.has_angular:
            parts.append((angular - self._angular[self._within]) / self._scale[1])
        return np.concatenate(parts)

    def _jacobian(self, p: NDArray[np.float64]) -> F64:
        """Returns the derivatives of the residuals, (R, 5), by central differences."""
        columns = []
        for i, step in enumerate(_STEPS):
            varied = np.zeros(len(p))
            varied[i] = step
            columns.append((self._residuals(p + varied) - self._residuals(p - varied)) / (2.0 * step))
        return np.stack(columns, axis=1)

    def _deviations(self, jacobian: F64, residuals: F64) -> list[float]:
        """Returns the standard deviation of each parameter, infinite if the recording does not determine it.

        Residuals of neighbouring samples are correlated, so samples are not independent measurements: the deviation is that of the
        jackknife over segments of the drive (one Newton step each; B. Efron, "The Jackknife, the Bootstrap and Other Resampling
        Plans", 1982), combined with the uncertainty of the time of events between two samples.

        Args:
            jacobian: (R, 5), with the weights of the loss, as ``least_squares`` returns it.
            residuals: (R,), without weights.
        """
        # With soft_l1 the Jacobian is weighted by the root of (1 + z)^-1.5, scores need (1 + z)^-0.5.
        scores = jacobian * (residuals * (1.0 + (residuals / _SOFT) ** 2) ** 0.25)[:, None]
        shifts = jacobian * (jacobian[:, 0] * self._jitter_s)[:, None]
        norms = np.linalg.norm(jacobian, axis=0)
        known = norms > 1e-6 * max(float(norms.max()), 1e-12)
        jacobian, scores, shifts = jacobian[:, known], scores[:, known], shifts[:, known]
        times = self._t[self._within]
        segment = np.floor((times - times[0]) / _SEGMENT_S).astype(int) if len(times) else np.zeros(0, dtype=int)
        segment = np.tile(segment, len(residuals) // max(len(times), 1))
        variance, number = np.zeros(jacobian.shape[1]), 0
        whole = jacobian.T @ jacobian
        for one in np.unique(segment):
            rows = segment == one
            if not jacobian[rows].any():
                continue
            number += 1
            rest = whole - jacobian[rows].T @ jacobian[rows]
            variance += np.square(_solved(rest, scores[rows].sum(axis=0))) + np.square(_solved(whole, shifts[rows].sum(axis=0)))
        out = np.full(len(norms), np.inf)
        if number > 1:
            out[known] = np.sqrt(variance)
        return [float(value) for value in out]

    def _start(self) -> NDArray[np.float64]:
        """Returns the best point of a coarse grid: a long delay and a slow ramp have nearly the same cost."""
        limits = (0.3, 0.6, 1.2, 2.5, 6.0)
        grid = [
            np.array([delay, math.log(limit), math.log(3.0 * limit), 1.0, 1.0])
            for limit in limits
            for delay in (0.02, 0.06, 0.12, 0.2, 0.3, 0.5)
        ]
        return min(grid, key=lambda p: float(np.abs(self._residuals(p)).sum()))

    def solve(self) -> DriveFit:
        """Returns the best fit."""
        low = [_EARLIEST, math.log(0.02), math.log(0.05), 0.2, 0.2]
        high = [_LONGEST_DELAY, math.log(50.0), math.log(200.0), 3.0, 3.0]
        best = least_squares(
            self._residuals, self._start(), jac=self._jacobian, bounds=(low, high), x_scale=[0.02, 0.2, 0.2, 0.05, 0.05],
            loss="soft_l1", f_scale=_SOFT, max_nfev=60,
        )  # fmt: skip
        deviations = self._deviations(best.jac, best.fun)
        delay, log_linear, log_angular, linear_gain, angular_gain = (float(value) for value in best.x)
        linear, angular = self._model(best.x, self._t)
        is_car = isinstance(self._spec, AckermannSpec)

        def limit(log: float, row: int, is_determined: bool) -> Estimate | None:
            # A ramp shorter than a sample determines no limit.
            known = is_determined and deviations[row] < 0.3 and low[row] + 0.01 < log < high[row] - 0.01
            return Estimate(math.exp(log), math.exp(log) * deviations[row]) if known else None

        return DriveFit(
            delay=Estimate(delay, deviations[0]),
            linear_acceleration=limit(log_linear, 1, self.has_linear),
            angular_acceleration=None if is_car else limit(log_angular, 2, self.has_angular),
            linear_gain=Estimate(linear_gain, deviations[3]) if self.has_linear else None,
            angular_gain=Estimate(angular_gain, deviations[4]) if self.has_angular else None,
            linear_rms=_rms((linear - self._linear)[self._within]),
            angular_rms=_rms((angular - self._angular)[self._within]),
            t=self._t,
            linear=linear,
            angular=angular,
        )


def _solved(matrix: F64, right: F64) -> F64:
    """Solves ``matrix @ x = right`` with a symmetric matrix; x, (N,), is infinite for undetermined unknowns."""
    out = np.full(len(right), np.inf)
    is_determined = np.diag(matrix) > 1e-9 * max(float(np.diag(matrix).max(initial=0.0)), 1e-30)
    scale = np.sqrt(np.diag(matrix)[is_determined])
    normed = matrix[np.ix_(is_determined, is_determined)] / np.outer(scale, scale)
    out[is_determined] = np.linalg.lstsq(normed, right[is_determined] / scale, rcond=1e-9)[0] / scale
    return out


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def commanded_velocities(commands: Commands, begin: float, end: float, step_hz: int, timeout: float) -> tuple[F64, F64, F64]:
    """Returns the times of physics steps, and the commands in effect at their beginning (m/s, rad/s), each (N,).

    Each value is that of ``active_command`` for the last command at that time.
    """
    t = begin + np.arange(max(0, round((end - begin) * step_hz))) / step_hz
    return t, held(commands.t, commands.linear, t, timeout), held(commands.t, commands.angular, t, timeout)


def with_limits(spec: DriveSpec, linear: float, angular: float) -> DriveSpec:
    """Returns the drive with the given acceleration limits (m/s^2, rad/s^2), without delay and slip."""
    if isinstance(spec, AckermannSpec):
        return replace(spec, max_linear_acceleration=linear, command_delay=0.0, slip=0.0)
    return replace(
        spec, max_linear_acceleration=linear, max_angular_acceleration=angular, command_delay=0.0, slip=0.0, turn_slip=0.0
    )


def limited_velocities(spec: DriveSpec, linear: F64, angular: F64, dt: float) -> tuple[F64, F64]:
    """Returns the limited velocity at the end of each step, (N,) each, m/s and rad/s, starting at rest.

    Args:
        spec: The drive.
        linear: (N,), commanded at each step, m/s.
        angular: (N,), rad/s.
        dt: Length of a step, seconds.
    """
    drive = make_drive(spec)
    out = np.zeros((len(linear), 2))
    velocity, settles = drive.velocity, not isinstance(spec, AckermannSpec) and spec.command_delay == 0.0
    # A standing car can still steer, and a delay postpones commands. Any other settled drive stays settled while the command is constant.
    changes = np.concatenate([[0], np.flatnonzero((np.diff(linear) != 0) | (np.diff(angular) != 0)) + 1, [len(linear)]])
    for first, past in zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True):
        target = PlanarVelocity(
            float(linear[first]) if past > first else 0.0, 0.0, float(angular[first]) if past > first else 0.0
        )
        for i in range(first, past):
            drive.targets(target, dt)
            previous, velocity = velocity, drive.velocity
            out[i] = velocity.linear, velocity.angular
            if (
                settles
                and i > first
                and abs(velocity.linear - previous.linear) + abs(velocity.angular - previous.angular) < _SETTLED
            ):
                out[i:past] = out[i]
                break
    return out[:, 0], out[:, 1]


def counted_velocities(spec: DriveSpec, odometry: WheelOdometrySpec, linear: F64, angular: F64, step_hz: int) -> tuple[F64, F64]:
    """Returns the velocities by odometry of a moving base, (N,) each, m/s and rad/s, each over the last step, as published.

    Args:
        spec: The drive; its slip is not used, since encoders count the rolling of the wheels.
        odometry: Errors of odometry.
        linear: (N,), velocity of the base at each step, m/s.
        angular: (N,), rad/s.
        step_hz: Steps per second.
    """
    drive = make_drive(spec)
    noise = OdometryNoise(odometry, "robot", 0, left=drive.encoders_left)
    rows = wheel_rows(spec)
    turns = np.stack([linear, angular], axis=1) @ rows.T / step_hz
    out = np.zeros((len(linear), 2))
    for a, b in stretches(np.any(turns != 0.0, axis=1)):
        for i in range(a, b):
            increments = noise.wheels(turns[i].tolist())
            forward, _, turn = noise.motion(i * NS_PER_S // step_hz, *drive.travel(increments, ()))
            out[i] = forward * step_hz, turn * step_hz
    return out[:, 0], out[:, 1]


def wheel_rows(spec: DriveSpec) -> F64:
    """Returns the (wheels, 2) matrix from base velocity (forward m/s, yaw rad/s) to speeds of the driven wheels, rad/s."""
    if isinstance(spec, AckermannSpec):
        return np.array([[1.0, -spec.wheel_separation / 2], [1.0, spec.wheel_separation / 2]]) / spec.wheel_radius
    free = with_limits(spec, 1e9, 1e9)
    rows = []
    for linear, angular in ((1.0, 0.0), (0.0, 1.0)):
        drive = make_drive(replace(free, max_linear=1.0, max_angular=1.0))
        rows.append(drive.targets(PlanarVelocity(linear, 0.0, angular), 1.0).speeds)
    return np.array(rows).T
