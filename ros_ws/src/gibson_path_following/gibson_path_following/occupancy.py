"""What stands around a robot that follows a path: a map of log odds in the frame of the path, which remembers what left the view.

The map is a square that goes with the robot. Each view tells, for some directions, how probable it is that the first thing stands at each
distance; what lies before that is free, what lies behind is hidden. Where the recorded path leads, the floor was free once, and counts as
free until things are seen there. What is not seen again is forgotten slowly. Pure geometry: no ROS, no network.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import check_ranges

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
_RANGE_STEP = 0.025
"""Step of the distances for which evidence is computed, metres."""


@dataclass(frozen=True, slots=True)
class OccupancySettings:
    """The size of the map, and what its cells learn from a view."""

    cell: float = 0.05
    """Edge of a cell, metres."""
    size: float = 6.0
    """Edge of the map, metres; the robot is in its middle."""
    density: float = 1.0
    """Things per metre of a line of sight that are to be expected. With less, every doubt of the network counts as a thing."""
    depth: float = 0.1
    """Depth that a thing has at least, metres."""
    weight: float = 0.4
    """Share of a view's evidence that counts: views that follow each other are wrong alike."""
    nearest: float = 0.35
    """Distance below which a view is not believed, metres. The floor is below the image there; what seems so near is mostly an image with little
    in it, and what truly is was seen before from farther off."""
    blind: float = 0.55
    """Distance up to which a view does not tell that the floor is free, metres: it is below the image there, and so is a low thing. What was seen
    before stays in the map."""
    most_occupied: float = 2.5
    """Largest evidence of one view for a thing, log odds before the weight."""
    most_free: float = 2.0
    """Largest evidence of one view for free floor, log odds before the weight."""
    limit: float = 5.0
    """Largest evidence for a thing that a cell keeps, log odds."""
    free_limit: float = 1.5
    """Largest evidence for free floor that a cell keeps, log odds: what stands there next, or is seen there only from near, must soon
    outweigh it."""
    path_width: float = 0.35
    """Distance from the recorded path within which the floor was free once, metres."""
    path_prior: float = -2.0
    """Log odds of a cell there of which nothing is known."""
    discount: float = 2.5
    """Factor on what the recorded images tell of things there, which is wrong, and is taken from what later views tell: of later views there
    are more."""
    occupied: float = 0.8
    """Log odds from which a cell is occupied."""
    memory: float = 40.0
    """Time in which evidence fades to 1/e, seconds."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("cell", 0.01, 0.5),
            ("size", 1.0, 50.0),
            ("density", 0.001, 10.0),
            ("depth", 0.0, 2.0),
            ("weight", 0.01, 1.0),
            ("nearest", 0.0, 5.0),
            ("blind", 0.0, 5.0),
            ("most_occupied", 0.0, 20.0),
            ("most_free", 0.0, 20.0),
            ("limit", 0.1, 50.0),
            ("free_limit", 0.1, 50.0),
            ("path_width", 0.0, 5.0),
            ("path_prior", -20.0, 0.0),
            ("discount", 0.0, 10.0),
            ("occupied", -20.0, 20.0),
            ("memory", 0.1, 1e6),
        )


class OccupancyMap:
    """What stands around the robot, in the frame of its path."""

    def __init__(self, path: F64, settings: OccupancySettings | None = None) -> None:
        """Knows nothing but the path.

        Args:
            path: (N, 2), points of the recorded path, metres.
            settings: None = the defaults.
        """
        self.settings = settings or OccupancySettings()
        self._path = path
        self._count = max(3, round(self.settings.size / self.settings.cell))
        self._corner: tuple[int, int] | None = None
        """Cell of the frame of the path, x and y, that is the first one of the map; None = it is nowhere yet."""
        self._evidence: F32 = np.zeros((self._count, self._count), np.float32)
        self._prior: F32 = np.zeros_like(self._evidence)
        self._recorded: list[tuple[F64, F64, F32]] = []
        """Of each recorded image: pose of its camera, directions, evidence by direction and distance."""
        self._away: F32 | None = None
        """Distance of each cell from the nearest occupied one, metres; None = to be computed."""

    def clear(self) -> None:
        """Forgets everything but the path."""
        self._corner, self._away = None, None
        self._evidence[:] = 0.0

    def centre(self, x: float, y: float) -> None:
        """Moves the map to a place of the robot, metres; what leaves it is forgotten."""
        cell, count = self.settings.cell, self._count
        corner = math.floor(x / cell) - count // 2, math.floor(y / cell) - count // 2
        if self._corner is not None and max(abs(corner[0] - self._corner[0]), abs(corner[1] - self._corner[1])) < count // 8:
            return
        kept = np.zeros_like(self._evidence)
        if self._corner is not None:
            shift = corner[0] - self._corner[0], corner[1] - self._corner[1]
            to, frm = zip(*(_overlap(each, count) for each in shift), strict=True)
            kept[to] = self._evidence[frm]
        self._corner, self._evidence, self._away = corner, kept, None
        self._prior = self._path_prior()

    def fade(self, seconds: float) -> None:
        """Forgets a little, for a time that has passed."""
        self._evidence *= math.exp(-max(0.0, seconds) / self.settings.memory)
        self._away = None

    def see(self, camera: F64, bearings: F64, edges: F64, hit: F64) -> None:
        """Learns from a view.

        Args:
            camera: (3,), x, y, yaw of the camera in the frame of the path, metres and radians.
            bearings: (D,), middles of the directions, radians, positive to the left, left first: those of equal strips of a pinhole image.
            edges: (B + 1,), edges of the bins of distance from the camera, metres, from 0.
            hit: (D, B + 1), probability that the first thing stands in each bin; the last: farther than all.
        """
        if self._corner is None:
            self.centre(float(camera[0]), float(camera[1]))
        cells, told = self._told(camera, bearings, self._evidence_by_distance(edges, hit))
        self._evidence[cells] = np.clip(self._evidence[cells] + told, -self.settings.free_limit, self.settings.limit)
        self._away = None

    def expect(self, camera: F64, bearings: F64, edges: F64, hit: F64) -> None:
        """Learns from a recorded image: what it shows on the path is nothing that stands there. For the arguments see ``see``."""
        self._recorded.append((camera, bearings, self._evidence_by_distance(edges, hit)))
        self._corner = None

    def _told(self, camera: F64, bearings: F64, table: F32) -> tuple[NDArray[np.bool_], F32]:
        """Returns the cells (n, n) that a camera sees, and what a table (D, R) by direction and distance tells of them, (K,)."""
        count = self._count
        cells = (np.arange(count) + 0.5) * self.settings.cell
        assert self._corner is not None
        dx = self._corner[0] * self.settings.cell + cells - camera[0]
        dy = self._corner[1] * self.settings.cell + cells - camera[1]
        c, s = math.cos(camera[2]), math.sin(camera[2])
        ahead, left = c * dx[:, None] + s * dy[None, :], c * dy[None, :] - s * dx[:, None]
        row = (np.hypot(ahead, left) / _RANGE_STEP).astype(np.int64)
        half = _half_width(bearings)
        with np.errstate(divide="ignore", invalid="ignore"):
            strip = np.floor((1.0 - left / ahead / half) * 0.5 * len(bearings))
        in_view = (ahead > 0.02) & (strip >= 0) & (strip < len(bearings)) & (row < table.shape[1])
        return in_view, table[strip[in_view].astype(np.int64), row[in_view]]

    @property
    def log_odds(self) -> F32:
        """(n, n), rows along x and columns along y of the frame of the path."""
        return np.asarray(self._evidence + self._prior, dtype=np.float32)

    def clearance(self, points: F64) -> F64:
        """Returns (...,): distances from points (..., 2) of the frame of the path to the nearest occupied cell, metres; in one: 0."""
        if self._away is None:
            free = (self.log_odds < self.settings.occupied).astype(np.uint8)
            if free.all():
                self._away = np.full(free.shape, self.settings.size, np.float32)
            else:
                # From middle to middle: an occupied cell ends half a cell earlier.
                away = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
                self._away = np.asarray(np.maximum(away - 0.5, 0.0) * self.settings.cell, dtype=np.float32)
        return self._looked_up(self._away, points, self.settings.size)

    def _looked_up(self, values: F32, points: F64, outside: float) -> F64:
        if self._corner is None:
            return np.full(points.shape[:-1], outside)
        cells = np.floor(points / self.settings.cell).astype(np.int64) - self._corner
        inside = np.asarray(((cells >= 0) & (cells < self._count)).all(axis=-1))
        rows = np.where(inside[..., None], cells, 0)
        return np.where(inside, values[rows[..., 0], rows[..., 1]], outside).astype(np.float64)

    def _evidence_by_distance(self, edges: F64, hit: F64) -> F32:
        """Returns (D, R): log odds that a view adds to a cell in each direction, at each distance."""
        settings = self.settings
        within, believed = self.credible(edges, hit)
        at = (np.arange(math.floor(edges[-1] / _RANGE_STEP)) + 0.5) * _RANGE_STEP
        front, back = at - settings.depth, at + 0.5 * settings.cell
        before, upto = (np.stack([np.interp(each, edges, row) for row in within]) for each in (front, back))
        reached = 1.0 - before
        hazard = ((upto - before) / np.maximum(reached, 1e-6)).clip(1e-6, 1.0 - 1e-6)
        usual = min(0.5, settings.density * (settings.depth + 0.5 * settings.cell))
        odds = np.log(hazard / (1.0 - hazard)) - math.log(usual / (1.0 - usual))
        told = settings.weight * believed[:, None] * reached * np.clip(odds, -settings.most_free, settings.most_occupied)
        told[:, at < settings.blind] = told[:, at < settings.blind].clip(0.0)
        return np.asarray(told, dtype=np.float32)

    def credible(self, edges: F64, hit: F64) -> tuple[F64, F64]:
        """Returns what of a view is believed, see ``OccupancySettings.nearest``.

        Returns:
            (D, B + 1), probability that the first thing stands within each of the edges, if not nearer than that; (D,), probability that
            it does not stand nearer.
        """
        within = np.concatenate([np.zeros((len(hit), 1)), np.cumsum(hit[:, :-1], axis=1)], axis=1).clip(0.0, 1.0)
        near = np.array([np.interp(self.settings.nearest, edges, row) for row in within])
        far = np.maximum(1.0 - near, 1e-6)
        return ((within - near[:, None]) / far[:, None]).clip(0.0, 1.0), far

    def _path_prior(self) -> F32:
        """Returns (n, n): log odds of cells of which nothing is known."""
        assert self._corner is not None
        away = np.ones(self._evidence.shape, np.uint8)
        cells = np.round(self._path / self.settings.cell - 0.5).astype(np.int32) - self._corner
        # OpenCV's points are (column, row).
        cv2.polylines(away, [cells[:, ::-1].astype(np.int32).reshape(-1, 1, 2)], False, 0)
        if away.all():
            return np.zeros_like(self._evidence)
        distance = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * self.settings.cell
        seen = np.zeros(distance.shape, np.float32)
        far = 0.75 * self.settings.size
        middle = (np.array(self._corner) + self._count / 2.0) * self.settings.cell
        for camera, bearings, table in self._recorded:
            if np.abs(camera[:2] - middle).max() < far:
                in_view, told = self._told(camera, bearings, table)
                seen[in_view] += told
        wrong = np.clip(self.settings.discount * seen, 0.0, self.settings.limit)
        return np.where(distance <= self.settings.path_width, self.settings.path_prior - wrong, 0.0).astype(np.float32)


def _half_width(bearings: F64) -> float:
    """Returns the tangent of half the field of view whose equal strips have these middles."""
    count = len(bearings)
    return math.tan(float(bearings[0])) * count / max(count - 1, 1)


def _overlap(shift: int, count: int) -> tuple[slice, slice]:
    """Returns where kept rows go, and where they come from, when the map moves by a number of cells."""
    moved = min(abs(shift), count)
    low, high = slice(0, count - moved), slice(moved, count)
    return (low, high) if shift >= 0 else (high, low)
