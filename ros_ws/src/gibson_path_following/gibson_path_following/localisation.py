"""Where on a path a robot is, by its images alone: a belief over the path, moved by the commands that were sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges
from gibson_path_following.lens import ZoomEstimate
from gibson_path_following.matching import Matcher, MatchingSettings
from gibson_path_following.motions import Motion, segments
from gibson_path_following.preprocessing import PreprocessingSettings, Preprocessor
from gibson_path_following.types import Place, RecordedPath, View

F64 = NDArray[np.float64]
_USUAL_FIELD = math.radians(100.0)
"""Field of view that limits of scores hold for, radians."""
_LENS_NODES = 3
"""Nodes before and after a place that views of it are compared with to learn the lens."""
_SUCCESSIVE = MatchingSettings(max_rows=1)
"""How views that follow each other are compared."""


@dataclass(frozen=True, slots=True)
class LocaliserSettings:
    """How the belief moves, what images tell, and when the robot is lost."""

    cells_per_node: int = 4
    """Cells of the belief between two nodes."""
    ratio_mean: float = 0.85
    """Share of the commanded motion that a robot makes on average; wheels slip. What it truly makes is learned on the way."""
    ratio_deviation: float = 0.2
    """Standard deviation of that share."""
    ratio_memory: float = 5.0
    """Commanded nodes that ``ratio_mean`` counts as, against those driven; 0 = it is not learned."""
    drift: float = 0.15
    """Standard deviation of the motion between two views that no command explains, nodes."""
    drift_unknown: float = 3.0
    """The same where no commands are known, nodes."""
    turn_radius: float = 0.3
    """Metres that a radian of a turn counts as."""
    sharpness: float = 28.0
    """Log-likelihood that a difference of 1 in score makes."""
    repeated: float = 0.25
    """Share that a view counts if the robot did not move since the one before: it says the same again."""
    outliers: float = 0.001
    """Likelihood of the worst image against the best: how far one image can move the belief."""
    relocation: float = 0.0001
    """Share of the belief that is spread over the whole path with each view."""
    least_score: float = 0.21
    """Score of the best node near the believed place, below which the images do not fit there: confidence is 0.

    For a field of view of 100 degrees; less for a wider one."""
    weak_score: float = 0.15
    """The same where the robot must be by what it drove, if no other place fits better."""
    rival: float = 0.17
    """Score by which another place may fit better before the images are taken not to fit here."""
    moved_score: float = 0.32
    """Score that a place must have at which a lost robot is found, if it cannot have driven there: many places look a little alike."""
    least_share: float = 0.5
    """Share of the belief within ``fit_radius`` below which the images fit to several places."""
    fit_radius: float = 3.0
    """Nodes around the believed place that count as one place."""
    lost_after: int = 4
    """Views in a row with too little score or share of the belief, after which the robot is lost; twice as many if they are only weak."""
    found_after: int = 2
    """Views in a row with enough of both, after which it is found again."""
    moved_after: int = 4
    """The same where the robot cannot have driven to: it was carried, or it is a place that looks alike."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("cells_per_node", 1, 50),
            ("ratio_mean", 0.1, 2.0),
            ("ratio_deviation", 0.0, 1.0),
            ("ratio_memory", 0.0, 1e6),
            ("repeated", 0.0, 1.0),
            ("drift", 0.001, 100.0),
            ("drift_unknown", 0.001, 100.0),
            ("turn_radius", 0.0, 10.0),
            ("sharpness", 0.1, 1000.0),
            ("outliers", 0.0, 0.99),
            ("relocation", 0.0, 0.5),
            ("least_score", -1.0, 1.0),
            ("weak_score", -1.0, 1.0),
            ("rival", 0.0, 2.0),
            ("moved_score", -1.0, 1.0),
            ("least_share", 0.0, 1.0),
            ("fit_radius", 0.5, 1000.0),
            ("lost_after", 1, 1000),
            ("found_after", 1, 1000),
            ("moved_after", 1, 1000),
        )


