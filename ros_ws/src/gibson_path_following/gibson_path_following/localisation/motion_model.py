"""Learns the response of a robot to commands while it drives: latency, turn ratio, and the turn that it adds to each metre.

The turn between two views is measured by their column shift; the commands are known. No odometry is needed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.localisation.motions import NS_PER_S, CommandLog
from gibson_path_following.types import Step

F64 = NDArray[np.float64]
_LATENCIES = np.arange(0.0, 0.75, 0.1)
"""Candidate latencies, seconds."""
_LATENCY_DEVIATION = 0.25
"""Standard deviation of the prior of the latency, seconds."""
_PRIOR = np.array([0.9, 0.0])
"""Prior means: true turn per commanded turn; turn per commanded metre, rad/m."""
_PRIOR_DEVIATION = np.array([0.15, 0.05])
"""Standard deviations of the prior, same units."""
_MEASUREMENT_DEVIATION = 0.025
"""Standard deviation of a measured turn, radians: near objects shift more than far ones."""
_OUTLIER = 3.0
"""Standard deviations beyond which the innovation is clipped."""
_FORGETTING = 0.995
"""Forgetting factor of one view."""
_MIN_TURN = math.radians(0.1)
"""Commanded and measured turn below which a view says nothing about the latency, radians."""


class MotionModel:
    """A Kalman filter of the two ratios for each candidate latency; the latency of the greatest likelihood counts."""

    def __init__(self, latency: float = 0.0) -> None:
        """Begins with the prior.

        Args:
            latency: prior mean of the latency from a command to its motion, seconds.
        """
        self._prior_latency = latency
        self._latencies = np.unique(np.append(_LATENCIES, latency))
        """(latencies,), seconds."""
        self._values: F64 = np.zeros((0, 2))
        """(latencies, 2), means, units as of ``_PRIOR``."""
        self._covariances: F64 = np.zeros((0, 2, 2))
        """(latencies, 2, 2)."""
        self._log_likelihoods: F64 = np.zeros(0)
        """(latencies,)."""
        self.reset()

    def reset(self) -> None:
        """Goes back to the prior."""
        count = len(self._latencies)
        self._values = np.tile(_PRIOR, (count, 1))
        self._covariances = np.tile(np.diag(_PRIOR_DEVIATION**2), (count, 1, 1))
        self._log_likelihoods = -0.5 * ((self._latencies - self._prior_latency) / _LATENCY_DEVIATION) ** 2

    @property
    def latency(self) -> float:
        """Time from a command to its motion, seconds."""
        return float(self._latencies[self._log_likelihoods.argmax()])

    @property
    def turn_ratio(self) -> float:
        """True turn per commanded turn."""
        return float(self._values[self._log_likelihoods.argmax(), 0])

    @property
    def turn_per_metre(self) -> float:
        """Turn that each commanded metre adds, rad/m, positive to the left."""
        return float(self._values[self._log_likelihoods.argmax(), 1])

    def learn(self, log: CommandLog, start_ns: int, end_ns: int, turn: float) -> None:
        """Learns from the turn between two views.

        Args:
            log: all commands.
            start_ns: stamp of the first view, ns.
            end_ns: stamp of the second view, ns.
            turn: measured turn, radians, positive to the left.
        """
        shifts = [round(latency * NS_PER_S) for latency in self._latencies]
        motions = [log.motion(start_ns - shift, end_ns - shift) for shift in shifts]
        commanded = np.array([(motion.turn, motion.distance) for motion in motions])  # (latencies, 2)
        if max(abs(turn), float(np.abs(commanded[:, 0]).max())) < _MIN_TURN and not commanded[:, 1].any():
            return
        variance = np.einsum("li,lij,lj->l", commanded, self._covariances, commanded) + _MEASUREMENT_DEVIATION**2
        innovation = turn - (commanded * self._values).sum(axis=1)
        squared = np.minimum(innovation**2 / variance, _OUTLIER**2)
        penalty = 0.5 * (squared + np.log(variance / _MEASUREMENT_DEVIATION**2))
        self._log_likelihoods = _FORGETTING * self._log_likelihoods - penalty
        gain = np.einsum("lij,lj->li", self._covariances, commanded) / variance[:, None]
        limit = _OUTLIER * np.sqrt(variance)
        self._values = self._values + gain * np.clip(innovation, -limit, limit)[:, None]
        self._covariances = self._covariances - variance[:, None, None] * gain[:, :, None] * gain[:, None, :]
        # The covariance decays towards the prior: a robot may change.
        self._covariances = _FORGETTING * self._covariances + (1.0 - _FORGETTING) * np.diag(_PRIOR_DEVIATION**2)

    def predict(self, log: CommandLog, start_ns: int, end_ns: int, distance_ratio: float) -> Step:
        """Returns the motion of the robot between two times, by the commands that take effect in between.

        Args:
            log: all commands.
            start_ns: begin, ns.
            end_ns: end, ns.
            distance_ratio: true distance per commanded distance.
        """
        shift = round(self.latency * NS_PER_S)
        motion = log.motion(start_ns - shift, end_ns - shift)
        return Step(distance_ratio * motion.distance, self.turn_ratio * motion.turn + self.turn_per_metre * motion.distance)

    def pending(self, log: CommandLog, now_ns: int, distance_ratio: float) -> Step:
        """Returns the motion after a time, by the commands that were sent before it and have not taken effect.

        Args:
            log: all commands.
            now_ns: the time, ns.
            distance_ratio: true distance per commanded distance.
        """
        return self.predict(log, now_ns, now_ns + round(self.latency * NS_PER_S), distance_ratio)
