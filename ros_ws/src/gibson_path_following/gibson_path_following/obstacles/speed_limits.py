"""Limits the speed along a local plan: by the recorded speed, by clearance and free distance, and by obstacles that one view alone shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError, check_ranges, quoted
from gibson_path_following.localisation.motions import Motion, segments
from gibson_path_following.obstacles.arcs import ArcSettings
from gibson_path_following.obstacles.lattice import LatticeSettings, LocalPlan
from gibson_path_following.obstacles.occupancy import OccupancyGrid
from gibson_path_following.paths.path_geometry import PathGeometry
from gibson_path_following.policies.path_model import PathModel, Prediction
from gibson_path_following.types import STOP, RecordedPath, Velocity

F64 = NDArray[np.float64]
_CLEARANCE_AHEAD = 0.5
"""Distance along the plan within which its clearance limits the speed, metres."""
_RANGES_FROM, _RANGES_BEYOND, _RANGE_STEP = 0.1, 0.3, 0.05
"""Ranges at which rays are tested against the plan: the first, how far beyond ``slowdown_distance``, and their step, metres."""


@dataclass(frozen=True, slots=True)
class SpeedSettings:
    """Speeds, and the distances and probabilities at which they are reduced."""

    speed_ratio: float = 1.0
    """Largest speed per recorded speed at the same station."""
    default_linear: float = 0.3
    """Recorded speed where the path has no velocities, m/s."""
    min_recorded_linear: float = 0.15
    """Least limit by the recorded speed, m/s."""
    slow_linear: float = 0.12
    """Speed at the least clearance, and before an obstacle that one view shows on the plan, m/s."""
    slowdown_distance: float = 1.0
    """Distance along the plan within which such an obstacle reduces the speed, metres: more views see it before the robot reaches it."""
    slowdown_probabilities: tuple[float, float] = (0.25, 0.6)
    """Probabilities of such an obstacle: from the first on the speed is reduced, from the second on it is ``slow_linear``."""
    max_stop_views: int = 8
    """Successive views in which an obstacle below ``OccupancySettings.min_range`` stops the robot: people walk on, and most others are false
    positives."""
    stop_distance: float = 0.2
    """Free distance of a plan at which the robot stops, metres."""

    def __post_init__(self) -> None:
        low_high = self.slowdown_probabilities
        if not (len(low_high) == 2 and 0.0 <= low_high[0] <= low_high[1] <= 1.0):
            raise SettingError(f"slowdown_probabilities is {quoted(low_high)}, must be two probabilities, the smaller one first")
        check_ranges(
            self,
            ("speed_ratio", 0.1, 10.0),
            ("default_linear", 0.01, 10.0),
            ("min_recorded_linear", 0.0, 10.0),
            ("slow_linear", 0.01, 10.0),
            ("slowdown_distance", 0.0, 10.0),
            ("max_stop_views", 0, 1000),
            ("stop_distance", 0.0, 5.0),
        )


class SpeedLimiter:
    """Limits the velocity of each view."""

    def __init__(
        self,
        path: RecordedPath,
        geometry: PathGeometry,
        model: PathModel,
        grid: OccupancyGrid,
        settings: SpeedSettings,
        lattice: LatticeSettings,
        arcs: ArcSettings,
    ) -> None:
        """Computes the recorded speeds.

        Args:
            path: the path.
            geometry: of the path.
            model: the network, for bearings and range bins.
            grid: for its sensor model.
            settings: the limits.
            lattice: of the plans: clearances.
            arcs: of the velocities: largest speed and time to collision.
        """
        self.settings, self._lattice, self._arcs = settings, lattice, arcs
        self._model, self._grid = model, grid
        self._speeds: F64 = np.array([self._recorded_speed(part) for part in segments(path)])
        """(N - 1,), recorded speeds from node to node, m/s."""
        self._middles: F64 = 0.5 * (geometry.stations[1:] + geometry.stations[:-1])
        """(N - 1,), stations of the middles between nodes, metres."""
        self._stop_views = 0
        """Successive views with an obstacle below the minimum range; views without one count down."""

    def reset(self) -> None:
        """Drops all views."""
        self._stop_views = 0

    def limited(self, velocity: Velocity, plan: LocalPlan, camera: F64, prediction: Prediction) -> Velocity:
        """Returns a velocity within the limits, of the same curvature; a rotation in place stays as it is, unless the robot must stop.

        Args:
            velocity: along the plan.
            plan: the plan, which begins at the robot.
            camera: (3,), pose of the camera, path frame, metres and radians.
            prediction: outputs of the network for the newest view.
        """
        on_plan, below_min_range = self._obstacle_probabilities(plan, camera, prediction)
        is_too_near = below_min_range >= self.settings.slowdown_probabilities[1]
        self._stop_views = self._stop_views + 1 if is_too_near else max(0, self._stop_views - 1)
        if is_too_near and self._stop_views <= self.settings.max_stop_views:
            return STOP
        limit = self._limit(plan, max(on_plan, below_min_range))
        scale = min(1.0, limit / max(abs(velocity.linear), 1e-6))
        return Velocity(scale * velocity.linear, scale * velocity.angular) if velocity.linear else velocity

    def _limit(self, plan: LocalPlan, probability: float) -> float:
        """Returns the largest speed, m/s.

        Args:
            plan: the plan.
            probability: that an obstacle stands on it although the grid has none.
        """
        settings, lattice = self.settings, self._lattice
        station = float(plan.stations[0])
        recorded = settings.speed_ratio * float(np.interp(station, self._middles, self._speeds))
        limit = max(settings.min_recorded_linear, recorded)
        clearance = plan.clearance[plan.stations <= station + _CLEARANCE_AHEAD].min()
        by_clearance = min(1.0, max(0.0, (float(clearance) - lattice.min_clearance) / lattice.inflation_distance))
        low, high = settings.slowdown_probabilities
        by_probability = 1.0 - min(1.0, max(0.0, (probability - low) / max(high - low, 1e-6)))
        headroom = max(0.0, self._arcs.max_linear - settings.slow_linear)
        limit = min(limit, settings.slow_linear + min(by_clearance, by_probability) * headroom)
        if not plan.is_free:
            by_collision = (plan.free_distance - settings.stop_distance) / self._arcs.min_time_to_collision
            limit = min(limit, max(settings.slow_linear, by_collision))
        return limit

    def _obstacle_probabilities(self, plan: LocalPlan, camera: F64, prediction: Prediction) -> tuple[float, float]:
        """Returns the probabilities of an obstacle on the plan, and of one below the minimum range, by one view.

        Each is that of the worst bearing that crosses the plan. Arguments as of ``limited``.
        """
        x, y, yaw = camera
        reach = self.settings.slowdown_distance
        ranges = np.arange(_RANGES_FROM, reach + _RANGES_BEYOND, _RANGE_STEP)
        angles = yaw + self._model.bearings
        rays = np.stack([x + ranges * np.cos(angles)[:, None], y + ranges * np.sin(angles)[:, None]], axis=-1)  # (D, R, 2)
        points = plan.points[plan.stations <= plan.stations[0] + reach]
        is_on_plan = np.linalg.norm(rays[:, :, None] - points, axis=3).min(axis=2) < self._lattice.min_clearance
        crossing = np.flatnonzero(is_on_plan.any(axis=1))
        if not len(crossing):
            return 0.0, 0.0
        farthest = ranges[is_on_plan.shape[1] - 1 - is_on_plan[crossing, ::-1].argmax(axis=1)]
        hit_cdf, far = self._grid.hit_cdf(self._model.edges, prediction.hit[crossing])
        hits = [float(np.interp(r, self._model.edges, row)) for r, row in zip(farthest, hit_cdf, strict=True)]
        return float((far * hits).max()), float((1.0 - far).max())

    def _recorded_speed(self, segment: Motion) -> float:
        """Returns the speed of a segment, m/s."""
        return abs(segment.distance) / segment.duration if segment.duration > 1e-3 else self.settings.default_linear
