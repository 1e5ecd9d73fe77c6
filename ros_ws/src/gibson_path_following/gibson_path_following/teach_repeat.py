"""Repeats recorded velocities and corrects the heading by the columns that the view is shifted against the recorded ones. No learning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.localisation import NodeMatcher
from gibson_path_following.motions import NS_PER_S, Motion, segments
from gibson_path_following.types import Place, RecordedPath, Velocity, View

_CLEAR = 0.17
"""Score above ``least_score`` from which on a heading error counts in full."""
_JUMP = 3.0
"""Nodes between the places of two views beyond which the second one is a new beginning."""


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
    trust: float = 0.5
    """Share that the heading error of one view counts, against the one that was expected by how the robot turned since the view before."""
    pull_gain: float = 0.4
    """How fast a steady heading error is taken for a robot that pulls to one side: rad/m per radian and second."""
    most_pull: float = 0.2
    """Largest pull to one side that is driven against, rad/m."""
    ahead: int = 3
    """Nodes from the believed place on that are compared."""
    preview: float = 0.1
    """How far ahead of the believed place recorded velocities are read, seconds."""
    slow_error: float = 0.6
    """Heading error at which the robot turns almost in place, radians."""
    doubtful: float = 0.5
    """Share of the speed while an image does not fit where the robot is believed to be; it stops if that lasts."""
    least_score: float = 0.13
    """Score below which a node tells nothing about the heading."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("usual_linear", 0.01, 10.0),
            ("gain", 0.0, 20.0),
            ("trust", 0.01, 1.0),
            ("pull_gain", 0.0, 10.0),
            ("most_pull", 0.0, 5.0),
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
        self.reset()

    def reset(self) -> None:
        """Forgets all earlier views."""
        self._last: tuple[int, float, float] | None = None
        """Stamp, place and heading error of the view before."""
        self._pull = 0.0
        """Turn to the left that each metre needs so that the heading error does not stay, rad/m."""
        self._clarity = 0.0
        """How much the heading error of the newest view counts, 0 to 1."""

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the recorded velocity of the place where the robot will be when it obeys, corrected by its heading error there."""
        settings = self.settings
        error = self._filtered(self.heading_error(view, place), stamp_ns, place)
        index = place.index + place.pending.distance / self._spacing
        error += self._heading(index) - self._heading(place.index) - place.pending.turn
        middles = np.arange(len(self._velocities)) + 0.5
        speed = float(np.interp(index, middles, self._velocities[:, 0]))
        at = index + settings.preview * speed / self._spacing
        # A robot that is slower turns more slowly, too, so that it stays on the path.
        share = max(0.1, 1.0 - (error / settings.slow_error) ** 2)
        if place.confidence <= 0.0:
            share *= settings.doubtful
        linear = share * float(np.interp(at, middles, self._velocities[:, 0]))
        turn = share * float(np.interp(at, middles, self._velocities[:, 1]))
        angular = turn + settings.gain * error + self._pull * linear
        return Velocity(
            float(np.clip(linear, -settings.max_linear, settings.max_linear)),
            float(np.clip(angular, -settings.max_angular, settings.max_angular)),
        )

    def _filtered(self, seen: float | None, stamp_ns: int, place: Place) -> float:
        """Returns the heading error by all views up to this one; ``seen`` is that of this view alone, None = it tells nothing."""
        settings = self.settings
        if self._last is None or abs(place.index - self._last[1]) > _JUMP:
            error = seen or 0.0
        else:
            before_ns, index, error = self._last
            error += self._heading(place.index) - self._heading(index) - place.moved.turn
            if seen is not None:
                error += settings.trust * self._clarity * (seen - error)
            seconds = min((stamp_ns - before_ns) / NS_PER_S, 1.0)
            if place.moved.distance > 0.0 and abs(error) < settings.slow_error / 2.0:
                pull = self._pull + settings.pull_gain * error * seconds
                self._pull = min(max(pull, -settings.most_pull), settings.most_pull)
        self._last = stamp_ns, place.index, error
        return error

    def _heading(self, index: float) -> float:
        return float(np.interp(index, np.arange(self.nodes.nodes), self._headings))

    def heading_error(self, view: View, place: Place) -> float | None:
        """Returns the radians that the robot must turn to the left to look along the path, by one view; None = no node fits."""
        first = int(place.index)
        end = min(first + self.settings.ahead + 1, self.nodes.nodes)
        matches = self.nodes.matcher.match(self.nodes.pattern(view), first, end)
        errors = matches.turns - (self._headings[first:end] - self._heading(place.index))
        above = np.maximum(matches.scores - self.settings.least_score * self.nodes.score_scale, 0.0)
        weights = above**2
        self._clarity = min(1.0, float(above.max()) / _CLEAR)
        if weights.sum() < 1e-6:
            return None
        return float((weights * errors).sum() / weights.sum())

    def _velocity(self, part: Motion) -> tuple[float, float]:
        settings = self.settings
        if part.duration < 1e-3:
            return settings.usual_linear, 0.0
        linear = float(np.clip(part.distance / part.duration, -settings.max_linear, settings.max_linear))
        return linear, float(np.clip(part.turn / part.duration, -settings.max_angular, settings.max_angular))
