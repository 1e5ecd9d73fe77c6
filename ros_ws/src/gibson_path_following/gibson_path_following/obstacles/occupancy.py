"""Rolling occupancy grid in log-odds, in the path frame: it keeps obstacles that left the field of view.

The grid is a square window that moves with the robot. An observation gives, for some bearings, the probability that the first obstacle along
the ray lies in each range bin. The inverse sensor model turns that into log-odds updates: cells before the hit become free, cells at the hit
occupied, cells behind it stay as they were. Cells near the recorded path have a free prior, since the robot drove there once. Log-odds are
clamped, and decay with time. Pure geometry: no ROS, no network.
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
"""Range resolution of the inverse sensor model, metres."""


@dataclass(frozen=True, slots=True)
class OccupancySettings:
    """Size of the grid, inverse sensor model, prior and decay."""

    resolution: float = 0.05
    """Edge of a cell, metres."""
    size: float = 6.0
    """Edge of the grid, metres; the robot is in its centre."""
    obstacle_density: float = 1.0
    """Prior density of obstacles along a ray, 1/m. A lower one turns every doubt of the network into evidence for an obstacle."""
    obstacle_thickness: float = 0.1
    """Least thickness of an obstacle along a ray, metres."""
    update_weight: float = 0.4
    """Weight of the log-odds update of one observation, 0 to 1: errors of successive views are correlated."""
    min_range: float = 0.35
    """Range below which a hit is ignored, metres. The image does not show the floor there; a nearer hit is mostly an image with little
    texture, and the grid has a real obstacle already, from farther away."""
    min_clearing_range: float = 0.55
    """Range below which an observation does not clear cells, metres: the image shows neither the floor nor a low obstacle there, so that the
    grid keeps what it has."""
    max_hit_log_odds: float = 2.5
    """Largest log-odds update of one observation towards occupied, before ``update_weight``."""
    max_miss_log_odds: float = 2.0
    """Largest log-odds update of one observation towards free, before ``update_weight``; positive."""
    clamp_occupied: float = 5.0
    """Clamping threshold of a cell's log-odds towards occupied."""
    clamp_free: float = 1.5
    """Clamping threshold of a cell's log-odds towards free; positive. It is low: an obstacle that arrives later, or that is visible only from
    near by, must soon outweigh it."""
    path_half_width: float = 0.35
    """Distance from the recorded path within which cells have the free prior, metres."""
    path_prior: float = -2.0
    """Prior log-odds of these cells."""
    recorded_hit_factor: float = 2.5
    """Factor on the hits of recorded images within ``path_half_width``. They are false positives, which the prior subtracts from later
    observations; it is above 1 because later observations are more numerous."""
    occupied_threshold: float = 0.8
    """Log-odds at and above which a cell is occupied."""
    decay_time_constant: float = 40.0
    """Time in which log-odds decay to 1/e, seconds."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("resolution", 0.01, 0.5),
            ("size", 1.0, 50.0),
            ("obstacle_density", 0.001, 10.0),
            ("obstacle_thickness", 0.0, 2.0),
            ("update_weight", 0.01, 1.0),
            ("min_range", 0.0, 5.0),
            ("min_clearing_range", 0.0, 5.0),
            ("max_hit_log_odds", 0.0, 20.0),
            ("max_miss_log_odds", 0.0, 20.0),
            ("clamp_occupied", 0.1, 50.0),
            ("clamp_free", 0.1, 50.0),
            ("path_half_width", 0.0, 5.0),
            ("path_prior", -20.0, 0.0),
            ("recorded_hit_factor", 0.0, 10.0),
            ("occupied_threshold", -20.0, 20.0),
            ("decay_time_constant", 0.1, 1e6),
        )


class OccupancyGrid:
    """Occupancy grid around the robot, in the path frame."""

    def __init__(self, path: F64, settings: OccupancySettings | None = None) -> None:
        """Creates a grid that holds the path prior alone.

        Args:
            path: (N, 2), float64, points of the recorded path, path frame, metres.
            settings: None = the defaults.
        """
        self.settings = settings or OccupancySettings()
        self._path = path
        self._cells = max(3, round(self.settings.size / self.settings.resolution))
        """Cells along an edge."""
        self._origin: tuple[int, int] | None = None
        """Index, along x and y of the path frame, of the grid's first cell; None = the grid has no place yet."""
        self._evidence: F32 = np.zeros((self._cells, self._cells), np.float32)
        """Log-odds of the observations, without the prior."""
        self._prior: F32 = np.zeros_like(self._evidence)
        """Prior log-odds."""
        self._recorded: list[tuple[F64, F64, F32]] = []
        """Of each recorded image: camera pose (3,), bearings (D,), log-odds updates (D, R) by bearing and range."""
        self._obstacle_distance: F32 | None = None
        """(n, n), distance from each cell to the nearest occupied one, metres; None = outdated."""

    def clear(self) -> None:
        """Removes all observations; the path prior stays."""
        self._origin, self._obstacle_distance = None, None
        self._evidence[:] = 0.0

    def move_window(self, x: float, y: float) -> None:
        """Centres the rolling window on a point, path frame, metres; cells that leave the window lose their log-odds."""
        resolution, count = self.settings.resolution, self._cells
        origin = math.floor(x / resolution) - count // 2, math.floor(y / resolution) - count // 2
        if self._origin is not None and max(abs(origin[0] - self._origin[0]), abs(origin[1] - self._origin[1])) < count // 8:
            return
        kept = np.zeros_like(self._evidence)
        if self._origin is not None:
            shift = origin[0] - self._origin[0], origin[1] - self._origin[1]
            to, frm = zip(*(_overlap(each, count) for each in shift), strict=True)
            kept[to] = self._evidence[frm]
        self._origin, self._evidence, self._obstacle_distance = origin, kept, None
        self._prior = self._path_prior()

    def decay(self, seconds: float) -> None:
        """Decays the log-odds by ``decay_time_constant``, for a time that has passed, seconds."""
        self._evidence *= math.exp(-max(0.0, seconds) / self.settings.decay_time_constant)
        self._obstacle_distance = None

    def integrate(self, camera: F64, bearings: F64, edges: F64, hit: F64) -> None:
        """Integrates an observation.

        Args:
            camera: (3,), float64, x, y, yaw of the camera, path frame, metres and radians.
            bearings: (D,), float64, in the camera frame, radians, positive to the left, leftmost first: centres of equal strips of a pinhole
                image.
            edges: (B + 1,), float64, edges of the range bins, metres, from 0.
            hit: (D, B + 1), float64, probability that the first obstacle along a bearing lies in each range bin; the last column: beyond the
                last edge.
        """
        if self._origin is None:
            self.move_window(float(camera[0]), float(camera[1]))
        cells, updates = self._cell_updates(camera, bearings, self._inverse_sensor_model(edges, hit))
        log_odds = self._evidence[cells] + updates
        self._evidence[cells] = np.clip(log_odds, -self.settings.clamp_free, self.settings.clamp_occupied)
        self._obstacle_distance = None

    def add_recorded(self, camera: F64, bearings: F64, edges: F64, hit: F64) -> None:
        """Adds a recorded image to the prior: its hits on the path are false positives. Arguments as of ``integrate``."""
        self._recorded.append((camera, bearings, self._inverse_sensor_model(edges, hit)))
        self._origin = None

    def _cell_updates(self, camera: F64, bearings: F64, table: F32) -> tuple[NDArray[np.bool_], F32]:
        """Returns the mask (n, n), bool, of the cells in the field of view, and their log-odds updates (K,), float32.

        Args:
            camera: (3,), x, y, yaw, path frame, metres and radians.
            bearings: (D,), as of ``integrate``.
            table: (D, R), log-odds updates by bearing and range.
        """
        count = self._cells
        centres = (np.arange(count) + 0.5) * self.settings.resolution
        assert self._origin is not None
        dx = self._origin[0] * self.settings.resolution + centres - camera[0]
        dy = self._origin[1] * self.settings.resolution + centres - camera[1]
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
        """(n, n), float32, prior included; rows along x and columns along y of the path frame."""
        return np.asarray(self._evidence + self._prior, dtype=np.float32)

    def clearance(self, points: F64) -> F64:
        """Returns (...,), float64: distances from points (..., 2), path frame, to the nearest occupied cell, metres; 0 in an occupied cell."""
        if self._obstacle_distance is None:
            free = (self.log_odds < self.settings.occupied_threshold).astype(np.uint8)
            if free.all():
                self._obstacle_distance = np.full(free.shape, self.settings.size, np.float32)
            else:
                # OpenCV measures from centre to centre: an occupied cell ends half a cell earlier.
                distance = _distance_to_zero(free)
                self._obstacle_distance = np.asarray(np.maximum(distance - 0.5, 0.0) * self.settings.resolution, dtype=np.float32)
        return self._look_up(self._obstacle_distance, points, self.settings.size)

    def _look_up(self, values: F32, points: F64, outside: float) -> F64:
        """Returns (...,): the values (n, n) of the cells at points (..., 2), path frame, metres; ``outside`` beyond the grid."""
        if self._origin is None:
            return np.full(points.shape[:-1], outside)
        cells = np.floor(points / self.settings.resolution).astype(np.int64) - self._origin
        inside = np.asarray(((cells >= 0) & (cells < self._cells)).all(axis=-1))
        rows = np.where(inside[..., None], cells, 0)
        return np.where(inside, values[rows[..., 0], rows[..., 1]], outside).astype(np.float64)

    def _inverse_sensor_model(self, edges: F64, hit: F64) -> F32:
        """Returns (D, R), float32: log-odds updates of a cell by bearing and range. Arguments as of ``integrate``."""
        settings = self.settings
        hit_cdf, far = self.hit_cdf(edges, hit)
        ranges = (np.arange(math.floor(edges[-1] / _RANGE_STEP)) + 0.5) * _RANGE_STEP
        front, back = ranges - settings.obstacle_thickness, ranges + 0.5 * settings.resolution
        before, upto = (np.stack([np.interp(each, edges, row) for row in hit_cdf]) for each in (front, back))
        reached = 1.0 - before  # probability that the ray reaches the cell
        hazard = ((upto - before) / np.maximum(reached, 1e-6)).clip(1e-6, 1.0 - 1e-6)
        prior = min(0.5, settings.obstacle_density * (settings.obstacle_thickness + 0.5 * settings.resolution))
        log_odds = np.log(hazard / (1.0 - hazard)) - math.log(prior / (1.0 - prior))
        limited = np.clip(log_odds, -settings.max_miss_log_odds, settings.max_hit_log_odds)
        updates = settings.update_weight * far[:, None] * reached * limited
        updates[:, ranges < settings.min_clearing_range] = updates[:, ranges < settings.min_clearing_range].clip(0.0)
        return np.asarray(updates, dtype=np.float32)

    def hit_cdf(self, edges: F64, hit: F64) -> tuple[F64, F64]:
        """Returns the distribution of the first obstacle's range, without hits below ``OccupancySettings.min_range``.

        Args:
            edges: (B + 1,), edges of the range bins, metres, from 0.
            hit: (D, B + 1), as of ``integrate``.

        Returns:
            (D, B + 1), float64, probability that the first obstacle is nearer than each edge, provided that it is not nearer than
            ``min_range``; (D,), float64, probability that it is not.
        """
        within = np.concatenate([np.zeros((len(hit), 1)), np.cumsum(hit[:, :-1], axis=1)], axis=1).clip(0.0, 1.0)
        near = np.array([np.interp(self.settings.min_range, edges, row) for row in within])
        far = np.maximum(1.0 - near, 1e-6)
        return ((within - near[:, None]) / far[:, None]).clip(0.0, 1.0), far

    def _path_prior(self) -> F32:
        """Returns (n, n), float32: prior log-odds."""
        assert self._origin is not None
        off_path = np.ones(self._evidence.shape, np.uint8)
        cells = np.round(self._path / self.settings.resolution - 0.5).astype(np.int32) - self._origin
        # OpenCV's points are (column, row).
        cv2.polylines(off_path, [cells[:, ::-1].astype(np.int32).reshape(-1, 1, 2)], False, 0)
        if off_path.all():
            return np.zeros_like(self._evidence)
        distance = _distance_to_zero(off_path) * self.settings.resolution
        hits = np.zeros(distance.shape, np.float32)
        far = 0.75 * self.settings.size
        centre = (np.array(self._origin) + self._cells / 2.0) * self.settings.resolution
        for camera, bearings, table in self._recorded:
            if np.abs(camera[:2] - centre).max() < far:
                in_view, updates = self._cell_updates(camera, bearings, table)
                hits[in_view] += updates
        false_hits = np.clip(self.settings.recorded_hit_factor * hits, 0.0, self.settings.clamp_occupied)
        is_near = distance <= self.settings.path_half_width
        return np.where(is_near, self.settings.path_prior - false_hits, 0.0).astype(np.float32)


def _distance_to_zero(image: NDArray[np.uint8]) -> F32:
    """Returns (n, n), float32: the distance from each cell to the nearest cell that is 0, cells; exact, so that equal grids give equal bits.

    The last bit of OpenCV's distances depends on the alignment of its memory; squared distances are integers and can be restored by rounding.
    """
    distance = cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.sqrt(np.rint(np.square(distance, dtype=np.float64))).astype(np.float32)


def _half_width(bearings: F64) -> float:
    """Returns the tangent of half the field of view whose equal strips are centred on these bearings (D,), radians."""
    count = len(bearings)
    return math.tan(float(bearings[0])) * count / max(count - 1, 1)


def _overlap(shift: int, count: int) -> tuple[slice, slice]:
    """Returns the destination and the source of the rows that stay in a window of ``count`` cells that moves by ``shift`` cells."""
    moved = min(abs(shift), count)
    low, high = slice(0, count - moved), slice(moved, count)
    return (low, high) if shift >= 0 else (high, low)
