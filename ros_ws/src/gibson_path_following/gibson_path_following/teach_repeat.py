"""Repeats recorded velocities and corrects the heading by the columns that the view is shifted against the recorded ones. No learning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.localisation import NodeMatcher
from gibson_path_following.motions import Motion, segments
from gibson_path_following.types import Place, RecordedPath, Velocity, View


@dataclass(frozen=True, slots=True)
class TeachRepeatSettings:
    """Limits and gains."""

    max_linear: float = 0.5
    """Largest speed, m/s."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""
    usual_linear: float = 0.3
    """Speed where the path has no recorded velocities, m/s."""
    gain: float = 1.2
    """Yaw rate per radian of heading error, 1/s."""
    ahead: int = 3
    """Nodes from the believed place on that are compared."""
    preview: float = 0.1
    """How far ahead of the believed place recorded velocities are read, seconds."""
    slow_error: float = 0.6
    """Heading error at which the robot turns almost in place, radians."""
    doubtful: float = 0.5
    """Share of the speed while an image does not fit where the robot is believed to be; it stops if that lasts."""
    least_score: float = 0.25
    """Score below which a node tells nothing about the heading."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("usual_linear", 0.01, 10.0),
            ("gain", 0.0, 20.0),
            ("ahead", 0, 100),
            ("preview", 0.0, 5.0),
            ("slow_error", 0.01, math.pi),
            ("doubtful", 0.0, 1.0),
            ("least_score", -1.0, 1.0),
        )


class TeachRepeatPolicy:
    """A ``Policy`` without a network."""

    def __init__(self, path: RecordedPath, settings: TeachRepeatSettings | None = None, nodes: NodeMatcher | None = None) -> None:
        """Prepares the nodes.

        Args:
            path: the path.
            settings: limits and gains; None = the defaults.
            nodes: the nodes of this path, if they are prepared already.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        self.settings = settings or TeachRepeatSettings()
        self.nodes = nodes or NodeMatcher(path)
        parts = segments(path)
        self._spacing = path.spacing
        self._headings: NDArray[np.float64] = np.concatenate([[0.0], np.cumsum([part.turn for part in parts])])
        """Heading at each node against the first, by the recorded velocities, radians."""
        self._velocities = np.array([self._velocity(part) for part in parts])  # (nodes - 1, 2)

    def reset(self) -> None:
        """Forgets nothing: each view is judged alone."""

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the recorded velocity of the place, corrected by the heading error."""
        settings = self.settings
        error = self.heading_error(view, place)
        middles = np.arange(len(self._velocities)) + 0.5
        speed = float(np.interp(place.index, middles, self._velocities[:, 0]))
        at = place.index + settings.preview * speed / self._spacing
        linear = float(np.interp(at, middles, self._velocities[:, 0]))
        angular = float(np.interp(at, middles, self._velocities[:, 1])) + settings.gain * error
        linear *= max(0.1, 1.0 - (error / settings.slow_error) ** 2)
        if place.confidence <= 0.0:
            linear *= settings.doubtful
        return Velocity(
            float(np.clip(linear, -settings.max_linear, settings.max_linear)),
            float(np.clip(angular, -settings.max_angular, settings.max_angular)),
        )

    def heading_error(self, view: View, place: Place) -> float:
        """Returns the radians that the robot must turn to the left to look along the path; 0 if no node fits."""
        first = int(place.index)
        end = min(first + self.settings.ahead + 1, self.nodes.nodes)
        matches = self.nodes.matcher.match(self.nodes.pattern(view), first, end)
        here = float(np.interp(place.index, np.arange(self.nodes.nodes), self._headings))
        errors = matches.turns - (self._headings[first:end] - here)
        weights = np.maximum(matches.scores - self.settings.least_score * self.nodes.score_scale, 0.0) ** 2
        if weights.sum() < 1e-6:
            return 0.0
        return float((weights * errors).sum() / weights.sum())

    def _velocity(self, part: Motion) -> tuple[float, float]:
        settings = self.settings
        if part.duration < 1e-3:
            return settings.usual_linear, 0.0
        linear = float(np.clip(part.distance / part.duration, -settings.max_linear, settings.max_linear))
        return linear, float(np.clip(part.turn / part.duration, -settings.max_angular, settings.max_angular))
