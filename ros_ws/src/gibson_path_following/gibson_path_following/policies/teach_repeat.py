"""Visual teach and repeat: repeats the recorded velocities, and corrects the heading by the column shift against the nodes. No learning."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.localisation.localiser import NodeMatcher
from gibson_path_following.localisation.motions import NS_PER_S, Motion, segments
from gibson_path_following.types import Place, RecordedPath, Velocity, View

_FULL_WEIGHT_SCORE = 0.17
"""Score above ``min_score`` from which on a heading error has full weight."""
_JUMP = 3.0
"""Distance between the places of two views beyond which the heading filter begins anew, nodes."""


@dataclass(frozen=True, slots=True)
class TeachRepeatSettings:
    """Limits and gains."""

    max_linear: float = 0.5
    """Largest speed, m/s."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""
    default_linear: float = 0.3
    """Speed where the path has no velocities, m/s."""
    heading_gain: float = 1.2
    """Yaw rate per radian of heading error, 1/s."""
    filter_gain: float = 0.5
    """Gain of the complementary filter of the heading error: weight of one view against the prediction by the motion."""
    integral_gain: float = 0.4
    """Growth of the integral term per heading error: rad/m per radian and second. It compensates a robot that pulls to one side."""
    max_integral: float = 0.2
    """Largest integral term, rad/m."""
    nodes_ahead: int = 3
    """Number of nodes ahead of the place that a view is matched with, besides the one at the place."""
    preview_time: float = 0.1
    """Time ahead of the place at which recorded velocities are read, seconds."""
    slowdown_error: float = 0.6
    """Heading error at which the robot rotates almost in place, radians."""
    misfit_speed_ratio: float = 0.5
    """Factor on the speed while the view does not fit at its place; the robot stops if that lasts."""
    min_score: float = 0.13
    """Score below which a node has no weight."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("max_linear", 0.01, 10.0),
            ("max_angular", 0.01, 10.0),
            ("default_linear", 0.01, 10.0),
            ("heading_gain", 0.0, 20.0),
            ("filter_gain", 0.01, 1.0),
            ("integral_gain", 0.0, 10.0),
            ("max_integral", 0.0, 5.0),
            ("nodes_ahead", 0, 100),
            ("preview_time", 0.0, 5.0),
            ("slowdown_error", 0.01, math.pi),
            ("misfit_speed_ratio", 0.0, 1.0),
            ("min_score", -1.0, 1.0),
        )


class TeachRepeatPolicy:
    """A ``Policy`` without a network."""

    def __init__(self, path: RecordedPath, settings: TeachRepeatSettings | None = None, nodes: NodeMatcher | None = None) -> None:
        """Computes the recorded headings and velocities.

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
        """(nodes,), float64: heading of each node relative to the first, by the recorded velocities, radians."""
        self._velocities = np.array([self._velocity(part) for part in parts])
        """(nodes - 1, 2), float64: recorded speed, m/s, and yaw rate, rad/s, of each segment."""
        self.reset()

    def reset(self) -> None:
        """Drops all earlier views."""
        self._last: tuple[int, float, float] | None = None
        """Stamp, ns, node index and heading error, radians, of the previous view."""
        self._integral = 0.0
        """Integral term, rad/m, positive to the left."""
        self._weight = 0.0
        """Weight of the newest view's heading error, 0 to 1."""

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the recorded velocity at the place where the command takes effect, corrected by the heading error there."""
        settings = self.settings
        error = self._filter(self.heading_error(view, place), stamp_ns, place)
        index = place.index + place.pending.distance / self._spacing
        error += self._heading(index) - self._heading(place.index) - place.pending.turn
        middles = np.arange(len(self._velocities)) + 0.5
        speed = float(np.interp(index, middles, self._velocities[:, 0]))
        at = index + settings.preview_time * speed / self._spacing
        # Speed and yaw rate have the same factor, so that the curvature stays.
        scale = max(0.1, 1.0 - (error / settings.slowdown_error) ** 2)
        if place.confidence <= 0.0:
            scale *= settings.misfit_speed_ratio
        linear = scale * float(np.interp(at, middles, self._velocities[:, 0]))
        turn = scale * float(np.interp(at, middles, self._velocities[:, 1]))
        angular = turn + settings.heading_gain * error + self._integral * linear
        return Velocity(
            float(np.clip(linear, -settings.max_linear, settings.max_linear)),
            float(np.clip(angular, -settings.max_angular, settings.max_angular)),
        )

    def _filter(self, measured: float | None, stamp_ns: int, place: Place) -> float:
        """Returns the filtered heading error, radians, positive to the left.

        Args:
            measured: heading error by the newest view alone, radians; None = no node fits.
            stamp_ns: stamp of the view, ns.
            place: its place.
        """
        settings = self.settings
        if self._last is None or abs(place.index - self._last[1]) > _JUMP:
            error = measured or 0.0
        else:
            previous_ns, index, error = self._last
            error += self._heading(place.index) - self._heading(index) - place.moved.turn
            if measured is not None:
                error += settings.filter_gain * self._weight * (measured - error)
            seconds = min((stamp_ns - previous_ns) / NS_PER_S, 1.0)
            if place.moved.distance > 0.0 and abs(error) < settings.slowdown_error / 2.0:
                integral = self._integral + settings.integral_gain * error * seconds
                self._integral = min(max(integral, -settings.max_integral), settings.max_integral)
        self._last = stamp_ns, place.index, error
        return error

    def _heading(self, index: float) -> float:
        """Returns the recorded heading at a node index with a fraction, radians."""
        return float(np.interp(index, np.arange(self.nodes.nodes), self._headings))

    def heading_error(self, view: View, place: Place) -> float | None:
        """Returns the turn to the heading of the path, by one view, radians, positive to the left; None = no node fits."""
        first = int(place.index)
        end = min(first + self.settings.nodes_ahead + 1, self.nodes.nodes)
        matches = self.nodes.matcher.match(self.nodes.descriptor(view), first, end)
        errors = matches.turns - (self._headings[first:end] - self._heading(place.index))
        above = np.maximum(matches.scores - self.settings.min_score * self.nodes.score_scale, 0.0)
        weights = above**2
        self._weight = min(1.0, float(above.max()) / _FULL_WEIGHT_SCORE)
        if weights.sum() < 1e-6:
            return None
        return float((weights * errors).sum() / weights.sum())

    def _velocity(self, part: Motion) -> tuple[float, float]:
        """Returns speed, m/s, and yaw rate, rad/s, of a segment, within the limits."""
        settings = self.settings
        if part.duration < 1e-3:
            return settings.default_linear, 0.0
        linear = float(np.clip(part.distance / part.duration, -settings.max_linear, settings.max_linear))
        return linear, float(np.clip(part.turn / part.duration, -settings.max_angular, settings.max_angular))