class NodeMatcher:
    """The nodes of a path, ready to be compared with views; a localiser and a policy can share one."""

    def __init__(
        self,
        path: RecordedPath,
        preprocessing: PreprocessingSettings | None = None,
        matching: MatchingSettings | None = None,
    ) -> None:
        """Prepares all nodes.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        height, width = path.nodes[0].view[0].shape[:2]
        self.preprocessor = Preprocessor(path.camera, path.hfov, (width, height), preprocessing)
        self._newest: tuple[View, NDArray[np.float32]] | None = None
        self.matcher = Matcher(self.preprocessor, [self.preprocessor.pattern(node.view, 1.0) for node in path.nodes], matching)
        self.nodes = len(path.nodes)
        across = self.preprocessor.columns * self.preprocessor.radians_per_column
        self.score_scale = min(1.0, math.sqrt(_USUAL_FIELD / across))
        """Factor on scores that are limits: the more a panorama shows, the less alike are two of different places."""
        self._lens = ZoomEstimate()
        self._zoom = 1.0
        """Of the lens that takes the views."""

    def reset(self) -> None:
        """Forgets what was learned of the lens."""
        self._lens, self._zoom, self._newest = ZoomEstimate(), 1.0, None

    def pattern(self, view: View) -> NDArray[np.float32]:
        """Returns the normalised panorama of a view, as ``Matcher.match`` takes it; that of the newest view is kept."""
        if self._newest is None or self._newest[0] is not view:
            self._newest = view, self.preprocessor.pattern(view, self._zoom)
        return self._newest[1]

    def learn_lens(self, view: View, index: float, weight: float) -> None:
        """Learns how long the lens is by a view that fits.

        Args:
            view: what the cameras see.
            index: where that is, node with a fraction.
            weight: of the view, 0 to 1; views of one place are worth little.
        """
        if self._lens.is_settled or weight <= 0.0:
            return
        first = max(0, int(index) - _LENS_NODES + 1)
        end = min(first + 2 * _LENS_NODES, self.nodes)
        patterns = (self.preprocessor.pattern(view, math.exp(logarithm)) for logarithm in ZoomEstimate.LOGARITHMS)
        self._lens.add(np.array([self.matcher.match(pattern, first, end).scores.max() for pattern in patterns]), weight)
        self._zoom = self._lens.zoom

    def turn_between(self, before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[float, float]:
        """Returns the turn to the left between two patterns, radians, and how alike they are, a score."""
        found = Matcher(self.preprocessor, [before], _SUCCESSIVE).match(after)
        return -float(found.turns[0]), float(found.scores[0])


class Localiser:
    """A belief over the places of a path. Not thread-safe."""

    def __init__(self, path: RecordedPath, settings: LocaliserSettings | None = None, nodes: NodeMatcher | None = None) -> None:
        """Begins anywhere on the path.

        Args:
            path: the path.
            settings: of the belief; None = the defaults.
            nodes: the nodes of this path, if they are prepared already.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        self.settings = settings or LocaliserSettings()
        self.nodes = nodes or NodeMatcher(path)
        count = len(path.nodes)
        per_node = self.settings.cells_per_node
        self.places: F64 = np.arange((count - 1) * per_node + 1) / per_node
        """Index of each cell of the belief: node, with a fraction."""
        parts = segments(path)
        at = np.minimum(self.places.astype(np.intp), count - 2)
        self._distance = np.array([part.distance for part in parts])[at]
        self._turn = np.array([part.turn for part in parts])[at]
        effort = self._distance**2 + (self.settings.turn_radius * self._turn) ** 2
        self._effort = np.maximum(effort, (0.25 * path.spacing) ** 2)
        self._spacing = path.spacing
        self._belief: F64 = np.full(len(self.places), 1.0 / len(self.places))
        self._doubts = 0
        self._fits = 0
        self._is_lost = True
        self._expected: float | None = None
        """Where the robot is by what it drove since the images last fitted, node with a fraction; None = it was never found."""
        self._driven = self._advanced = 0.0
        """Nodes that were commanded, and nodes that the place moved on."""
        self._before: float | None = None
        """Place of the view before; None = the robot was lost."""
        self.reset()

    def reset(self, index: float | None = None, deviation: float = 2.0) -> None:
        """Forgets all views.

        Args:
            index: where the robot most likely is, node with a fraction; None = anywhere.
            deviation: standard deviation of ``index``, nodes.
        """
        belief = np.ones(len(self.places))
        if index is not None:
            belief = np.exp(-0.5 * ((self.places - index) / max(deviation, 0.1)) ** 2) + 1e-3
        self._belief = belief / belief.sum()
        self.nodes.reset()
        self._doubts, self._fits, self._is_lost = 0, 0, True
        self._expected, self._before = index, None
        self._driven = self._advanced = 0.0

    @property
    def belief(self) -> F64:
        """(cells,) probability of each of ``places``; a copy."""
        return self._belief.copy()

    @property
    def ratio(self) -> float:
        """Share of the commanded motion that the robot makes, as learned so far."""
        settings = self.settings
        if settings.ratio_memory <= 0.0:
            return settings.ratio_mean
        found = (settings.ratio_memory * settings.ratio_mean + self._advanced) / (settings.ratio_memory + self._driven)
        return min(max(found, 0.5 * settings.ratio_mean), 1.5 * settings.ratio_mean)

    def update(self, view: View, motion: Motion | None = None) -> Place:
        """Returns where the robot is when it sees a view.

        Args:
            view: what the cameras see.
            motion: what was commanded since the view before; None = not known.

        Raises:
            ViewError: the images are not those of the path's camera.
        """
        matches = self.nodes.matcher.match(self.nodes.pattern(view))
        steps = self._move(motion)
        step = 0.0
        if self._expected is not None:
            step = float(steps[int(np.abs(self.places - self._expected).argmin())])
            self._expected = min(max(self._expected + self.ratio * step, 0.0), float(self.places[-1]))
        scores = np.interp(self.places, np.arange(len(matches.scores)), matches.scores)
        counts = 1.0
        if motion is not None:
            moved = math.hypot(motion.distance, self.settings.turn_radius * motion.turn) / self._spacing
            counts = min(1.0, self.settings.repeated + 2.0 * moved)
        likelihood = np.exp(self.settings.sharpness * (scores - scores.max())) + self.settings.outliers
        belief = self._belief * likelihood**counts
        if not self._is_lost and self._expected is not None:
            # As long as it is not lost, the robot is where it can have driven to, whatever another place looks like.
            belief = belief * (np.abs(self.places - self._expected) <= 2.0 * self.settings.fit_radius)
        self._belief = belief / belief.sum()
        place = self._place(scores, step)
        if not place.is_lost and place.confidence > 0.0:
            self.nodes.learn_lens(view, place.index, counts if motion is not None else 0.0)
        return place

    def _move(self, motion: Motion | None) -> F64:
        """Moves the belief; returns the nodes that were commanded at each cell."""
        settings = self.settings
        if motion is None:
            step = mean = np.zeros(len(self.places))
            deviation = np.full(len(self.places), settings.drift_unknown)
        else:
            along = motion.distance * self._distance + settings.turn_radius**2 * motion.turn * self._turn
            step = along / self._effort  # nodes, if nothing slips
            mean = self.ratio * step
            deviation = np.hypot(settings.ratio_deviation * step, settings.drift)
        offset = self.places[None, :] - (self.places + mean)[:, None]  # (from, to)
        # A robot that drives past an end of the path is at that end.
        offset[:, -1] = np.maximum(offset[:, -1], 0.0)
        offset[:, 0] = np.minimum(offset[:, 0], 0.0)
        kernel = np.exp(-0.5 * (offset / deviation[:, None]) ** 2) + 1e-12
        kernel /= kernel.sum(axis=1, keepdims=True)
        moved = self._belief @ kernel
        self._belief = (1.0 - settings.relocation) * moved + settings.relocation / len(moved)
        return step

    def _place(self, scores: F64, step: float) -> Place:
        """Returns the place, and whether it can be relied on; ``step``: nodes that were commanded."""
        settings = self.settings
        window = np.ones(2 * settings.cells_per_node + 1)
        # The place is where most of the belief lies within one node, not the mean of two places far apart.
        share = np.convolve(self._belief, window)[settings.cells_per_node : -settings.cells_per_node]
        centre = int(share.argmax())
        low, high = max(0, centre - settings.cells_per_node), centre + settings.cells_per_node + 1
        part = self._belief[low:high]
        index = float((part * self.places[low:high]).sum() / part.sum())
        away = np.abs(self.places - index)
        near = away <= 1.0
        is_expected = self._expected is not None and abs(index - self._expected) <= settings.fit_radius
        best, anywhere, scale = float(scores[near].max()), float(scores.max()), self.nodes.score_scale
        if is_expected or not self._is_lost:
            fits = is_expected and best >= settings.least_score * scale and anywhere - best < settings.rival
            if is_expected and not fits:  # a view with little in it is enough, if no other place is like it
                around = float(scores[away <= settings.fit_radius].max())
                fits = best >= settings.weak_score * scale and around >= anywhere
        else:
            fits = best >= settings.moved_score * scale
        confidence = float(min(1.0, self._belief[near].sum())) if fits else 0.0
        fits = fits and bool(self._belief[away <= settings.fit_radius].sum() >= settings.least_share)
        self._fits = self._fits + 1 if fits else 0
        # Where little can be told apart the robot goes on for a while by what it drove; not where all looks foreign.
        self._doubts = 0 if fits else self._doubts + (1 if is_expected and best >= settings.weak_score * scale else 2)
        enough = settings.found_after if is_expected or self._expected is None else settings.moved_after
        if self._is_lost and self._fits >= enough:
            self._is_lost = False
        elif not self._is_lost and self._doubts >= 2 * settings.lost_after:
            self._is_lost = True
            self._belief = 0.5 * self._belief + 0.5 / len(self._belief)
        if not self._is_lost and fits:
            if is_expected and self._before is not None:
                self._driven += abs(step)
                self._advanced += math.copysign(1.0, step) * (index - self._before)
            self._expected = index
        self._before = index if not self._is_lost else None
        return Place(index, confidence, self._is_lost)
