"""The response of a velocity to its command: single steps, and linear models with a dead time fitted to the whole drive. Pure.

The line through 20 and 80 % of a step's rise gives the delay (its intersection with the start) and the acceleration, exact if an
acceleration limit makes it a ramp. The models are the usual ones of system identification: K / (T s + 1) and
K w^2 / (s^2 + 2 z w s + w^2), each after a dead time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import bilinear_zpk, lfilter, zpk2tf

from gibson_sim.bags.comparison.recorded_drive import F64
from gibson_sim.bags.comparison.signals import held

_BEFORE, _AFTER = 0.2, 0.8
"""Time for which a command must be constant before and after a step, seconds."""
_MODEL_DT = 0.01
"""Sampling period of a model, seconds."""
_LONGEST_DELAY = 1.0
"""Upper bound of a model's dead time, seconds."""


@dataclass(frozen=True, slots=True)
class Step:
    """The response to one step of the command."""

    time: float
    """Time of the command, seconds."""
    before: float
    after: float
    """Command before and after the step, m/s or rad/s."""
    delay: float
    """Delay of the response, seconds."""
    rise_time: float
    """Rise time from 10 to 90 %, seconds."""
    overshoot: float
    """Overshoot as a fraction of the step height."""
    gain: float
    """Ratio of the settled velocity to the command; NaN after a step to zero."""
    acceleration: float
    """Absolute acceleration, m/s^2 or rad/s^2."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """A linear system of first or second order with a dead time."""

    order: int
    gain: float
    delay: float
    """Dead time, seconds."""
    time_constant: float
    """Time constant T, or 1 / w, seconds."""
    damping: float
    """Damping ratio z; 1 for the first order."""
    rms: float
    """Root mean square of the residuals, m/s or rad/s."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisResponse:
    """The response of forward speed or of yaw rate."""

    steps: tuple[Step, ...]
    models: tuple[LinearModel, ...]
    """The best one first; empty if the command never changes."""

    def median(self, name: str) -> float:
        """Returns the median over the steps of a field of ``Step``; NaN if there are none."""
        values = [value for step in self.steps if math.isfinite(value := float(getattr(step, name)))]
        return float(np.median(values)) if values else math.nan

    @property
    def delay(self) -> float:
        """Delay of the steps, else of the best model, seconds."""
        return self._or_model("delay", "delay")

    @property
    def gain(self) -> float:
        """Ratio of the settled velocity to the command: of the steps, else of the best model."""
        return self._or_model("gain", "gain")

    def _or_model(self, of_step: str, of_model: str) -> float:
        value = self.median(of_step)
        return float(getattr(self.models[0], of_model)) if math.isnan(value) and self.models else value


def axis_response(command_t: F64, command: F64, t: F64, velocity: F64, *, least: float, timeout: float = 0.5) -> AxisResponse:
    """Returns the response of ``velocity`` to ``command``.

    Args:
        command_t: Times of the commands, (N,), seconds.
        command: Commands, (N,), m/s or rad/s.
        t: Times of the velocities, (M,), seconds, increasing.
        velocity: Velocities, (M,), in the unit of the command.
        least: Minimum height of a step, in the unit of the command.
        timeout: Command timeout, seconds.
    """
    steps = tuple(find_steps(command_t, command, t, velocity, least=least, timeout=timeout))
    return AxisResponse(steps, linear_models(command_t, command, t, velocity, least=least, timeout=timeout))


def find_steps(command_t: F64, command: F64, t: F64, velocity: F64, *, least: float, timeout: float = 0.5) -> list[Step]:
    """Returns the responses to all isolated steps of the command; the arguments are those of ``axis_response``."""
    grid = np.arange(t[0], t[-1], _MODEL_DT) if len(t) > 1 else np.zeros(0)
    # Times at which the command in effect changes: new commands, and timeouts.
    commanded = held(command_t, command, grid, timeout)
    changes = np.flatnonzero(np.abs(np.diff(commanded)) > 1e-9)
    responses = []
    for i, row in enumerate(changes):
        begin = float(grid[row + 1])
        quiet_from = float(grid[changes[i - 1] + 1]) if i else float(grid[0])
        quiet_to = float(grid[changes[i + 1] + 1]) if i + 1 < len(changes) else float(grid[-1])
        height = float(commanded[row + 1] - commanded[row])
        if abs(height) >= least and begin - quiet_from >= _BEFORE and quiet_to - begin >= _AFTER:
            exact = _exact_time(command_t, begin)
            step = _measure(exact, quiet_to, float(commanded[row]), float(commanded[row + 1]), t, velocity)
            if step is not None:
                responses.append(step)
    return responses


def _exact_time(command_t: F64, near: float) -> float:
    """Returns the time of the command that caused the change, else that of the grid."""
    row = int(np.searchsorted(command_t, near, side="right")) - 1
    return float(command_t[row]) if row >= 0 and near - command_t[row] <= 2 * _MODEL_DT else near


