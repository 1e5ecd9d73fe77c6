"""Follows a path with a network that was trained in simulation: it predicts the relative poses of recorded images ahead, and free distances.

The network perceives; geometry drives: the pose in the path frame (``pose_tracking.py``), an occupancy grid (``occupancy.py``), a local plan along
the path and around obstacles (``lattice.py``), arcs along that plan (``arcs.py``), speed limits (``speed_limits.py``), and recovery behaviours
where the plan is blocked (``recovery.py``). It needs onnxruntime, and no PyTorch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import ViewError, check_ranges
from gibson_path_following.localisation.localiser import NodeMatcher
from gibson_path_following.localisation.pose_filter import pose_after_arc, relative_pose
from gibson_path_following.localisation.pose_tracking import PoseTracker, PoseTrackingSettings
from gibson_path_following.obstacles.arcs import ArcPlanner, ArcSettings
from gibson_path_following.obstacles.lattice import LatticePlanner, LatticeSettings, LocalPlan
from gibson_path_following.obstacles.occupancy import OccupancyGrid, OccupancySettings
from gibson_path_following.obstacles.recovery import Recovery, RecoverySettings
from gibson_path_following.obstacles.speed_limits import SpeedLimiter, SpeedSettings
from gibson_path_following.paths.path_geometry import METRES_PER_RADIAN
from gibson_path_following.policies.path_model import DEFAULT_MODEL, PathModel, Prediction
from gibson_path_following.types import STOP, Place, RecordedPath, Step, Velocity, View

F64 = NDArray[np.float64]
_AT_PIVOT = 0.05
"""Distance along the path to a turn in place at which the robot begins it, metres."""
_OVERSHOOT = 0.1
"""Distance beyond the end of the path at which the robot stops by itself, metres."""
_BACKUP_POINTS = np.array([[-0.1, 0.0], [-0.2, 0.0]])
"""Points behind the robot that must be free before it backs up, (2, 2), robot frame, metres."""


@dataclass(frozen=True, slots=True)
class LearnedSettings:
    """Settings of the policy and of its parts."""

    camera_ahead: float = 0.12
    """Distance of the camera ahead of the robot's centre, metres."""
    lookahead_distance: float = 0.35
    """Distance along the plan of the goal of the arcs, metres."""
    tracking: PoseTrackingSettings = field(default_factory=PoseTrackingSettings)
    """Pose in the path frame."""
    occupancy: OccupancySettings = field(default_factory=OccupancySettings)
    """Occupancy grid."""
    lattice: LatticeSettings = field(default_factory=LatticeSettings)
    """Local plan along the path and around obstacles."""
    arcs: ArcSettings = field(default_factory=ArcSettings)
    """Arcs along the plan."""
    speed: SpeedSettings = field(default_factory=SpeedSettings)
    """Speed limits."""
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    """Recovery behaviours where the plan is blocked."""

    def __post_init__(self) -> None:
        check_ranges(self, ("camera_ahead", -5.0, 5.0), ("lookahead_distance", 0.05, 3.0))


