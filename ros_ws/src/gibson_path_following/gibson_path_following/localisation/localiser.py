"""Localises a robot on a path by its images alone: a histogram (Markov) filter over the path, predicted by the commanded motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.images.lens import ZoomEstimate
from gibson_path_following.images.preprocessing import PreprocessingSettings, Preprocessor
from gibson_path_following.localisation.matching import Matcher, MatchingSettings
from gibson_path_following.localisation.motions import Motion, has_motion, segments
from gibson_path_following.types import Place, RecordedPath, View

F64 = NDArray[np.float64]
_REFERENCE_FIELD = math.radians(100.0)
"""Field of view that score thresholds are for, radians."""
_ZOOM_NODES = 3
"""Nodes before and after a place that its views are compared with to learn the zoom."""
_SUCCESSIVE = MatchingSettings(max_row_shift=1)
"""Limits of the shift between two successive views."""


@dataclass(frozen=True, slots=True)
class LocaliserSettings:
    """Motion model, measurement likelihood, and when the robot is lost."""

    cells_per_node: int = 4
    """Cells of the belief between two nodes."""
    motion_ratio: float = 0.85
    """Prior mean of the true motion per commanded motion; wheels slip. The ratio of this robot is learned on the way."""
    motion_ratio_deviation: float = 0.2
    """Standard deviation of that ratio."""
    motion_ratio_prior_weight: float = 5.0
    """Weight of ``motion_ratio`` against the driven path, in commanded nodes; 0 = the ratio is not learned."""
    motion_noise: float = 0.15
    """Standard deviation of the motion between two views beyond the commanded one, nodes."""
    motion_noise_without_commands: float = 3.0
    """The same if the commands are unknown, nodes."""
    metres_per_radian: float = 0.3
    """Weight of rotation against translation, m/rad."""
    score_gain: float = 28.0
    """Log-likelihood per score."""
    standstill_weight: float = 0.25
    """Weight of a view if the robot did not move since the previous one: their errors are the same."""
    outlier_likelihood: float = 0.001
    """Least likelihood of a place, relative to the best one: it bounds how far one image can move the belief."""
    relocalisation_probability: float = 0.0001
    """Share of the belief that each view spreads over the whole path (kidnapped robot)."""
    min_score: float = 0.21
    """Score of the best node near the place below which a view does not fit: confidence is 0. For a field of view of 100 degrees; it is scaled
    down for a wider one."""
    weak_min_score: float = 0.15
    """The same where dead reckoning puts the robot, unless another place has a better score."""
    max_rival_margin: float = 0.17
    """Score by which another place may be better before a view does not fit here."""
    kidnapped_min_score: float = 0.32
    """The same for a lost robot at a place that it cannot have driven to: many places look a little alike."""
    min_belief_share: float = 0.5
    """Share of the belief within ``fit_radius`` below which the place is ambiguous."""
    fit_radius: float = 3.0
    """Radius around a place within which nodes count as the same place, nodes."""
    lost_views: int = 4
    """Successive views that do not fit after which the robot is lost; twice as many if their scores are weak only."""
    found_views: int = 2
    """Successive views that fit after which the robot is found again."""
    kidnapped_found_views: int = 4
    """The same at a place that it cannot have driven to: it was carried, or the place looks alike."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("cells_per_node", 1, 50),
            ("motion_ratio", 0.1, 2.0),
            ("motion_ratio_deviation", 0.0, 1.0),
            ("motion_ratio_prior_weight", 0.0, 1e6),
            ("standstill_weight", 0.0, 1.0),
            ("motion_noise", 0.001, 100.0),
            ("motion_noise_without_commands", 0.001, 100.0),
            ("metres_per_radian", 0.0, 10.0),
            ("score_gain", 0.1, 1000.0),
            ("outlier_likelihood", 0.0, 0.99),
            ("relocalisation_probability", 0.0, 0.5),
            ("min_score", -1.0, 1.0),
            ("weak_min_score", -1.0, 1.0),
            ("max_rival_margin", 0.0, 2.0),
            ("kidnapped_min_score", -1.0, 1.0),
            ("min_belief_share", 0.0, 1.0),
            ("fit_radius", 0.5, 1000.0),
            ("lost_views", 1, 1000),
            ("found_views", 1, 1000),
            ("kidnapped_found_views", 1, 1000),
        )