def _measure(begin: float, end: float, before: float, after: float, t: F64, velocity: F64) -> Step | None:
    """Returns the response to a step; None = the velocity did not follow, or there are too few samples."""
    mask = (t >= begin - _BEFORE) & (t < end)
    when, values = t[mask], velocity[mask]
    early, late = values[when < begin], values[when > end - 0.3 * (end - begin)]
    if len(early) < 2 or len(late) < 3:
        return None
    low, high = float(np.mean(early)), float(np.mean(late))
    height = high - low
    if abs(height) < 0.3 * abs(after - before):
        return None
    part = (values - low) / height
    past_tenth = _crossing(when, part, 0.1, begin)
    past_ninth = _crossing(when, part, 0.9, past_tenth)
    a, b = _crossing(when, part, 0.2, begin), _crossing(when, part, 0.8, begin)
    if not (math.isfinite(past_ninth) and b > a):
        return None
    slope = 0.6 / (b - a)
    noise = float(np.std(late)) / abs(height)
    overshoot = max(0.0, float(part[when >= past_ninth].max()) - 1.0 - 3.0 * noise)
    gain = high / after if abs(after) > 1e-9 else math.nan
    return Step(begin, before, after, a - 0.2 / slope - begin, past_ninth - past_tenth, overshoot, gain, slope * abs(height))


def _crossing(t: F64, part: F64, level: float, start: float) -> float:
    """Returns the time at which the signal crosses ``level`` after ``start``: halfway between first reaching it and last falling below it."""
    after = t >= start
    arrived = np.flatnonzero(after & (part >= max(level, 0.97)))
    rows = np.flatnonzero(after & (part >= level))
    if not len(rows) or rows[0] == 0:
        return math.nan
    first, past = int(rows[0]), int(arrived[0]) if len(arrived) else len(t) - 1
    below = np.flatnonzero(part[first:past] < level)
    last = first + int(below[-1]) + 1 if len(below) else first
    return (_between(t, part, first, level) + _between(t, part, last, level)) / 2


def _between(t: F64, part: F64, i: int, level: float) -> float:
    """Returns the time at which the line from sample ``i - 1`` to ``i`` crosses ``level``."""
    rise = float(part[i] - part[i - 1])
    share = (level - float(part[i - 1])) / rise if rise > 0 else 1.0
    return float(t[i - 1] + min(max(share, 0.0), 1.0) * (t[i] - t[i - 1]))


def linear_models(
    command_t: F64, command: F64, t: F64, velocity: F64, *, least: float, timeout: float = 0.5
) -> tuple[LinearModel, ...]:
    """Returns models of first and second order fitted to the whole drive, the better one first; none if the command never changes.

    The arguments are those of ``axis_response``.
    """
    if len(t) < 20 or len(command_t) < 2:
        return ()
    grid = np.arange(t[0] - _LONGEST_DELAY, t[-1], _MODEL_DT)
    commanded = held(command_t, command, grid, timeout)
    if float(np.ptp(commanded)) < least:
        return ()
    # Times without command and motion carry no information.
    busy = (np.abs(np.interp(t, grid, commanded)) > 0.0) | (np.abs(velocity) > 0.05 * float(np.ptp(commanded)))
    when, target = t[busy], velocity[busy]
    models = [_fitted(order, grid, commanded, when, target) for order in (1, 2)]
    return tuple(sorted(models, key=lambda model: model.rms * (1.0 + 0.01 * model.order)))


def _fitted(order: int, grid: F64, commanded: F64, when: F64, target: F64) -> LinearModel:
    simulate = _first_order if order == 1 else _second_order

    def residuals(p: F64) -> F64:
        return np.asarray(float(p[0]) * np.interp(when - p[1], grid, simulate(commanded, *p[2:])) - target, dtype=np.float64)

    best = None
    for delay in (0.02, 0.15):
        start, low, high = [1.0, delay, 0.15], [-3.0, 0.0, 1e-3], [3.0, _LONGEST_DELAY, 5.0]
        if order == 2:
            start, low, high = [*start, 0.9], [*low, 0.05], [*high, 5.0]
        result = least_squares(residuals, start, bounds=(low, high), x_scale=[1.0, 0.05, 0.1, 0.5][: len(start)], max_nfev=60)
        if best is None or result.cost < best.cost:
            best = result
    assert best is not None
    gain, delay, time_constant, *damping = (float(value) for value in best.x)
    rms = math.sqrt(2.0 * float(best.cost) / max(len(when), 1))
    return LinearModel(order, gain, delay, time_constant, damping[0] if damping else 1.0, rms)


def _first_order(commanded: F64, time_constant: float) -> F64:
    """Returns the response of 1 / (T s + 1) to a held input, exact at the samples."""
    pole = math.exp(-_MODEL_DT / time_constant)
    return np.asarray(lfilter([0.0, 1.0 - pole], [1.0, -pole], commanded), dtype=np.float64)


def _second_order(commanded: F64, period: float, damping: float) -> F64:
    """Returns the response of w^2 / (s^2 + 2 z w s + w^2), w = 1 / period, by the bilinear transform."""
    w = 1.0 / period
    root = np.emath.sqrt(damping**2 - 1.0)
    zeros, poles, gain = bilinear_zpk([], [w * (-damping + root), w * (-damping - root)], w**2, 1.0 / _MODEL_DT)
    b, a = zpk2tf(zeros, poles, gain)
    return np.asarray(lfilter(np.real(b), np.real(a), commanded), dtype=np.float64)