class LearnedPolicy:
    """A ``Policy`` with a network that localises the robot beside its path and detects obstacles."""

    def __init__(
        self,
        path: RecordedPath,
        model: Path | PathModel = DEFAULT_MODEL,
        settings: LearnedSettings | None = None,
        nodes: NodeMatcher | None = None,
    ) -> None:
        """Loads the network and prepares the images of the path.

        Args:
            path: a path of one pinhole camera.
            model: the network, or its file.
            settings: None = the defaults.
            nodes: the nodes of this path, if they are prepared already.

        Raises:
            ModelError: the network cannot be used.
            ViewError: the path is of another kind of camera.
        """
        if path.camera != "pinhole":
            raise ViewError(
                f"backend learned needs a pinhole camera, the path is of a {path.camera}; set backend to teach_repeat"
            )
        self.settings = settings = settings or LearnedSettings()
        self.model = model if isinstance(model, PathModel) else PathModel(model)
        self.tracker = PoseTracker(path, self.model, settings.tracking, settings.camera_ahead, nodes)
        """Pose of the robot, path frame."""
        self._geometry = self.tracker.geometry
        self.grid = OccupancyGrid(self._geometry.poses[:, :2], settings.occupancy)
        """Obstacles around the robot, path frame."""
        for pose, image in zip(self._geometry.poses, self.tracker.images, strict=True):
            recorded = self.model.estimate(image, image[None])
            self.grid.add_recorded(self._camera_pose(pose), self.model.bearings, self.model.edges, recorded.hit)
        self._lattice = LatticePlanner(settings.lattice)
        self._arcs = ArcPlanner(settings.arcs)
        self._limiter = SpeedLimiter(path, self._geometry, self.model, self.grid, settings.speed, settings.lattice, settings.arcs)
        self._recovery = Recovery(settings.recovery)
        self.plan: LocalPlan | None = None
        """Local plan of the newest view; None before the first."""
        self._predicted_pose: F64 = np.zeros(3)
        """(3,), pose of the robot when the next command takes effect, path frame, metres and radians."""
        self.reset()

    def reset(self) -> None:
        """Drops all earlier views."""
        self.tracker.reset()
        self.grid.clear()
        self._lattice.reset()
        self._arcs.reset()
        self._limiter.reset()
        self._recovery.reset()
        self.plan = None

    @property
    def is_localised(self) -> bool:
        """Whether a recorded image matched recently."""
        return self.tracker.is_localised

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity along the path and around obstacles; a stop if the pose is unknown."""
        tracked = self.tracker.update(view, stamp_ns, place)
        if tracked is None:
            return STOP
        if tracked.has_jumped:
            self.grid.clear()
            self._lattice.reset()
        x, y, _ = (float(value) for value in self.tracker.filter.pose)
        self.grid.move_window(x, y)
        self.grid.decay(tracked.seconds)
        camera = self._camera_pose(self.tracker.filter.pose)
        self.grid.integrate(camera, self.model.bearings, self.model.edges, tracked.prediction.hit)
        return self._drive(tracked.seconds, place.pending, camera, tracked.prediction) if tracked.is_known else STOP

    def _drive(self, seconds: float, pending: Step, camera: F64, prediction: Prediction) -> Velocity:
        """Returns the velocity along the path and around obstacles.

        Args:
            seconds: time since the previous view.
            pending: motion before the next command takes effect.
            camera: (3,), pose of the camera, path frame, metres and radians.
            prediction: outputs of the network.
        """
        settings, geometry = self.settings, self._geometry
        pose, end = self.tracker.filter.pose, float(geometry.stations[-1])
        station = self.tracker.project()
        beyond, _, heading_error = relative_pose(geometry.poses[-1], pose)
        if station >= end - 1e-6 and beyond > _OVERSHOOT and abs(heading_error) < math.pi / 2.0:
            return STOP
        x, y, yaw = (float(value) for value in pose)
        self._predicted_pose = np.array(pose_after_arc((x, y, yaw), pending.distance, pending.turn))
        station = min(station + max(0.0, pending.distance), end)
        self.plan = plan = self._plan(station)
        velocity = STOP
        if not self._recovery.is_backing_up and (plan.is_free or plan.free_distance > settings.speed.stop_distance):
            velocity = self._arcs.velocity(self._goal(plan), self._clearance)
        if velocity == STOP:
            can_back_up = bool((self._clearance(_BACKUP_POINTS) >= settings.lattice.min_clearance).all())
            return self._recovery.on_blocked(station, seconds, can_back_up=can_back_up)
        self._recovery.on_free(station)
        return self._limiter.limited(velocity, plan, camera, prediction)

    def _plan(self, station: float) -> LocalPlan:
        """Returns the local plan from a station on, metres."""
        lattice, geometry = self.settings.lattice, self._geometry
        count = math.ceil(min(lattice.length, geometry.stations[-1] - station + _OVERSHOOT) / lattice.step)
        stations = station + np.arange(max(2, count + 1)) * lattice.step
        points, normals = geometry.points_and_normals(stations)
        offset = float((self._predicted_pose[:2] - points[0]) @ normals[0])
        return self._lattice.plan(stations, points, normals, offset, self.grid.clearance)

    def _goal(self, plan: LocalPlan) -> tuple[float, float, float]:
        """Returns the goal of the arcs, at the lookahead distance: x, y and goal heading, robot frame, metres and radians."""
        pose_at = self._geometry.pose_at
        driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(plan.points, axis=0), axis=1))])
        lookahead, station = self.settings.lookahead_distance, float(plan.stations[0])
        for start, end in self._geometry.pivots:
            if station < end - _AT_PIVOT and (distance := float(np.interp(start, plan.stations, driven))) < lookahead:
                if station >= start - _AT_PIVOT:
                    yaw = float(pose_at(min(end, max(station, start) + METRES_PER_RADIAN))[2])
                    return 0.0, 0.0, math.remainder(yaw - float(self._predicted_pose[2]), 2.0 * math.pi)
                x, y, yaw = (float(value) for value in pose_at(start))
                beyond = lookahead - distance
                goal = np.array([x + beyond * math.cos(yaw), y + beyond * math.sin(yaw), yaw])
                return relative_pose(self._predicted_pose, goal)
        x, y, at = (
            float(np.interp(lookahead, driven, values)) for values in (plan.points[:, 0], plan.points[:, 1], plan.stations)
        )
        k = int(np.searchsorted(driven, lookahead).clip(1, len(driven) - 1))
        slope = math.atan2(plan.offsets[k] - plan.offsets[k - 1], plan.stations[k] - plan.stations[k - 1])
        yaw = float(pose_at(at)[2])
        # The plan goes straight on beyond its end, so that the robot arrives there at its speed; the follower stops it.
        beyond = max(0.0, lookahead - float(driven[-1]))
        goal = np.array([x + beyond * math.cos(yaw), y + beyond * math.sin(yaw), yaw + slope])
        return relative_pose(self._predicted_pose, goal)

    def _clearance(self, points: F64) -> F64:
        """Returns (...,), float64: distances from points (..., 2), robot frame, metres, to the nearest obstacle."""
        x, y, yaw = self._predicted_pose
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left = points[..., 0], points[..., 1]
        return self.grid.clearance(np.stack([x + c * ahead - s * left, y + s * ahead + c * left], axis=-1))

    def _camera_pose(self, robot: F64) -> F64:
        """Returns (3,): pose of the camera of a robot at a pose (3,), same frame, metres and radians."""
        x, y, yaw = robot
        return np.array(pose_after_arc((x, y, yaw), self.settings.camera_ahead, 0.0))