class NodeMatcher:
    """Matches views with the nodes of a path; a localiser and a policy can share one."""

    def __init__(
        self,
        path: RecordedPath,
        preprocessing: PreprocessingSettings | None = None,
        matching: MatchingSettings | None = None,
    ) -> None:
        """Computes the descriptors of all nodes.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        height, width = path.nodes[0].view[0].shape[:2]
        self.preprocessor = Preprocessor(path.camera, path.hfov, (width, height), preprocessing)
        self._newest: tuple[View, NDArray[np.float32]] | None = None
        """Newest view, and its descriptor."""
        descriptors = [self.preprocessor.descriptor(node.view, 1.0) for node in path.nodes]
        self.matcher = Matcher(self.preprocessor, descriptors, matching)
        self.nodes = len(path.nodes)
        """Number of nodes."""
        across = self.preprocessor.columns * self.preprocessor.radians_per_column
        self.score_scale = min(1.0, math.sqrt(_REFERENCE_FIELD / across))
        """Factor on score thresholds: the wider a panorama, the lower the scores of different places."""
        self._estimate = ZoomEstimate()
        self._zoom = 1.0
        """Focal length of the camera, relative to that of the recording."""

    def reset(self) -> None:
        """Drops the learned zoom."""
        self._estimate, self._zoom, self._newest = ZoomEstimate(), 1.0, None

    def descriptor(self, view: View) -> NDArray[np.float32]:
        """Returns the descriptor of a view, (3, rows, columns), float32, as ``Matcher.match`` takes it; that of the newest view is cached."""
        if self._newest is None or self._newest[0] is not view:
            self._newest = view, self.preprocessor.descriptor(view, self._zoom)
        return self._newest[1]

    def learn_zoom(self, view: View, index: float, weight: float) -> None:
        """Learns the zoom of the camera from a view that fits.

        Args:
            view: the images.
            index: node index of its place, with a fraction.
            weight: weight of the view, 0 to 1; views of one place say little more than one.
        """
        if self._estimate.is_settled or weight <= 0.0:
            return
        first = max(0, int(index) - _ZOOM_NODES + 1)
        end = min(first + 2 * _ZOOM_NODES, self.nodes)
        descriptors = (self.preprocessor.descriptor(view, math.exp(log_zoom)) for log_zoom in ZoomEstimate.LOG_ZOOMS)
        scores = np.array([self.matcher.match(descriptor, first, end).scores.max() for descriptor in descriptors])
        self._estimate.add(scores, weight)
        self._zoom = self._estimate.zoom

    def turn_between(self, before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[float, float]:
        """Returns the turn of the robot between two descriptors, radians, positive to the left, and its score."""
        found = Matcher(self.preprocessor, [before], _SUCCESSIVE).match(after)
        return -float(found.turns[0]), float(found.scores[0])


class Localiser:
    """Histogram filter over the places of a path. Not thread-safe."""

    def __init__(self, path: RecordedPath, settings: LocaliserSettings | None = None, nodes: NodeMatcher | None = None) -> None:
        """Begins with a uniform belief.

        Args:
            path: the path.
            settings: of the filter; None = the defaults.
            nodes: the nodes of this path, if they are prepared already.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        self.settings = settings or LocaliserSettings()
        self.nodes = nodes or NodeMatcher(path)
        count = len(path.nodes)
        per_node = self.settings.cells_per_node
        self.indices: F64 = np.arange((count - 1) * per_node + 1) / per_node
        """(cells,), float64: node index of each cell of the belief, with a fraction."""
        parts = segments(path)
        at = np.minimum(self.indices.astype(np.intp), count - 2)
        self._distance = np.array([part.distance for part in parts])[at]
        """(cells,), recorded distance of each cell's segment, metres."""
        self._turn = np.array([part.turn for part in parts])[at]
        """(cells,), recorded turn of each cell's segment, radians."""
        squared = self._distance**2 + (self.settings.metres_per_radian * self._turn) ** 2
        self._squared_length = np.maximum(squared, (0.25 * path.spacing) ** 2)
        """(cells,), squared length of each cell's segment, rotation included, square metres."""
        self._has_motion = has_motion(path)
        """Whether commands predict places: not on a path recorded from images alone."""
        self._spacing = path.spacing
        self._belief: F64 = np.full(len(self.indices), 1.0 / len(self.indices))
        self._misfits = 0
        """Successive views that do not fit, counted double if their scores are not even weak."""
        self._fits = 0
        """Successive views that fit."""
        self._is_lost = True
        self._dead_reckoning: float | None = None
        """Node index by the motion since the last view that fitted; None = there was none."""
        self._commanded = self._advanced = 0.0
        """Motion since the robot was found, nodes: commanded, and by the places."""
        self._previous: float | None = None
        """Node index of the previous view; None = the robot was lost."""
        self.reset()

    def reset(self, index: float | None = None, deviation: float = 2.0) -> None:
        """Drops all views.

        Args:
            index: most likely node index of the robot, with a fraction; None = anywhere.
            deviation: standard deviation of ``index``, nodes.
        """
        belief = np.ones(len(self.indices))
        if index is not None:
            belief = np.exp(-0.5 * ((self.indices - index) / max(deviation, 0.1)) ** 2) + 1e-3
        self._belief = belief / belief.sum()
        self.nodes.reset()
        self._misfits, self._fits, self._is_lost = 0, 0, True
        self._dead_reckoning, self._previous = index, None
        self._commanded = self._advanced = 0.0

    @property
    def belief(self) -> F64:
        """(cells,), float64: probability of each of ``indices``; a copy."""
        return self._belief.copy()

    @property
    def motion_ratio(self) -> float:
        """True motion per commanded motion, as learned so far."""
        settings = self.settings
        weight = settings.motion_ratio_prior_weight
        if weight <= 0.0:
            return settings.motion_ratio
        ratio = (weight * settings.motion_ratio + self._advanced) / (weight + self._commanded)
        return min(max(ratio, 0.5 * settings.motion_ratio), 1.5 * settings.motion_ratio)

    def update(self, view: View, motion: Motion | None = None) -> Place:
        """Predicts and corrects the belief; returns the place of a view.

        Args:
            view: the images.
            motion: commanded motion since the previous view; None = unknown, as on a path without distances and turns.

        Raises:
            ViewError: the images are not those of the path's camera.
        """
        motion = motion if self._has_motion else None
        matches = self.nodes.matcher.match(self.nodes.descriptor(view))
        steps = self._predict(motion)
        step = 0.0
        if self._dead_reckoning is not None:
            step = float(steps[int(np.abs(self.indices - self._dead_reckoning).argmin())])
            self._dead_reckoning = min(max(self._dead_reckoning + self.motion_ratio * step, 0.0), float(self.indices[-1]))
        scores = np.interp(self.indices, np.arange(len(matches.scores)), matches.scores)
        weight = 1.0
        if motion is not None:
            moved = math.hypot(motion.distance, self.settings.metres_per_radian * motion.turn) / self._spacing
            weight = min(1.0, self.settings.standstill_weight + 2.0 * moved)
        likelihood = np.exp(self.settings.score_gain * (scores - scores.max())) + self.settings.outlier_likelihood
        belief = self._belief * likelihood**weight
        if not self._is_lost and self._dead_reckoning is not None:
            # A robot that is not lost is where it can have driven to, even if another place has a better score.
            belief = belief * (np.abs(self.indices - self._dead_reckoning) <= 2.0 * self.settings.fit_radius)
        self._belief = belief / belief.sum()
        place = self._place(scores, step)
        if not place.is_lost and place.confidence > 0.0:
            self.nodes.learn_zoom(view, place.index, weight if motion is not None else 0.0)
        return place

    def _predict(self, motion: Motion | None) -> F64:
        """Predicts the belief; returns (cells,), float64: the commanded motion at each cell, nodes."""
        settings = self.settings
        if motion is None:
            step = mean = np.zeros(len(self.indices))
            deviation = np.full(len(self.indices), settings.motion_noise_without_commands)
        else:
            along = motion.distance * self._distance + settings.metres_per_radian**2 * motion.turn * self._turn
            step = along / self._squared_length  # nodes, without slip
            mean = self.motion_ratio * step
            deviation = np.hypot(settings.motion_ratio_deviation * step, settings.motion_noise)
        offset = self.indices[None, :] - (self.indices + mean)[:, None]  # (from, to)
        # A robot that drives past an end of the path is at that end.
        offset[:, -1] = np.maximum(offset[:, -1], 0.0)
        offset[:, 0] = np.minimum(offset[:, 0], 0.0)
        kernel = np.exp(-0.5 * (offset / deviation[:, None]) ** 2) + 1e-12
        kernel /= kernel.sum(axis=1, keepdims=True)
        predicted = self._belief @ kernel
        spread = settings.relocalisation_probability
        self._belief = (1.0 - spread) * predicted + spread / len(predicted)
        return step

    def _place(self, scores: F64, step: float) -> Place:
        """Returns the place, with its confidence.

        Args:
            scores: (cells,), of the view.
            step: commanded motion since the previous view, nodes.
        """
        settings = self.settings
        window = np.ones(2 * settings.cells_per_node + 1)
        # The place is where most of the belief lies within one node, not the mean of two modes far apart.
        share = np.convolve(self._belief, window)[settings.cells_per_node : -settings.cells_per_node]
        centre = int(share.argmax())
        low, high = max(0, centre - settings.cells_per_node), centre + settings.cells_per_node + 1
        part = self._belief[low:high]
        index = float((part * self.indices[low:high]).sum() / part.sum())
        distance = np.abs(self.indices - index)
        is_near = distance <= 1.0
        is_expected = self._dead_reckoning is not None and abs(index - self._dead_reckoning) <= settings.fit_radius
        best, anywhere, scale = float(scores[is_near].max()), float(scores.max()), self.nodes.score_scale
        if is_expected or not self._is_lost:
            fits = is_expected and best >= settings.min_score * scale and anywhere - best < settings.max_rival_margin
            if is_expected and not fits:  # a view with little texture is enough if no other place has a better score
                around = float(scores[distance <= settings.fit_radius].max())
                fits = best >= settings.weak_min_score * scale and around >= anywhere
        else:
            fits = best >= settings.kidnapped_min_score * scale
        confidence = float(min(1.0, self._belief[is_near].sum())) if fits else 0.0
        fits = fits and bool(self._belief[distance <= settings.fit_radius].sum() >= settings.min_belief_share)
        self._fits = self._fits + 1 if fits else 0
        # Where views say little, dead reckoning goes on for a while; not where the score is below even the weak threshold.
        self._misfits = 0 if fits else self._misfits + (1 if is_expected and best >= settings.weak_min_score * scale else 2)
        enough = settings.found_views if is_expected or self._dead_reckoning is None else settings.kidnapped_found_views
        if self._is_lost and self._fits >= enough:
            self._is_lost = False
        elif not self._is_lost and self._misfits >= 2 * settings.lost_views:
            self._is_lost = True
            self._belief = 0.5 * self._belief + 0.5 / len(self._belief)
        if not self._is_lost and fits:
            if is_expected and self._previous is not None:
                self._commanded += abs(step)
                self._advanced += math.copysign(1.0, step) * (index - self._previous)
            self._dead_reckoning = index
        self._previous = index if not self._is_lost else None
        return Place(index, confidence, self._is_lost)
