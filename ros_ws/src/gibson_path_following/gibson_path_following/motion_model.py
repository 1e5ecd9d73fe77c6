"""How a robot obeys: after what time, what share of a commanded turn it makes, and how far it pulls to one side. Learned while it drives.

The turn between two views is seen: their columns shift. What was commanded is known. No odometry is needed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.motions import NS_PER_S, CommandLog
from gibson_path_following.types import Step

F64 = NDArray[np.float64]
_LATENCIES = np.arange(0.0, 0.75, 0.1)
"""Times from a command to its motion that are compared, seconds."""
_LATENCY_DEVIATION = 0.25
"""Standard deviation of the latency around the usual one, seconds."""
_PRIOR = np.array([0.9, 0.0])
"""Share of a commanded turn that a robot makes, and turn that each commanded metre adds, rad/m: their means before the first view."""
_PRIOR_DEVIATION = np.array([0.15, 0.05])
_SEEN_DEVIATION = 0.025
"""Standard deviation of a turn that was seen, radians: things that are near shift more than others."""
_OUTLIER = 3.0
"""Standard deviations beyond which a turn that was seen counts no more."""
_KEPT = 0.995
"""Share of what was learned that counts after one more view."""
_LEAST_TURN = math.radians(0.1)
"""Commanded or seen turn below which a view teaches nothing about the latency, radians."""


class MotionModel:
    """Filters for each latency, of which the one that explains the turns best counts."""

    def __init__(self, latency: float = 0.0) -> None:
        """Begins with what robots are usually like.

        Args:
            latency: usual time from a command to its motion, seconds.
        """
        self._usual = latency
        self._latencies = np.unique(np.append(_LATENCIES, latency))
        self._values: F64 = np.zeros((0, 2))
        self._covariances: F64 = np.zeros((0, 2, 2))
        self._likelihoods: F64 = np.zeros(0)
        self.reset()

    def reset(self) -> None:
        """Forgets what was learned."""
        count = len(self._latencies)
        self._values = np.tile(_PRIOR, (count, 1))
        self._covariances = np.tile(np.diag(_PRIOR_DEVIATION**2), (count, 1, 1))
        self._likelihoods = -0.5 * ((self._latencies - self._usual) / _LATENCY_DEVIATION) ** 2

    @property
    def latency(self) -> float:
        """Time from a command to its motion, seconds."""
        return float(self._latencies[self._likelihoods.argmax()])

    @property
    def turn_ratio(self) -> float:
        """Share of a commanded turn that the robot makes."""
        return float(self._values[self._likelihoods.argmax(), 0])

    @property
    def turn_per_metre(self) -> float:
        """Turn to the left that each commanded metre adds, rad/m."""
        return float(self._values[self._likelihoods.argmax(), 1])

    def learn(self, log: CommandLog, start_ns: int, end_ns: int, seen: float) -> None:
        """Takes the turn that was seen between two views.

        Args:
            log: all commands.
            start_ns: stamp of the first view.
            end_ns: stamp of the second one.
            seen: the turn, radians to the left.
        """
        shifts = [round(latency * NS_PER_S) for latency in self._latencies]
        motions = [log.motion(start_ns - shift, end_ns - shift) for shift in shifts]
        told = np.array([(motion.turn, motion.distance) for motion in motions])  # (latencies, 2)
        if max(abs(seen), float(np.abs(told[:, 0]).max())) < _LEAST_TURN and not told[:, 1].any():
            return
        spread = np.einsum("li,lij,lj->l", told, self._covariances, told) + _SEEN_DEVIATION**2
        error = seen - (told * self._values).sum(axis=1)
        squared = np.minimum(error**2 / spread, _OUTLIER**2)
        self._likelihoods = _KEPT * self._likelihoods - 0.5 * (squared + np.log(spread / _SEEN_DEVIATION**2))
        gain = np.einsum("lij,lj->li", self._covariances, told) / spread[:, None]
        limit = _OUTLIER * np.sqrt(spread)
        self._values = self._values + gain * np.clip(error, -limit, limit)[:, None]
        self._covariances = self._covariances - spread[:, None, None] * gain[:, :, None] * gain[:, None, :]
        # What was learned fades: a robot may change.
        self._covariances = _KEPT * self._covariances + (1.0 - _KEPT) * np.diag(_PRIOR_DEVIATION**2)

    def made(self, log: CommandLog, start_ns: int, end_ns: int, ratio: float) -> Step:
        """Returns what the robot makes between two times by the commands whose time has come.

        Args:
            log: all commands.
            start_ns: begin.
            end_ns: end.
            ratio: share of a commanded distance that it makes.
        """
        shift = round(self.latency * NS_PER_S)
        motion = log.motion(start_ns - shift, end_ns - shift)
        return Step(ratio * motion.distance, self.turn_ratio * motion.turn + self.turn_per_metre * motion.distance)

    def pending(self, log: CommandLog, now_ns: int, ratio: float) -> Step:
        """Returns what the robot will still make by commands that were sent before a time.

        Args:
            log: all commands.
            now_ns: the time.
            ratio: share of a commanded distance that it makes.
        """
        return self.made(log, now_ns, now_ns + round(self.latency * NS_PER_S), ratio)
